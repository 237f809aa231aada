"""Actions as tokens, alone or with the image to come: bins, who sees whom, what is learned,
padding, checkpoints.
"""

import shutil
from functools import partial
from pathlib import Path

import draccus
import numpy as np
import pytest
import torch
from draccus.utils import ParsingError
from lerobot.configs import FeatureType, PolicyFeature
from lerobot_policy_actiontokens import ActionTokensConfig, ActionTokensPolicy, UPVLAPolicy
from lerobot_policy_actiontokens.modeling_actiontokens import decode, encode
from lerobot_policy_actiontokens.modeling_upvla import lay_out
from torch import Tensor

from tests.checkpoints import fit
from tests.zoo.stand_ins import save_image_tokenizer, save_phi, save_smolvlm

SIZE = 3
VOCABULARY = 1000
CAMERA = "observation.images.ego"
PIXELS = {ActionTokensPolicy: 32, UPVLAPolicy: 16}
BIN = 1 / 255 + 1e-6
"""How far a written action may be from what was meant."""
Policy = ActionTokensPolicy | UPVLAPolicy
both = pytest.mark.parametrize("kind", PIXELS)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("models")
    torch.manual_seed(0)
    save_smolvlm(root / "smolvlm")
    save_phi(root / "phi")
    save_image_tokenizer(root / "images" / "vqvae")
    return root


def make_policy(kind: type[Policy], models: Path, **changes: object) -> Policy:
    torch.manual_seed(0)
    if kind is UPVLAPolicy:
        options = {"llm_name": str(models / "phi"), "image_tokenizer": str(models / "images")}
        options |= {"image_size": PIXELS[kind], "chunk_size": 4, "n_action_steps": 4}
    else:
        options = {"vlm_name": str(models / "smolvlm"), "load_weights": False}
    image = PolicyFeature(FeatureType.VISUAL, (3, PIXELS[kind], PIXELS[kind]))
    options["input_features"] = {CAMERA: image}
    config = kind.config_class(
        device="cpu",
        push_to_hub=False,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (SIZE,))},
        **options | changes,
    )
    return kind(config)


def make_batch(policy: Policy, n: int = 2) -> dict[str, object]:
    """What is learned from: the image to come is the second one."""
    generator = torch.Generator().manual_seed(0)
    pixels = PIXELS[type(policy)]
    frames = (2,) if isinstance(policy, UPVLAPolicy) else ()
    images = torch.rand(n, *frames, 3, pixels, pixels, generator=generator)
    actions = 2 * torch.rand(n, policy.config.chunk_size, SIZE, generator=generator) - 1
    return {CAMERA: images, "action": actions, "task": ["catch the ball"] * n}


def now(batch: dict[str, object]) -> dict[str, object]:
    """What is seen while playing."""
    return batch | {CAMERA: batch[CAMERA][:, 0]} if batch[CAMERA].dim() == 5 else batch


def losses(policy: Policy, batch: dict[str, object]) -> Tensor:
    """(N,) the loss of each sample."""
    return policy.eval()(batch, reduction="none")[0]


def test_bins_are_those_of_openvla() -> None:
    values = np.random.default_rng(0).uniform(-1.2, 1.2, 2000)
    edges = np.linspace(-1, 1, 256)
    ids = encode(torch.tensor(values), VOCABULARY)
    values = np.clip(values, -1, 1)
    # single precision moves a value on an edge
    assert (ids.numpy() == VOCABULARY - np.digitize(values, edges)).mean() > 0.999
    centers = (edges[:-1] + edges[1:]) / 2
    middles = centers[np.clip(VOCABULARY - ids.numpy() - 1, 0, 254)]
    np.testing.assert_allclose(decode(ids, VOCABULARY), middles, atol=1e-6)
    np.testing.assert_allclose(middles, values, atol=BIN, rtol=0)


def test_words_and_actions_look_back_and_the_image_looks_everywhere() -> None:
    words = torch.tensor([[0, 5, 6]])
    kept = torch.tensor([[0, 1, 1]])
    ids, mask, positions, codes, actions = lay_out(
        words, kept, torch.tensor([[1, 0]]), n_actions=2, n_words=10
    )
    task = 10
    image = 11
    end = 12
    act = 13
    code = 14
    assert ids[0].tolist() == [task, 0, 5, 6, image, code + 1, code, end, act, act]
    assert ids[0, codes].tolist() == [code + 1, code]
    assert ids[0, actions].tolist() == [act, act]
    everything = "1.11111111"
    seen = ["".join("1" if x else "." for x in row) for row in mask[0, 0]]
    assert seen == [
        "1.........",
        "11........",  # padding, which nobody sees
        "1.1.......",
        "1.11......",
        everything,
        everything,
        everything,
        everything,
        "1.1111111.",
        "1.11111111",
    ]
    assert positions[0].tolist() == [0, 0, 1, 2, 3, 4, 5, 6, 7, 8]


def test_it_learns_a_chunk_and_writes_it_in_one_call(models: Path) -> None:
    policy = make_policy(ActionTokensPolicy, models, chunk_size=2, n_action_steps=2)
    batch = make_batch(policy, n=1)
    fit(policy.get_optim_params(), lambda: policy.train()(batch)[0], steps=60, rate=1e-2)
    first, second = batch["action"].unbind(1)
    close = partial(torch.testing.assert_close, atol=BIN, rtol=0)
    close(policy.predict_action_chunk(batch), batch["action"])
    close(policy.select_action(batch), first)
    close(policy.select_action(batch), second)
    close(policy.select_action(batch), first)
    policy.reset()
    close(policy.select_action(batch), first)


def test_it_learns_what_comes_and_what_to_do(models: Path) -> None:
    policy = make_policy(UPVLAPolicy, models)
    batch = make_batch(policy)
    fit(policy.get_optim_params(), lambda: policy.train()(batch)[0], steps=150)
    assert (policy.predict_action_chunk(now(batch)) - batch["action"]).abs().max() < 0.1
    codes = policy.images.encode(batch[CAMERA][:, 1])
    assert codes.unique().numel() > 4
    expected = policy.images.decode(codes)
    assert (policy.predict_image(now(batch)) - expected).abs().mean() < 0.1 * expected.std()


def test_an_untrained_model_writes_actions_and_nothing_else(models: Path) -> None:
    policy = make_policy(ActionTokensPolicy, models)
    chunk = policy.predict_action_chunk(make_batch(policy, n=4))
    assert chunk.shape == (4, 1, SIZE)
    assert chunk.abs().max() <= 1


@both
def test_a_longer_instruction_beside_it_changes_nothing(kind: type[Policy], models: Path) -> None:
    policy = make_policy(kind, models)
    batch = make_batch(policy)
    alone = losses(policy, batch)
    tasks = ["catch the ball", "catch the moving ball that is being the ball"]
    mixed = losses(policy, batch | {"task": tasks})
    torch.testing.assert_close(mixed[0], alone[0], rtol=1e-4, atol=1e-5)
    assert (mixed[1] - alone[1]).abs() > 1e-6


@pytest.mark.parametrize(
    ("kind", "padded"),
    [(ActionTokensPolicy, "action"), (UPVLAPolicy, "action"), (UPVLAPolicy, CAMERA)],
)
def test_what_is_after_the_episode_is_not_learned(
    kind: type[Policy], padded: str, models: Path
) -> None:
    policy = make_policy(kind, models, chunk_size=4)
    batch = make_batch(policy)
    pad = torch.zeros(batch[padded].shape[:2], dtype=torch.bool)
    pad[0, -1] = True
    other = batch[padded].clone()
    other[:, -1] = 1 - other[:, -1]
    before, after = (
        losses(policy, batch | {padded: values, f"{padded}_is_pad": pad})
        for values in (batch[padded], other)
    )
    torch.testing.assert_close(before[0], after[0])
    assert (before[1] - after[1]).abs() > 1e-6


@both
def test_a_checkpoint_brings_its_own_weights(
    kind: type[Policy], models: Path, tmp_path: Path
) -> None:
    policy = make_policy(kind, shutil.copytree(models, tmp_path / "models"))
    for file in (tmp_path / "models").rglob("*.safetensors"):
        file.unlink()
    with torch.no_grad():
        for weight in policy.parameters():
            weight.add_(0.05 * torch.randn_like(weight))
    policy.save_pretrained(tmp_path / "policy")
    again = kind.from_pretrained(tmp_path / "policy")
    batch = make_batch(policy)
    torch.testing.assert_close(losses(again, batch), losses(policy, batch))
    chunks = [one.predict_action_chunk(now(batch)) for one in (again, policy)]
    torch.testing.assert_close(*chunks)
    if kind is UPVLAPolicy:
        images = [one.predict_image(now(batch)) for one in (again, policy)]
        torch.testing.assert_close(*images)


def test_the_vision_tower_and_the_image_tokenizer_stay_as_they_are(models: Path) -> None:
    frozen = make_policy(ActionTokensPolicy, models, freeze_vision=True)
    for name, parameter in frozen.named_parameters():
        assert parameter.requires_grad == ("vision" not in name), name
    policy = make_policy(UPVLAPolicy, models).train()
    assert not policy.images.model.training
    assert not any(p.requires_grad for p in policy.images.parameters())
    assert policy.llm.get_input_embeddings().weight.requires_grad


def test_codes_come_back_row_by_row(models: Path) -> None:
    policy = make_policy(UPVLAPolicy, models)
    seen = now(make_batch(policy))[CAMERA]
    images = policy.images
    torch.testing.assert_close(
        images.decode(images.encode(seen)), images.model(seen).sample.clamp(0, 1)
    )


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("n_action_steps=2", "n_action_steps is 2, but must be 1 to 1"),
        ("dtype=int8", "dtype is 'int8', but must be float32 or bfloat16"),
        ("n_obs_steps=2", "n_obs_steps is 2, but must be 1"),
    ],
)
def test_the_command_line_of_lerobot_says_what_is_wrong_with_an_option(
    option: str, words: str
) -> None:
    with pytest.raises(ParsingError, match=words):
        draccus.parse(ActionTokensConfig, args=[f"--{option}"])


TWO_CAMERAS = dict.fromkeys(
    (CAMERA, "observation.images.side"), PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
)


def test_a_second_camera_is_refused(models: Path) -> None:
    with pytest.raises(ValueError, match=r"sees one image, but the inputs have .*ego, .*side"):
        make_policy(ActionTokensPolicy, models, input_features=TWO_CAMERAS)
