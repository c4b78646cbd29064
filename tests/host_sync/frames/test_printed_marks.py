"""Printed marks: found where untouched skin shows a pattern of them, and taken out wherever the skin has moved them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from device.imaging.flat_field import LinearFrame
from device.imaging.printed_marks import MarkPattern
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.linear_light import read_frame

SHAPE = (240, 320)


def skin(seed: int = 1) -> LinearFrame:
    """Smooth light of three lamps with some noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    light = np.stack([0.3 + 0.3 * column, 0.6 - 0.3 * row, 0.5 - 0.2 * column], axis=-1)
    light *= 1.0 + 0.01 * np.random.default_rng(seed).standard_normal(light.shape)
    return LinearFrame(light.astype(np.float32), np.zeros(SHAPE, np.bool_))


def marked(frame: LinearFrame, places: np.ndarray, width: int = 6) -> LinearFrame:
    rgb = frame.rgb.copy()
    for row, column in places:
        rgb[row : row + width, column : column + width] *= 0.15
    return replace(frame, rgb=rgb)


def lattice(shift: int = 0) -> np.ndarray:
    return np.array([(row, column) for row in range(20 + shift, 220, 30) for column in range(15 + shift, 300, 30)])


def test_marks_are_taken_out_where_the_skin_has_moved_them() -> None:
    pattern = MarkPattern.of(marked(skin(), lattice()))
    assert pattern is not None
    assert pattern.width_px == pytest.approx(6.0, abs=1.5)
    moved = marked(skin(2), lattice(4))
    left = pattern.taken_out_of(moved).rgb / skin(2).rgb
    assert np.abs(left - 1.0).max() < 0.1
    assert np.abs(moved.rgb / skin(2).rgb - 1.0).max() > 0.8
    assert f"{pattern.covered:.0%} of the skin" in pattern.note


def test_scans_of_a_set_are_read_without_the_marks_of_its_or_its_calibrations_untouched_skin(tmp_path: Path) -> None:
    for name, frame in (("flat", marked(skin(), lattice())), ("scan", marked(skin(2), lattice(4)))):
        counts = np.rint(65535.0 * frame.rgb[..., ::-1].clip(0.0, 1.0)).astype(np.uint16)
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), counts)
    head = 'name = "dots"\npixel_pitch_um = 20\nencoding = "linear"\nfull_scale = 65535\n'
    scan = '[[scan]]\nname = "scan"\nimage = "scan.png"\n'
    (tmp_path / "own.toml").write_text(head + '[reference]\nimage = "flat.png"\n' + scan)
    (tmp_path / "other.toml").write_text(head + scan)
    own, other = (load_frame_set(tmp_path / f"{name}.toml", calibrates=False) for name in ("own", "other"))
    for found, clean in ((own, True), (other, False), (other.with_marks(6.0), True)):
        left = read_frame(found.scans[0].frame).rgb / skin(2).rgb
        assert bool(np.abs(left - 1.0).max() < 0.1) == clean


def test_a_wide_shadow_is_no_mark() -> None:
    pattern = MarkPattern.of(marked(skin(), lattice()))
    assert pattern is not None
    shaded = marked(skin(), np.array([(100, 150)]), width=24)
    middle = np.s_[108:116, 158:166]
    assert np.array_equal(pattern.taken_out_of(shaded).rgb[middle], shaded.rgb[middle])


def test_clean_skin_dirt_and_marks_too_dense_show_no_pattern() -> None:
    dirt = np.random.default_rng(3).integers((5, 5), (220, 300), (12, 2))
    dense = np.array([(row, column) for row in range(6, 230, 14) for column in range(6, 310, 14)])
    for frame in (skin(), marked(skin(), dirt), marked(skin(), dense)):
        assert MarkPattern.of(frame) is None
