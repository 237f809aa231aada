from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dynahoi_lerobot.generate import parent_watch
from tests.generate.test_interruption import alive, wait_until

PARENT = """
import subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
child.wait()
"""

CHILD = """
import os, sys, time
from dynahoi_lerobot.generate import parent_watch
sys.platform = {platform!r}
parent_watch.exit_with_parent(os.getppid())
print("watching", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("platform", ["linux", "elsewhere"])
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_a_process_ends_within_a_second_of_its_parent(platform, ending):
    command = [sys.executable, "-c", PARENT, CHILD.format(platform=platform)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2]) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(2 * parent_watch.POLL_S)
        assert alive(child), "it lives as long as its parent"
        parent.send_signal(ending)
        parent.wait()
        wait_until(lambda: not alive(child), timeout_s=1)


def test_a_process_whose_parent_has_ended_already_ends_at_once():
    code = "from dynahoi_lerobot.generate.parent_watch import exit_with_parent; exit_with_parent(1); print('here')"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=False, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2])
    assert (done.returncode, done.stdout) == (1, b"")
