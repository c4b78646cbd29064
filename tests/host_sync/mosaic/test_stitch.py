"""Mosaics of presses with known places, levels and errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from mosaic_presses import PITCH_UM, Target, errors_px, grid_places, press_of_map, pressed, rough_target

from device.align import Pose
from device.surface import Float32Array, MaskArray
from host_sync.errors import MosaicError
from host_sync.measurement.measure import measure_result
from host_sync.measurement.recipe import Recipe
from host_sync.mosaic.links import Layout
from host_sync.mosaic.presses import Press
from host_sync.mosaic.stitch import planned, stitch
from host_sync.mosaic.writing import MosaicRecord
from host_sync.results.reader import read_result

SHAPE = (136, 182)
STEP_PX = (95.0, 127.0)
REACH_PX = 0.5 * float(np.hypot(*SHAPE))


def presses_of(target: Target, truth: list[Pose], seed: int = 5) -> list[Press]:
    random = np.random.default_rng(seed)
    return [press_of_map(f"p{number}", pressed(target, place, SHAPE, random)) for number, place in enumerate(truth)]


@pytest.fixture(scope="module")
def truth() -> list[Pose]:
    return grid_places(3, 3, STEP_PX, np.random.default_rng(1))


@pytest.fixture(scope="module")
def target() -> Target:
    return rough_target((430, 560))


@pytest.fixture(scope="module")
def stranger() -> Press:
    """A press of something else."""
    random = np.random.default_rng(8)
    return press_of_map("stranger", pressed(rough_target((200, 250), seed=17), Pose(), SHAPE, random))


@pytest.fixture(scope="module")
def mosaic(
    target: Target, truth: list[Pose], stranger: Press, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, MosaicRecord]:
    out = tmp_path_factory.mktemp("mosaic") / "whole"
    return out, stitch([*presses_of(target, truth), stranger], out)


def truth_on(record: MosaicRecord, target: Target, truth: list[Pose], shape: tuple[int, ...]) -> Float32Array:
    """The target at the mosaic's pixels, from the record's places of three presses."""
    found = np.array([[place.row_px, place.column_px] for place in record.presses])
    real = np.array([[place.down, place.right] for place in truth])
    design = np.hstack([found, np.ones((len(found), 1))])
    rule = np.linalg.lstsq(design, real, rcond=None)[0]
    row, column = np.meshgrid(*(np.arange(size) for size in shape), indexing="ij")
    at = np.stack([row, column, np.ones_like(row)], axis=-1) @ rule + 0.5 * (np.array(target.z_um.shape) - 1)
    seen = cv2.remap(target.z_um, at[..., 1].astype(np.float32), at[..., 0].astype(np.float32), cv2.INTER_CUBIC)
    return np.asarray(seen, np.float32)


def errors_um(z_um: Float32Array, true_um: Float32Array) -> tuple[Float32Array, MaskArray]:
    """Errors of the heights but for a plane, shape (N,), and where heights are known, shape (H, W)."""
    error = z_um - true_um
    row, column = np.meshgrid(*(np.arange(size) for size in error.shape), indexing="ij")
    known = np.isfinite(error)
    design = np.stack([np.ones(known.sum()), row[known], column[known]], axis=-1)
    return error[known] - design @ np.linalg.lstsq(design, error[known], rcond=None)[0], known


def test_heights_are_the_targets_to_the_stated_uncertainty(
    mosaic: tuple[Path, MosaicRecord], target: Target, truth: list[Pose]
) -> None:
    out, record = mosaic
    result = read_result(out)
    assert result.height.pitch_um == PITCH_UM
    rest, known = errors_um(result.height.z_um, truth_on(record, target, truth, result.height.z_um.shape))
    assert result.sigma_um is not None
    assert np.array_equal(np.isfinite(result.sigma_um), known)
    assert rest.std() < 1.3  # one press has 1 µm
    assert np.mean(np.abs(rest) < 2.0 * result.sigma_um[known]) > 0.8


def test_spans_are_true_to_a_thousandth(mosaic: tuple[Path, MosaicRecord], truth: list[Pose]) -> None:
    _, record = mosaic
    found = np.array([[place.row_px, place.column_px] for place in record.presses])
    real = np.array([[place.down, place.right] for place in truth])
    for one in range(9):
        for other in range(one):
            length = float(np.linalg.norm(real[one] - real[other]))
            assert np.linalg.norm(found[one] - found[other]) == pytest.approx(length, rel=1e-3, abs=0.2)
    assert record.span_sigma_um < 0.5 * PITCH_UM


def test_no_step_is_left_at_a_seam(mosaic: tuple[Path, MosaicRecord]) -> None:
    _, record = mosaic
    assert len(record.used) >= 12
    assert all(link.seam_sigmas is not None and link.seam_sigmas < 2.0 for link in record.used)
    assert record.stretch_median == pytest.approx(0.0, abs=1e-3)


def test_what_overlaps_with_nothing_is_left_out_and_said(mosaic: tuple[Path, MosaicRecord]) -> None:
    out, record = mosaic
    assert record.left_out == ("stranger",)
    assert not any("stranger" in (link.first, link.second) for link in record.used)
    assert any("stranger" in doubt.reason for doubt in read_result(out).doubts)


def test_a_mosaic_is_measured_as_any_result_is(mosaic: tuple[Path, MosaicRecord]) -> None:
    found = measure_result(mosaic[0], Recipe(parameters=("Sa", "Sz")))
    assert {one.name for one in found.quantities} >= {"Sa", "Sz"}
    assert not found.failed


def test_a_layout_leaves_out_what_is_far_apart(target: Target, truth: list[Pose]) -> None:
    presses = presses_of(target, truth)[:3]
    places = np.array([[place.down, place.right] for place in truth[:3]])
    near = planned(presses, layout=Layout(places, 30.0))
    assert len(near.places) == 3
    assert not any(abs(link.first - link.second) == 2 for link in (*near.links, *near.refused))
    found = [near.places[number] for number in range(3)]
    assert errors_px(list(found), truth[:3], REACH_PX).max() < 1.0
    with pytest.raises(MosaicError, match="no two presses overlap"):
        planned(presses, layout=Layout(places * 100.0, 30.0))


def test_presses_that_do_not_go_together_are_refused(stranger: Press, target: Target, truth: list[Pose]) -> None:
    with pytest.raises(MosaicError, match="two presses or more"):
        planned([stranger])
    with pytest.raises(MosaicError, match="two presses are named stranger"):
        planned([stranger, stranger])
    coarser = press_of_map("coarser", stranger.read().z_um, pitch_um=20.0)
    with pytest.raises(MosaicError, match="need one pitch"):
        planned([stranger, coarser])
    empty = press_of_map("empty", np.full(SHAPE, np.nan, np.float32))
    with pytest.raises(MosaicError, match="empty: holds too few heights"):
        planned([stranger, empty])


def on_two_calibrations(target: Target, truth: list[Pose], gains: tuple[float, float]) -> list[Press]:
    """Presses whose calibrations take turns: one is three times as uncertain, and each has a gain of its own."""
    random = np.random.default_rng(6)
    found = []
    for number, place in enumerate(truth):
        which, sigma_um = number % 2, (1.0, 3.0)[number % 2]
        z_um = pressed(target, place, SHAPE, random, sigma_um) * np.float32(gains[which])
        press = press_of_map(f"p{number}", z_um, sigma_um)
        found.append(
            replace(press, record=msgspec.structs.replace(press.record, calibration_id=f"calibration-{which}"))
        )
    return found


def test_presses_of_two_calibrations_become_one_with_seams_within_their_uncertainty(
    target: Target, truth: list[Pose], tmp_path: Path
) -> None:
    record = stitch(on_two_calibrations(target, truth, (1.0, 1.0)), tmp_path / "whole")
    assert (record.left_out, record.rejected) == ((), ())
    across = [link for link in record.used if int(link.first[1:]) % 2 != int(link.second[1:]) % 2]
    assert len(across) >= 12
    for link in across:
        # 1 and 3 µm: the σ of a seam is that of both, neither far too large nor too small; levels take some of it.
        assert link.seam_sigmas is not None
        assert 0.2 < link.seam_sigmas < 2.0
    result = read_result(tmp_path / "whole")
    assert result.record.calibration_id == "calibration-0 calibration-1"
    assert not any("heights differ" in doubt.reason for doubt in result.doubts)
    assert result.sigma_um is not None
    rest, known = errors_um(result.height.z_um, truth_on(record, target, truth, result.height.z_um.shape))
    sigmas = rest / result.sigma_um[known]
    assert np.mean(np.abs(sigmas) < 2.0) > 0.9
    assert np.sqrt(np.mean(sigmas**2)) > 0.3  # nor is σ far too large


def test_calibrations_that_differ_by_more_than_their_uncertainty_are_a_doubt(
    target: Target, truth: list[Pose], tmp_path: Path
) -> None:
    record = stitch(on_two_calibrations(target, truth, (1.0, 1.2)), tmp_path / "whole")
    assert max(link.seam_sigmas or 0.0 for link in record.used) > 2.0
    doubts = [doubt.reason for doubt in read_result(tmp_path / "whole").doubts]
    assert any("heights differ by more than 2 σ where presses overlap" in words for words in doubts)
