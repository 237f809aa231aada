"""What tests of several parts need: Python in a process of its own, console scripts in this one,
servers, plugins, small datasets, changed files.
"""

import io
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from dynahoi_lerobot.cli.main import main


def python(*words: object, cwd: Path | None = None, **environment: str) -> str:
    """Run Python in a process of its own, with further environment variables; return what it
    prints.
    """
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class Printed(NamedTuple):
    """What a command has printed."""

    out: str
    err: str


def dynahoi(*words: object, code: int = 0) -> Printed:
    """Run ``dynahoi`` in this process, which must end with an exit code; return what it prints."""
    out = io.StringIO()
    err = io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        ended = main([str(word) for word in words])
    sys.stdout.write(out.getvalue())
    sys.stderr.write(err.getvalue())
    assert ended == code
    return Printed(out.getvalue(), err.getvalue())


def run(words: list[str]) -> None:
    """Run a command in this process, as its console script does."""
    from accelerate.state import AcceleratorState  # which takes long to import

    AcceleratorState._reset_state(reset_partial_state=True)
    (script,) = entry_points(group="console_scripts", name=words[0])
    before = sys.argv
    sys.argv = words
    try:
        code = script.load()()
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    assert not code, f"{' '.join(words)}: exit code {code}"


def options(values: Mapping[str, object]) -> list[str]:
    """Return options as LeRobot's commands take them, other values than texts as JSON."""
    return [
        f"--{name}={value if isinstance(value, str | Path) else json.dumps(value)}"
        for name, value in values.items()
    ]


def lerobot_train(root: Path, out: Path, policy: Mapping[str, object], **given: object) -> Path:
    """Train for two steps by LeRobot's command, with options of the policy and others; return the
    checkpoint.
    """
    told = {"dataset.repo_id": "local/tiny", "dataset.root": root, "output_dir": out, "seed": 1}
    told |= {"steps": 2, "batch_size": 2, "save_freq": 2, "num_workers": 0, "log_freq": 1}
    told["policy.push_to_hub"] = False
    told |= {f"policy.{key}": value for key, value in policy.items()}
    run(["lerobot-train", *options(told | given)])
    return out / "checkpoints/last/pretrained_model"


@contextmanager
def served(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    """Serve on a local port until the block ends; yield the address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(
        target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True
    ).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def install(site: Path, distribution: str, modules: dict[str, str]) -> None:
    """Lay out an installed distribution of modules, of which each is a plugin."""
    info = site / f"{distribution}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    lines = [f"{name} = {name}" for name in modules]
    (info / "entry_points.txt").write_text("\n".join(["[dynahoi_lerobot.plugins]", *lines, ""]))
    for name, source in modules.items():
        (site / f"{name}.py").write_text(source)


def generated(root: Path, *words: str, episodes: int = 2) -> Path:
    """Generate a dataset of a few episodes by command, with further words."""
    dynahoi("generate", "--root", root, "--episodes", episodes, *words)
    return root


def edit_json(
    path: Path, change: Callable[[Any], object] = lambda content: None, **values: object
) -> None:
    """Change what a JSON file holds by a function, and set values of the object in it."""
    content = json.loads(path.read_text())
    change(content)
    content |= values
    path.write_text(json.dumps(content))


def flip_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
