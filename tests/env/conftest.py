"""What LeRobot's commands say before they end."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest


@pytest.fixture
def refusal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> Callable:
    """Return the one sentence with which a check of the command line ends a command."""

    def refusal(check: Callable[[], None], words: Sequence[str]) -> str:
        monkeypatch.setattr(sys, "argv", list(words))
        with pytest.raises(SystemExit) as end:
            check()
        assert end.value.code == 2
        said = capsys.readouterr().err
        assert said.startswith(f"{Path(words[0]).name}: ")
        assert said.count("\n") == 1
        return said

    return refusal
