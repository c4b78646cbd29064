"""The same spot again: a dent is found where it is, nothing is found where nothing changed, strangers are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mosaic_presses import press_of_map, pressed, rough_target, write_press

from device.align import Pose
from device.surface import Float32Array, HeightMap
from host_sync.cli.main import main
from host_sync.registration.difference import are_copies, difference
from host_sync.same_spot.changes import WIDTH_TO_DIAMETER, changes

SHAPE = (160, 200)
PITCH_UM = 48.0
DENT = (70, 110)
"""Row and column of the dent on the first press."""


def two_presses(dent_um: float, seed: int = 4, target_seed: int = 3) -> tuple[Float32Array, Float32Array]:
    """Two presses of one target, the second shifted and turned; dented in between."""
    random = np.random.default_rng(seed)
    target = rough_target((400, 400))
    first = pressed(target, Pose(0.0, 0.0, 0.0), SHAPE, random, 0.3)
    if target_seed != 3:
        target = rough_target((400, 400), target_seed)
    row, column = np.mgrid[:400, :400] - np.float32(0.5 * 399)
    away = np.hypot(row - (DENT[0] - 79.5), column - (DENT[1] - 99.5))
    target.z_um[...] -= np.float32(dent_um) * np.exp(-0.5 * (away / 5.0) ** 2).astype(np.float32)
    return first, pressed(target, Pose(6.0, -9.0, 0.03), SHAPE, random, 0.3)


@pytest.fixture
def results(tmp_path: Path) -> tuple[str, str]:
    before, after = (
        write_press(press_of_map(name, z_um), tmp_path)
        for name, z_um in zip(("before", "after"), two_presses(12.0), strict=True)
    )
    return str(before), str(after)


def test_a_dent_is_found_where_it_is_with_its_height() -> None:
    first, second = (HeightMap(z_um, PITCH_UM) for z_um in two_presses(12.0))
    found = changes(first, difference(first, second))
    assert len(found.found) == 1
    dent = found.found[0]
    assert np.hypot(dent.row_um / PITCH_UM - DENT[0], dent.column_um / PITCH_UM - DENT[1]) < 0.5
    assert dent.height_um == pytest.approx(-12.0, abs=2.0 * dent.sigma_um)
    assert dent.diameter_um == pytest.approx(5.0 * WIDTH_TO_DIAMETER * PITCH_UM, rel=0.1)


def test_nothing_is_found_where_nothing_changed_and_the_limit_is_stated() -> None:
    first, second = (HeightMap(z_um, PITCH_UM) for z_um in two_presses(0.0))
    found = changes(first, difference(first, second))
    assert found.found == ()
    assert found.judged_share > 0.5
    diameters = [limit.diameter_um for limit in found.limits]
    assert diameters == sorted(diameters)
    assert all(0.1 < limit.height_um < 12.0 for limit in found.limits)


@pytest.mark.parametrize("diameter", [0, 1, 2])
def test_a_change_as_high_as_its_detection_limit_is_listed_with_its_sign(diameter: int) -> None:
    first, second = (HeightMap(z_um, PITCH_UM) for z_um in two_presses(0.0))
    rest = difference(first, second)
    # Errors of slopes give heights that err most at long waves: beside a narrow change other things rise higher.
    random = np.random.default_rng(5).standard_normal(SHAPE)
    waves = [cv2.GaussianBlur(random, (0, 0), width) for width in (9.0, 13.0, 18.0)]
    hills = sum(wave / wave.std() * height for wave, height in zip(waves, (6.0, 12.0, 24.0), strict=True))
    rest = replace(rest, z_um=(rest.z_um + hills).astype(np.float32))
    limit = changes(first, rest).limits[diameter]
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    width_px = limit.diameter_um / WIDTH_TO_DIAMETER / PITCH_UM
    listed = []
    for at in ((60, 80), (80, 100), (100, 120)):
        dent = limit.height_um * np.exp(-0.5 * ((row - at[0]) ** 2 + (column - at[1]) ** 2) / width_px**2)
        found = changes(first, replace(rest, z_um=(rest.z_um - 1.2 * dent).astype(np.float32))).found
        away = [np.hypot(one.row_um / PITCH_UM - at[0], one.column_um / PITCH_UM - at[1]) for one in found]
        listed += [one.height_um / limit.height_um for one, far in zip(found, away, strict=True) if far < 3.0]
    print(listed)  # noqa: T201
    assert len(listed) == 3
    assert all(-1.5 < share < -0.9 for share in listed)


def ball_on_skin(gain: float) -> Float32Array:
    """A cap on skin at rest that is exactly level, its relief read by some gain, with waves of 0.3 µm on the cap."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cap = np.maximum(1.0 - ((row - 80.0) ** 2 + (column - 100.0) ** 2) / 45.0**2, 0.0)
    waves = cv2.GaussianBlur(np.random.default_rng(6).standard_normal(SHAPE), (0, 0), 4.0)
    return (cap * (400.0 * gain + 3.0 * waves * (gain != 1.0))).astype(np.float32)


def test_skin_at_rest_does_not_make_errors_of_the_object_a_change() -> None:
    first, second = ball_on_skin(1.0), ball_on_skin(1.01)
    rest = replace(difference(*(HeightMap(z_um, PITCH_UM) for z_um in two_presses(0.0))), z_um=second - first)
    height = HeightMap(first, PITCH_UM)
    assert len(changes(height, rest).found) > 5
    found = changes(height, rest, (first == 0.0) & (second == 0.0))
    assert found.found == ()
    assert 0.1 < found.judged_share < 0.3
    assert found.limits[0].height_um > 1.0


def test_a_place_far_more_uncertain_than_the_field_must_change_more() -> None:
    first, second = (HeightMap(z_um, PITCH_UM) for z_um in two_presses(12.0))
    rest = difference(first, second)
    (dent,) = changes(first, replace(rest, sigma_um=np.full(SHAPE, 4.0, np.float32))).found
    row, column = (round(where / PITCH_UM) for where in (dent.row_um, dent.column_um))
    uncertain = np.full(SHAPE, 1.0, np.float32)
    uncertain[row - 20 : row + 20, column - 20 : column + 20] = 6.0
    assert changes(first, replace(rest, sigma_um=uncertain)).found == ()


def test_where_the_object_moved_far_the_uncertainty_of_both_heights_counts() -> None:
    first, second = (HeightMap(z_um, PITCH_UM) for z_um in two_presses(12.0))
    rest = difference(first, second)
    rest = replace(rest, sigma_um=np.full(SHAPE, 4.0, np.float32))
    near = changes(first, rest)
    far = changes(first, replace(rest, shift_um=(0.0, 5000.0)))
    assert len(near.found) == 1
    assert far.found == ()
    assert all(one.height_um > 13.5 / 2.5 * 4.0 for one in far.limits)
    assert changes(first, replace(rest, turn_deg=90.0)).found == ()
    high = changes(first, replace(rest, shift_um=(0.0, 5000.0), z_um=3.0 * rest.z_um)).found
    assert len(high) == 1
    assert high[0].sigma_um > 4.0 > near.found[0].sigma_um


def test_the_command_writes_difference_sigma_picture_and_record(
    results: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "change"
    assert main(["compare", *results, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "changed: -1" in said
    assert "no other change at this spot beyond" in said
    names = {"difference_um.tif", "difference_sigma_um.tif", "difference.png", "same_spot.json"}
    assert {path.name for path in out.iterdir()} == names
    record = json.loads((out / "same_spot.json").read_text())
    assert record["height_sigma_median_um"] == pytest.approx(2.0**0.5, rel=0.01)
    assert len(record["changes"]) == 1
    assert main(["compare", *results, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == record


def test_another_object_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [
        str(write_press(press_of_map(name, z_um), tmp_path))
        for name, z_um in zip(("before", "after"), two_presses(0.0, target_seed=8), strict=True)
    ]
    assert main(["compare", *folders]) != 0
    said = capsys.readouterr()
    assert said.err.startswith("retrosync: not registered: ")
    assert not said.out


def test_a_folder_with_something_else_is_not_replaced(
    results: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *results, "--out", results[0]]) != 0
    assert (Path(results[0]) / "result.json").is_file()
    assert capsys.readouterr().err


def test_a_press_is_not_compared_with_itself(results: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", results[0], f"{results[0]}/../{Path(results[0]).name}"]) == 2
    assert "are one result: name an earlier and a later press" in capsys.readouterr().err


def test_copies_of_one_press_are_no_two_presses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = two_presses(0.0)
    rounded = first + np.float32(2e-5) * np.random.default_rng(0).standard_normal(first.shape).astype(np.float32)
    assert are_copies(first, first)
    assert are_copies(first, rounded)
    assert not are_copies(first, second)
    assert not are_copies(first, first[1:])
    names = [str(write_press(press_of_map(name, z_um), tmp_path)) for name, z_um in (("one", first), ("copy", rounded))]
    assert main(["compare", *names]) == 2
    assert "they are copies of one press, not two presses" in capsys.readouterr().err
    assert main(["mosaic", *names, "--out", str(tmp_path / "mosaic")]) == 2
    assert "copy: is a copy of one, not another press" in capsys.readouterr().err
