"""Record what a checkout does, so that two checkouts can be compared.

python benchmarks/behaviour.py record --checkout DIR --out FILE.json [--only PART ...]
python benchmarks/behaviour.py diff BEFORE.json AFTER.json

The record holds exit code and output of the documented commands, each in its good and in its
commonest bad use; digests of every column and file of small datasets, one for each capture rule;
the file of pinned episode digests; and the rows of 22 evaluated episodes of three policies. Each
command runs as its own process, in an empty folder, with the programs of the checkout's ``.venv``.
A difference is for a person to read, not a test: this script never fails because of one.
"""

import argparse
import difflib
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

EPISODES = 22
"""One of every kind of motion."""
POLICIES = ("expert", "constant_velocity", "CHECKOUT/checkpoints/obact_standard")
COMMANDS = Path(__file__).with_suffix(".txt")
"""One command line a line, in the order in which they run; CHECKOUT stands for the checkout."""

DATASETS = {
    rule: f"dynahoi generate --root {rule} --episodes 11 --image-size 32 --capture {rule}"
    for rule in ("attach", "attach_lenient", "contact")
}

CHANGING = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)?", "TIME"),
    (r"\d\d:\d\d:\d\d(\.\d+)?", "TIME"),
    (r"\d+(\.\d+)? ?(ms|s|min|h|it/s|frames/s|episodes/s|MB|kB|GB|MiB|KiB)\b", r"N \2"),
    (r"(updt_s|data_s|mem_gb):[\d.]+", r"\1:N"),
    (r"\bpid=\d+", "pid=N"),
)
"""Patterns of what differs between two runs of one build, and what is recorded instead."""


class Folder:
    """An empty folder in which a checkout's programs run."""

    def __init__(self, checkout: Path, place: Path) -> None:
        self.checkout = checkout.resolve()
        self.place = place
        self.programs = self.checkout / ".venv" / "bin"

    def run(self, line: str, limit_s: float = 900) -> dict[str, Any]:
        """Return exit code, standard output and standard error of one command line."""
        words = shlex.split(line.replace("CHECKOUT", str(self.checkout)))
        words[0] = str(self.programs / words[0])
        environment = os.environ | {"COLUMNS": "100", "HF_HUB_OFFLINE": "1", "NO_COLOR": "1"}
        began = time.monotonic()
        done = subprocess.run(
            words,
            cwd=self.place,
            env=environment,
            capture_output=True,
            text=True,
            timeout=limit_s,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        print(f"{time.monotonic() - began:6.1f} s  {done.returncode}  {line}", file=sys.stderr)
        out = self.plain(done.stdout)
        err = self.plain(done.stderr)
        return {"code": done.returncode, "out": out, "err": err}

    def plain(self, text: str) -> list[str]:
        """Return lines without folders, times, sizes and progress bars."""
        text = text.replace(str(self.checkout), "CHECKOUT").replace(str(self.place), "FOLDER")
        for pattern, stands_for in CHANGING:
            text = re.sub(pattern, stands_for, text)
        lines = [line.rsplit("\r", 1)[-1].rstrip() for line in text.splitlines()]
        return [line for line in lines if "%|" not in line]


def commands(folder: Folder, lines: str) -> dict[str, Any]:
    """Return the outcome of each line, in order; a repeated line has its number behind it."""
    outcomes: dict[str, Any] = {}
    for line in lines.splitlines():
        if line.startswith("#"):
            continue
        again = sum(key.split(" #")[0] == line for key in outcomes)
        outcomes[f"{line} #{again + 1}" if again else line] = folder.run(line)
    return outcomes


def dataset_digests(root: Path) -> dict[str, str]:
    """Return the digest of every column of every table, and of every other file, by path."""
    digests = {}
    for file in sorted(path for path in root.rglob("*") if path.is_file()):
        name = file.relative_to(root).as_posix()
        if file.suffix != ".parquet":
            digests[name] = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
            continue
        table = pq.read_table(file)
        for column in table.column_names:
            values = repr(table[column].to_pylist()).encode()
            digests[f"{name}: {column}"] = hashlib.sha256(values).hexdigest()[:16]
    return digests


def rows(folder: Folder) -> dict[str, Any]:
    """Return the rows of each policy by seed, as text that tells equal floats from different."""
    found = {}
    for policy in POLICIES:
        name = policy.rsplit("/", 1)[-1]
        out = f"rows/{name}"
        folder.run(
            f"dynahoi evaluate --policy {policy} --split val --episodes {EPISODES} --out {out}"
        )
        table = pq.read_table(folder.place / out / "episodes.parquet").to_pylist()
        found[name] = {str(row["seed"]): {k: repr(v) for k, v in row.items()} for row in table}
    return found


def pinned(checkout: Path) -> str:
    """Return the digest of the file of pinned episode digests."""
    file = checkout / "tests" / "sampling" / "benchmark_digests.json"
    return hashlib.sha256(file.read_bytes()).hexdigest()


def record(checkout: Path, parts: list[str]) -> dict[str, Any]:
    """Return the record of a checkout; of ``parts`` alone."""
    made: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Folder(checkout, Path(place))
        if "commands" in parts:
            made["commands"] = commands(folder, COMMANDS.read_text())
        if "digests" in parts:
            made["digests"] = pinned(checkout)
        if "datasets" in parts:
            made["datasets"] = {}
            for rule, line in DATASETS.items():
                shutil.rmtree(folder.place / rule, ignore_errors=True)
                folder.run(line)
                made["datasets"][rule] = dataset_digests(folder.place / rule)
        if "rows" in parts:
            made["rows"] = rows(folder)
    return made


PARTS = ("commands", "digests", "datasets", "rows")


def flat(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield (name, text) of every leaf of a record."""
    if isinstance(value, Mapping):
        for key, child in value.items():
            yield from flat(child, f"{name} > {key}" if name else str(key))
    elif isinstance(value, list):
        yield name, "\n".join(value)
    else:
        yield name, str(value)


def diff(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a diff, of each leaf that differs."""
    old = dict(flat(before))
    new = dict(flat(after))
    for name in [*old, *(name for name in new if name not in old)]:
        if name in old and name in new and old[name] == new[name]:
            continue
        yield f"== {name}"
        lines = difflib.unified_diff(
            old.get(name, "").splitlines(), new.get(name, "").splitlines(), lineterm="", n=0
        )
        yield from list(lines)[2:]


def main() -> None:
    """Record a checkout, or print how two records differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    tasks = parser.add_subparsers(dest="task", required=True)
    recorder = tasks.add_parser("record", help="run a checkout and write its record")
    recorder.add_argument("--checkout", type=Path, required=True)
    recorder.add_argument("--out", type=Path, required=True)
    recorder.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    differ = tasks.add_parser("diff", help="print how two records differ")
    differ.add_argument("before", type=Path)
    differ.add_argument("after", type=Path)
    args = parser.parse_args()
    if args.task == "record":
        made = record(args.checkout, args.only)
        args.out.write_text(json.dumps(made, indent=1) + "\n")
    else:
        before, after = (json.loads(path.read_text()) for path in (args.before, args.after))
        print(*diff(before, after), sep="\n")


if __name__ == "__main__":
    main()
