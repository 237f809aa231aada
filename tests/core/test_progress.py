"""Progress where standard error is no terminal, as in a job's log."""

import time

import pytest

from dynahoi_lerobot.core import progress


def test_a_log_gets_a_line_at_a_time_and_not_for_every_item(monkeypatch, capsys):
    monkeypatch.setattr(progress, "LINE_S", 0.05)
    for done in progress.progress_bar(range(4), desc="working", unit="episode"):
        if done in (1, 2):
            time.sleep(0.06)
    lines = capsys.readouterr().err.splitlines()
    assert 1 <= len(lines) <= 3
    assert all("working" in line and "\r" not in line for line in lines)


@pytest.mark.parametrize("count", [0, 3])
def test_short_work_leaves_no_line(count, capsys):
    assert list(progress.progress_bar(range(count), desc="working")) == list(range(count))
    assert capsys.readouterr().err == ""
