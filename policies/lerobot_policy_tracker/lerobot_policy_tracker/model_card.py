"""The section of the model card that is particular to the tracker."""

from __future__ import annotations

from collections.abc import Mapping

from .configuration_tracker import TrackerConfig

EGO = "ego"
"""The view that the environment always has."""

_SECTION = """
## Tracker

The tracker is an engineered baseline for [DynaHOI](https://github.com/HuBocheng/DynaHOI). A learned eye localises the
target in every image; a bank of motion models with the simulator's physics is fitted to the sightings and extrapolated;
a planner that knows the speed limits of the palm chooses where and when to meet the target. It was trained and
evaluated in simulation only.

| Setting | Value |
| --- | --- |
| Parameters | {parameters:.2f} M |
| Image encoder | `{backbone}` at {image_size}, {cameras} |
| Observed frames (s) | {n_obs_frames}, {spacing_s:.3g} s apart ({window}) |
| Action head | `{head}`, {horizon} actions ({horizon_s:.3g} s) a chunk |
| Actions executed before replanning | {n_action_steps} |
| Actions are predicted | {frame} |
| Averaged weights (EMA) | {ema} |
| Training dataset | {dataset} |

With the plugins `lerobot_policy_tracker` and `lerobot_env_dynahoi` installed from their repository:

```bash
lerobot-eval --policy.path={policy} --env.type=dynahoi --env.split=test_small{env_options} --eval.n_episodes=5
dynahoi evaluate --policy {policy} --split test_small{rules} --out results
```

**Limits.** The policy sees up to {memory_s:.3g} s of the past. It was trained by imitation of a scripted expert in
simulation, and is untested outside the objects, motions and camera views of its training data.
"""


def describe(
    config: TrackerConfig,
    n_parameters: int,
    dataset: str = "",
    policy: str = "",
    rules: Mapping[str, str] | None = None,
) -> str:
    """Return the section as Markdown.

    Args:
        config: the trained policy's config.
        n_parameters: trained and frozen parameters of the network, without the averaged copy.
        dataset: Hub name of the training data; "" if unknown.
        policy: folder or Hub name for the commands; "" takes the config's ``repo_id``, else this folder.
        rules: what the commands change of the benchmark's rules, by fields of the env, such as ``control_class``.
    """
    spacing_s = config.obs_stride / config.fps
    relative = f"relative to the current state in the first {config.relative_dims} dimensions"
    sizes = {feature.shape[-1] for feature in config.image_features.values()}
    cameras = [key.rsplit(".", 1)[-1] for key in config.image_features]
    further = [camera for camera in cameras if camera != EGO]
    env_options = f" --env.image_size={sizes.pop()}" if len(sizes) == 1 else ""
    env_options += f" --env.views='[{','.join(further)}]'" if further else ""
    rules = rules or {}
    env_options += "".join(f" --env.{name}={value}" for name, value in rules.items())
    return _SECTION.format(
        parameters=n_parameters / 1e6,
        backbone=config.backbone,
        image_size=f"{config.image_size} px" if config.image_size else "the size of the dataset",
        n_obs_frames=config.n_obs_frames,
        spacing_s=spacing_s,
        window="and the current frame" if config.n_obs_frames else "single-frame control",
        head=config.head,
        horizon=config.horizon,
        horizon_s=config.horizon / config.fps,
        n_action_steps=config.n_action_steps,
        frame=relative if config.action_frame == "relative" else "as recorded",
        ema=config.ema_decay or "off",
        dataset=f"`{dataset}`" if dataset else "not recorded",
        policy=policy or config.repo_id or ".",
        cameras="images of " + " and ".join(f"`{camera}`" for camera in cameras),
        env_options=env_options,
        rules="".join(f" --{name.replace('_', '-')} {value}" for name, value in rules.items()),
        memory_s=-config.windows.lookback[0] / config.fps,
    )


def insert_section(card: str, section: str) -> str:
    """Return LeRobot's card with its instructions for robots, which do not apply to a simulation, replaced.

    Args:
        card: text of LeRobot's card.
        section: Markdown that takes their place, before the citation.
    """
    details, _, rest = card.partition("## How to Get Started")
    _, title, citation = rest.partition("## Citation")
    return f"{details.rstrip().removesuffix('---')}{section}\n{title}{citation}"
