"""The section of the model card that is particular to ObAct."""

from __future__ import annotations

from .configuration_obact import ObActConfig

_SECTION = """
## ObAct

ObAct (*observe before act*, [DynaHOI](https://github.com/HuBocheng/DynaHOI)) watches a moving target for a
moment before it acts. A window of observed frames is fused with the current frame by spatiotemporal
attention, and a generative head turns the result into a chunk of actions. This is an independent
implementation as a LeRobot plugin.

| Setting | Value |
| --- | --- |
| Parameters | {parameters:.2f} M |
| Image encoder | `{backbone}` at {image_size} px |
| Observed frames (s) | {n_obs_frames}, {spacing_s:.3g} s apart ({window}) |
| Action head | `{head}`, {horizon} actions ({horizon_s:.3g} s) a chunk |
| Executed before planning again | {n_action_steps} |
| Actions are predicted | {frame} |
| Averaged weights (EMA) | {ema} |

Needs `pip install lerobot_policy_obact`; LeRobot then finds the policy by itself:

```bash
lerobot-eval --policy.path={repo_id} --env.type=<env> --eval.n_episodes=50
lerobot-train --policy.path={repo_id} --dataset.repo_id=<dataset> --policy.repo_id=<you>/<name>
```

**Limits.** The policy sees {memory_s:.3g} s of the past and nothing older. It was trained by imitation on the
dataset named above; outside its range of objects, motions and camera views nothing is promised. Do not run it
on hardware without limits on speed and workspace.
"""


def describe(config: ObActConfig, n_parameters: int) -> str:
    """Return the section as Markdown.

    Args:
        config: the trained policy's config.
        n_parameters: trained and frozen parameters of the network, averaged copy not counted.
    """
    spacing_s = config.obs_stride / config.fps
    relative = f"relative to the current state in the first {config.relative_dims} dimensions"
    return _SECTION.format(
        parameters=n_parameters / 1e6,
        backbone=config.backbone,
        image_size=config.image_size or "the dataset's",
        n_obs_frames=config.n_obs_frames,
        spacing_s=spacing_s,
        window="the current frame besides" if config.n_obs_frames else "single-frame control",
        head=config.head,
        horizon=config.horizon,
        horizon_s=config.horizon / config.fps,
        n_action_steps=config.n_action_steps,
        frame=relative if config.action_frame == "relative" else "as recorded",
        ema=config.ema_decay or "off",
        repo_id=config.repo_id or "<you>/<name>",
        memory_s=config.n_obs_frames * spacing_s,
    )
