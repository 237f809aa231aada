"""ObAct takes one of torch's threads while it acts; the number is the caller's before and after."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.modeling_obact import ObActPolicy
from lerobot_policy_obact.network import ObActModel
from lerobot_policy_obact.threads import on_one_thread

from tests.checkpoints import observation
from tests.tools import python


@pytest.fixture(autouse=True)
def four_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("method", ["select_action", "predict_action_chunk", "observe"])
def test_acting_takes_one_thread(method: str, actor: Path, monkeypatch) -> None:
    policy = ObActPolicy.from_pretrained(actor)
    used = []
    encode = ObActModel.encode_images

    def noting(*args, **kwargs):
        used.append(torch.get_num_threads())
        return encode(*args, **kwargs)

    monkeypatch.setattr(ObActModel, "encode_images", noting)
    getattr(policy, method)(observation(policy.config))
    assert used == [1]
    assert torch.get_num_threads() == 4


def test_the_number_is_restored_after_an_error() -> None:
    @on_one_thread
    def fail() -> None:
        assert torch.get_num_threads() == 1
        raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert torch.get_num_threads() == 4


@pytest.mark.parametrize(
    "plugin", ["lerobot_policy_obact", "lerobot_env_dynahoi", "lerobot_policy_obact.modeling_obact"]
)
def test_importing_a_plugin_changes_nothing(plugin: str) -> None:
    code = (
        f"import torch; torch.set_num_threads(3); import {plugin}; print(torch.get_num_threads())"
    )
    assert python("-c", code).split()[-1] == "3"
