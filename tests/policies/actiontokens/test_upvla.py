"""Seeing ahead and acting in one pass: who sees whom, what is learned, padding, checkpoints."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot_policy_actiontokens import UPVLAConfig, UPVLAPolicy
from lerobot_policy_actiontokens.upvla.sequence import lay_out

from tests.zoo.stand_ins import save_image_tokenizer, save_phi

SIZE, PIXELS, CAMERA = 3, 16, "observation.images.ego"


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("models")
    torch.manual_seed(0)
    save_phi(root / "phi")
    save_image_tokenizer(root / "images" / "vqvae")
    return root


def make_policy(models: Path, **changes: object) -> UPVLAPolicy:
    torch.manual_seed(0)
    options = {"chunk_size": 4, "n_action_steps": 4, "image_size": PIXELS} | changes
    config = UPVLAConfig(
        llm_name=str(models / "phi"),
        image_tokenizer=str(models / "images"),
        device="cpu",
        push_to_hub=False,
        input_features={CAMERA: PolicyFeature(FeatureType.VISUAL, (3, PIXELS, PIXELS))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (SIZE,))},
        **options,
    )
    return UPVLAPolicy(config)


def make_batch(policy: UPVLAPolicy, n: int = 2) -> dict[str, object]:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(n, 2, 3, PIXELS, PIXELS, generator=generator)
    actions = 2 * torch.rand(n, policy.config.chunk_size, SIZE, generator=generator) - 1
    return {CAMERA: images, "action": actions, "task": ["catch the ball"] * n}


def now(batch: dict[str, object]) -> dict[str, object]:
    return batch | {CAMERA: batch[CAMERA][:, 0]}


def test_words_and_actions_look_back_and_the_image_looks_everywhere() -> None:
    words, kept = torch.tensor([[0, 5, 6]]), torch.tensor([[0, 1, 1]])
    ids, mask, positions, codes, actions = lay_out(words, kept, torch.tensor([[1, 0]]), n_actions=2, n_words=10)
    task, image, end, act, code = 10, 11, 12, 13, 14
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


def test_it_learns_what_comes_and_what_to_do(models: Path) -> None:
    policy = make_policy(models)
    batch = make_batch(policy)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(150):
        policy.train()(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
    assert (policy.predict_action_chunk(now(batch)) - batch["action"]).abs().max() < 0.1
    codes = policy.images.encode(batch[CAMERA][:, 1])
    assert codes.unique().numel() > 4
    expected = policy.images.decode(codes)
    assert (policy.predict_image(now(batch)) - expected).abs().mean() < 0.1 * expected.std()


def test_actions_depend_on_image_and_instruction(models: Path) -> None:
    policy = make_policy(models)
    batch = now(make_batch(policy))
    chunk = policy.predict_action_chunk(batch)
    assert chunk.shape == (2, 4, SIZE)
    assert (policy.predict_action_chunk(batch | {CAMERA: 1 - batch[CAMERA]}) - chunk).abs().max() > 1e-4
    assert (policy.predict_action_chunk(batch | {"task": "catch the moving ball"}) - chunk).abs().max() > 1e-4


def test_a_longer_instruction_beside_it_changes_nothing(models: Path) -> None:
    policy = make_policy(models).eval()
    batch = make_batch(policy)
    alone = policy(batch, reduction="none")[0]
    mixed = policy(batch | {"task": ["catch the ball", "catch the moving ball that is the ball"]}, reduction="none")[0]
    torch.testing.assert_close(mixed[0], alone[0], rtol=1e-4, atol=1e-5)
    assert (mixed[1] - alone[1]).abs() > 1e-5


@pytest.mark.parametrize("padded", [CAMERA, "action"])
def test_what_is_after_the_episode_is_not_learned(models: Path, padded: str) -> None:
    policy = make_policy(models).eval()
    batch = make_batch(policy)
    pad = torch.zeros(batch[padded].shape[:2], dtype=torch.bool)
    pad[0, -1] = True
    other = batch[padded].clone()
    other[:, -1] = 1 - other[:, -1]
    before, after = (
        policy(batch | {padded: values, f"{padded}_is_pad": pad}, reduction="none")[0]
        for values in (batch[padded], other)
    )
    torch.testing.assert_close(before[0], after[0])
    assert (before[1] - after[1]).abs() > 1e-5


def test_the_image_tokenizer_stays_as_it_is(models: Path) -> None:
    policy = make_policy(models).train()
    assert not policy.images.model.training
    assert not any(p.requires_grad for p in policy.images.parameters())
    assert policy.llm.get_input_embeddings().weight.requires_grad


def test_codes_come_back_row_by_row(models: Path) -> None:
    images = make_policy(models).images
    codes = torch.randint(0, 16, (2, 64), generator=torch.Generator().manual_seed(0))
    latents = images.model.quantize.get_codebook_entry(codes.flatten(), (2, 8, 8, 4))
    decoded = images.model.decoder(images.model.post_quant_conv(latents)).clamp(0, 1)
    torch.testing.assert_close(images.decode(codes), decoded)


def test_a_checkpoint_brings_its_own_weights(models: Path, tmp_path: Path) -> None:
    shutil.copytree(models, tmp_path / "models")
    policy = make_policy(tmp_path / "models")
    for file in (tmp_path / "models").rglob("*.safetensors"):
        file.unlink()
    with torch.no_grad():
        policy.llm.get_input_embeddings().weight.add_(0.1)
        policy.images.model.quantize.embedding.weight.mul_(2)
    policy.save_pretrained(tmp_path / "policy")
    again = UPVLAPolicy.from_pretrained(tmp_path / "policy")
    batch = now(make_batch(policy))
    torch.testing.assert_close(again.predict_action_chunk(batch), policy.predict_action_chunk(batch))
    torch.testing.assert_close(again.predict_image(batch), policy.predict_image(batch))
