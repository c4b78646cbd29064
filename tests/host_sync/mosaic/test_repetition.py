"""A ruler whose graduations are all alike: loops of wrong places close, so that only a close layout helps."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from mosaic_presses import Target, errors_px, grid_places, press_of_map, pressed, rough_target

from device.align import Pose
from host_sync.errors import MosaicError
from host_sync.mosaic.links import Layout
from host_sync.mosaic.presses import Press, Small, small_of
from host_sync.mosaic.stitch import period_px, planned, stitch
from host_sync.results.record import read_record

SHAPE = (136, 182)
PERIOD_PX = 20.83


def ruler() -> tuple[list[Press], list[Pose]]:
    """Five presses along it and where they are."""
    random = np.random.default_rng(2)
    column = np.arange(900)
    z_um = np.zeros((300, 900), np.float32)
    z_um[:170] -= np.where(column % PERIOD_PX < 3.0, 40.0, 0.0).astype(np.float32)
    target = Target(cv2.GaussianBlur(z_um, (0, 0), 1.5))
    truth = grid_places(1, 5, (95.0, 127.0), random)
    return [press_of_map(f"part-{n}", pressed(target, at, SHAPE, random)) for n, at in enumerate(truth)], truth


def layout(truth: list[Pose], within_px: float) -> Layout:
    return Layout(np.array([[at.down, at.right] for at in truth]), within_px)


def test_a_ruler_needs_to_be_given_where_its_presses_are() -> None:
    presses, _ = ruler()
    with pytest.raises(MosaicError, match=r"the relief repeats every [0-9.]+ mm"):
        planned(presses)


def test_a_close_layout_settles_it_and_a_wide_one_is_doubted(tmp_path: Path) -> None:
    presses, truth = ruler()
    near = planned(presses, layout=layout(truth, 8.0))
    assert near.period_px is None
    assert np.nanmax(errors_px([near.places.get(n) for n in range(5)], truth, 0.0)) < 0.5
    record = stitch(presses, tmp_path / "whole", layout=layout(truth, 62.5))
    assert record.period_um is not None
    assert record.period_um / presses[0].record.pixel_pitch_um == pytest.approx(PERIOD_PX, rel=0.1)
    assert any("the relief repeats" in words for words in read_record(tmp_path / "whole").warnings)


def test_what_does_not_repeat_has_no_period() -> None:
    random = np.random.default_rng(3)
    place = grid_places(1, 1, (95.0, 127.0), random)[0]
    rough = press_of_map("rough", pressed(rough_target((330, 430)), place, SHAPE, random))
    assert period_px(small_of(rough)) is None
    z_um = np.zeros(SHAPE, np.float32)
    z_um[:, 80:] = 50.0
    groove = cv2.GaussianBlur(z_um, (0, 0), 2.0) + random.normal(0.0, 0.05, SHAPE).astype(np.float32)
    assert period_px(Small(groove, np.ones(SHAPE, np.float32), 1, SHAPE)) is None, "an edge is alike all along"
