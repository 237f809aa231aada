"""The figure of offsets shows targets exactly at the threshold, and differs from column to column."""

from __future__ import annotations

import numpy as np

from docs.scripts.offset_figure import LABEL_PX, OFFSETS_M, OUT, draw, offset_worlds
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M, PALM_DOF


def test_targets_rest_at_the_threshold_along_both_axes():
    batch = offset_worlds(16)
    found = batch.target_pose[:, :3] - batch.state[:, :PALM_DOF]
    np.testing.assert_allclose(found, list(OFFSETS_M.values()), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), [0, *[LOCALIZATION_RADIUS_M] * 4], atol=1e-6)
    assert {tuple(np.sign(offset).astype(int)) for offset in found.round(4)} == {
        (0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0),
    }  # fmt: skip


def test_every_column_shows_the_target_elsewhere():
    sheet = np.asarray(draw(48)).astype(int)[LABEL_PX:]
    tiles = sheet.reshape(2, 48, len(OFFSETS_M), 48, 3).transpose(0, 2, 1, 3, 4)
    for view in tiles:
        for i, tile in enumerate(view):
            assert all((np.abs(tile - other).max(axis=-1) > 40).sum() >= 4 for other in view[:i])


def test_the_page_has_the_figure():
    assert OUT.is_file()
    assert f"({OUT.name})" in (OUT.parent / "paper.md").read_text()
