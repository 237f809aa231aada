"""``dynahoi quickstart``, the first command that anyone runs: all of it, shortened."""

from pathlib import Path

import pytest
import yaml

from dynahoi_lerobot.cli import quickstart
from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.sampling.benchmark import MOTIONS
from tests.report.example_runs import example_run
from tests.tools import dynahoi

STANDARD = Path(__file__).parents[2] / "recipes" / "train" / "obact.yaml"
"""What the quickstart shortens; wheels hold only the copy."""


def test_it_trains_the_recipe_shortened_on_all_kinds_of_motion() -> None:
    original, copy = (yaml.safe_load(path.read_text()) for path in (STANDARD, quickstart.TRAINING))
    assert copy["policy"].pop("delayed_share") == 0, "its simulation waits"
    differs = {key for key in copy.keys() | original.keys() if copy.get(key) != original.get(key)}
    assert differs <= {"dataset", "output_dir", "env", "eval", "env_eval_freq"}
    assert sorted(quickstart.Options().kinds) == sorted(MOTIONS)


def tiny(out: Path) -> quickstart.Options:
    return quickstart.Options(out=out, tiny=True, **quickstart.TINY)


def test_it_trains_on_the_device_it_is_evaluated_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[list[str]] = []
    monkeypatch.setattr(quickstart, "_device", lambda: "cuda")

    def run_lerobot(_: str, words: list[str], *__: object) -> None:
        said.append(words)
        raise CommandError("code 1")

    monkeypatch.setattr(quickstart, "run_lerobot", run_lerobot)
    monkeypatch.setattr(quickstart, "_film", lambda out, _: out)
    for stage in (quickstart._train, quickstart._evaluate):
        with pytest.raises(CommandError):
            stage(tiny(tmp_path))
    assert all("--policy.device=cuda" in words for words in said)


def test_an_evaluation_that_stopped_halfway_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The environment writes results after every kind of motion, so a folder with some of them is
    not all.
    """
    partial = tmp_path / "results" / "obact.partial"
    results = tmp_path / "results" / "obact"
    errors = [CommandError("code 1")]

    def run_lerobot(_: str, words: list[str], *__: object) -> None:
        (made,) = (
            Path(word.partition("=")[2]) for word in words if word.startswith("--env.results_dir=")
        )
        assert partial in made.parents
        assert not made.exists(), "what an earlier run left is not mixed in"
        example_run(made, "obact", skill=0.5)
        if errors:
            raise errors.pop()

    monkeypatch.setattr(quickstart, "run_lerobot", run_lerobot)
    monkeypatch.setattr(quickstart, "_film", lambda *_: tmp_path / "film")
    with pytest.raises(CommandError, match="code 1"):
        quickstart._evaluate(tiny(tmp_path))
    assert not results.exists()
    quickstart._evaluate(tiny(tmp_path))
    assert read_results(results).rows
    assert not partial.exists()


def test_a_program_that_fails_is_named_with_its_log(tmp_path: Path) -> None:
    with progress_bar(total=1) as bar, pytest.raises(CommandError, match=r"lerobot_eval\.log"):
        quickstart.run_lerobot("eval", ["--no-such-option"], tmp_path, lambda: 1, bar)
    assert bar.n == 1
    assert "no-such-option" in (tmp_path / "lerobot_eval.log").read_text()


def test_options_decide_how_much_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[tuple[int, int, int, int]] = []

    def run_stages(options: quickstart.Options) -> None:
        per_kind = options.evaluation_episodes
        sizes.append((options.episodes, options.steps, per_kind, len(options.kinds)))

    monkeypatch.setattr(quickstart, "_run_stages", run_stages)
    monkeypatch.setattr(quickstart, "_conclude", lambda *_, **__: None)
    for words in (
        [],
        ["--episodes", "4", "--steps", "10", "--evaluation-episodes", "3"],
        ["--tiny"],
    ):
        dynahoi("quickstart", "--out", tmp_path / str(len(words)), *words)
    assert sizes == [(800, 400, 2, 22), (4, 10, 3, 22), (2, 5, 1, 2)]


def test_the_core_install_is_told_what_the_quickstart_needs(tmp_path, monkeypatch):
    monkeypatch.setattr(
        quickstart.importlib.util, "find_spec", lambda name: None if name == "torch" else name
    )
    said = dynahoi("quickstart", "--out", tmp_path / "quickstart", code=2).err
    assert "training needs torch: pip install" in said
    assert not any(tmp_path.iterdir())
