"""ObAct takes one of torch's threads while it acts; the number is the caller's before and after."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.modeling_obact import ObActPolicy
from lerobot_policy_obact.network import ObActModel

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
    with pytest.raises(ValueError, match="missing"):
        getattr(policy, method)({})
    assert torch.get_num_threads() == 4, "also after an error"


def test_importing_the_plugins_changes_nothing() -> None:
    plugins = "lerobot_env_dynahoi, lerobot_policy_obact.modeling_obact"
    code = (
        f"import torch; torch.set_num_threads(3); import {plugins}; print(torch.get_num_threads())"
    )
    assert python("-c", code).split()[-1] == "3"
