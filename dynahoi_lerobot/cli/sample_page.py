"""``dynahoi view --sample``: a few episodes of every kind of motion on one page, with what they
hold frame by frame.
"""

import io
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from PIL import Image

from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP
from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.core.escaping import data_url
from dynahoi_lerobot.core.files import write_text_atomically
from dynahoi_lerobot.core.protocols import is_acting
from dynahoi_lerobot.dataset.columns import column_array
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.store import Store, frame_column

TEMPLATE = Path(__file__).with_suffix(".html")
SHEET_COLUMNS = 12
"""Images in a row of an episode's sheet."""
JPEG_QUALITY = 80


def write_sample(out: Path, store: Store, key: str, per_kind: int) -> int:
    """Write a page with ``per_kind`` episodes of each kind of motion, spread evenly over a dataset;
    return how many.

    The dataset's episode table has the column ``motion``; ``key`` is that of the images to show.
    """
    chosen = stratified([row["motion"] for row in store.rows], per_kind)
    columns = {name: column(store.root, name) for name in ("target.pose", "observation.phase")}
    # in the order of the dataset, in which each of its files is read once
    shown = {index: _episode(store, index, key, columns) for index in sorted(chosen)}
    episodes = [shown[index] for index in chosen]
    _scale_closing(episodes)
    data = {"episodes": episodes, "columns": SHEET_COLUMNS, "command": removal_command(store.root)}
    text = filled(
        TEMPLATE,
        data,
        title=f"{len(chosen)} of the {store.episodes} episodes of {store.root}",
        has_target=any("target" in episode for episode in episodes),
    )
    write_text_atomically(out, text)
    return len(chosen)


def stratified(kinds: list[str], per_kind: int) -> list[int]:
    """Return up to ``per_kind`` indices of each kind, spread evenly over its indices; kinds in
    alphabetical order.
    """
    chosen = []
    for kind in sorted(set(kinds)):
        own = [index for index, other in enumerate(kinds) if other == kind]
        places = np.linspace(0, len(own) - 1, min(per_kind, len(own)))
        chosen += [own[round(place)] for place in places]
    return chosen


def read_episode(store: Store, index: int, key: str) -> tuple[EpisodeRow, pa.Table, np.ndarray]:
    """Return an episode's row, its T frames, and its (T, H, W, 3) uint8 images ``key``."""
    row = store.row(index)
    table = store.frames(row)
    return row, table, store.images(row, table, key)


def removal_command(root: Path) -> str:
    """Return the command that writes the dataset without some episodes, up to their list."""
    kept = root.with_name(f"{root.name}_kept")
    words = ["lerobot-edit-dataset", f"--repo_id=local/{root.name}", f"--root={root}"]
    words += [
        f"--new_repo_id=local/{kept.name}",
        f"--new_root={kept}",
        "--operation.type=delete_episodes",
    ]
    return f"{shlex.join(words)} --operation.episode_indices"


def column(root: Path, name: str) -> np.ndarray | None:
    """Return a column of all frames, None if the dataset lacks it."""
    try:
        return frame_column(root, name)
    except ValueError:
        return None


def _episode(
    store: Store, index: int, key: str, columns: dict[str, np.ndarray | None]
) -> dict[str, Any]:
    """Return what the page shows of an episode; positions are (T, 3) lists [m], home frame."""
    row, table, images = read_episode(store, index, key)
    frames = slice(row["dataset_from_index"], row["dataset_to_index"])
    state, action = found = [column_array(table, name) for name in ("observation.state", "action")]
    least = min(array.shape[1] for array in found)
    if least <= PALM_DOF:
        raise ValueError(
            f"its state and action must have more than {PALM_DOF} numbers, got {least}"
        )
    grasp = store.features["action"]["names"] == [*CONTROL_MODES[GRASP]]
    goal = action[:, :PALM_DOF] + (state[:, :PALM_DOF] if grasp else 0.0)
    closing = {
        "palm": state[:, PALM_DOF:].mean(axis=1),
        "action": action[:, PALM_DOF:].mean(axis=1),
    }
    told = {"palm": state[:, :PALM_DOF], "action": goal}
    pose = columns["target.pose"]
    if pose is not None:
        told["target"] = pose[frames, :PALM_DOF]
    phase = columns["observation.phase"]
    window = 0 if phase is None else int((~is_acting(phase[frames])).sum())
    return {
        "index": index,
        "kind": row["motion"],
        "task": row["tasks"][0],
        "success": bool(row.get("success", True)),
        "frames": len(images),
        "window": window,
        "grasp": grasp,
        "closing": closing,
        "sheet": sheet(images),
    } | {name: np.round(values, 4).tolist() for name, values in told.items()}


def _scale_closing(episodes: list[dict[str, Any]]) -> None:
    """Express mean joint angles as shares of the greatest one shown; a grasp's closing number is
    one already.
    """
    angles = [
        e["closing"][name]
        for e in episodes
        for name in ("palm", "action")
        if name == "palm" or not e["grasp"]
    ]
    most = max((float(values.max()) for values in angles), default=0.0) or 1.0
    for episode in episodes:
        for name, values in episode["closing"].items():
            share = values if name == "action" and episode["grasp"] else values / most
            episode["closing"][name] = np.round(np.clip(share, 0.0, 1.0), 3).tolist()


def sheet(images: np.ndarray) -> str:
    """Return a data URL of all images (T, H, W, 3) uint8, ``SHEET_COLUMNS`` in a row."""
    height, width = images.shape[1:3]
    whole = Image.new("RGB", (SHEET_COLUMNS * width, -(-len(images) // SHEET_COLUMNS) * height))
    for i, image in enumerate(images):
        place = (i % SHEET_COLUMNS * width, i // SHEET_COLUMNS * height)
        whole.paste(Image.fromarray(image), place)
    buffer = io.BytesIO()
    whole.save(buffer, "JPEG", quality=JPEG_QUALITY)
    return data_url("image/jpeg", buffer.getvalue())


def filled(template: Path, data: dict[str, Any], **words: Any) -> str:
    """Return a page in whose script element ``data`` lies, which cannot end it."""
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    return environment.from_string(template.read_text("utf-8")).render(data=Markup(text), **words)
