"""Contact of a ball: depth, area, centre and their ±; slip of the skin's texture; the table and the chart."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from host_sync.frames.sequence import BadFrame, StoredFrame
from host_sync.video.contact import (
    COLUMNS,
    ContactRow,
    SlipTracker,
    draw_contact_chart,
    find_contact,
    write_contact_table,
)
from host_sync.video.frame_solver import FrameStatistics
from host_sync.video.stream import SolvedFrame

SHAPE = (240, 320)
PITCH_UM = 20.0
CENTRE = (130.0, 170.0)


def cap_um(depth_um: float, centre: tuple[float, float] = CENTRE, radius_px: float = 30.0) -> np.ndarray:
    """A paraboloid that stands half as high at 30 / sqrt(2) pixels from its middle."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    square = ((row - centre[0]) ** 2 + (column - centre[1]) ** 2) / radius_px**2
    return (depth_um * np.maximum(1.0 - square, 0.0)).astype(np.float32)


def test_depth_area_and_centre_are_those_of_the_cap() -> None:
    found = find_contact(cap_um(400.0), PITCH_UM)
    assert found.depth_um == pytest.approx(400.0, rel=0.01)
    assert found.area_mm2 == pytest.approx(np.pi * (30.0 * PITCH_UM * 1e-3) ** 2 / 2.0, rel=0.02)
    assert found.centre == pytest.approx(CENTRE, abs=0.1)
    assert found.area_sigma_mm2 is found.centre_sigma_px is found.depth_sigma_um is None
    assert find_contact(cap_um(400.0)[:, ::-1], PITCH_UM).centre == pytest.approx((130.0, 319.0 - 170.0), abs=0.1)


def test_a_large_frame_is_reduced_and_its_centre_is_in_its_own_pixels() -> None:
    large = cv2.resize(cap_um(400.0), (1280, 960), interpolation=cv2.INTER_LINEAR)
    found = find_contact(large, PITCH_UM / 4.0)
    assert found.centre == pytest.approx(tuple(4.0 * place + 1.5 for place in CENTRE), abs=2.0)
    assert found.area_mm2 == pytest.approx(np.pi * (30.0 * PITCH_UM * 1e-3) ** 2 / 2.0, rel=0.03)


def test_uncertain_heights_make_an_uncertain_contact() -> None:
    sure, unsure = (find_contact(cap_um(400.0), PITCH_UM, np.full(SHAPE, sigma, np.float32)) for sigma in (4.0, 40.0))
    assert unsure.depth_sigma_um == 40.0
    # The area of a paraboloid grows in proportion to how much lower it is cut.
    whole_mm2 = np.pi * (30.0 * PITCH_UM * 1e-3) ** 2
    assert unsure.area_sigma_mm2 == pytest.approx(whole_mm2 * 40.0 / 400.0, rel=0.05)
    assert sure.area_sigma_mm2 < 0.2 * unsure.area_sigma_mm2


def test_nothing_touches_where_heights_are_within_noise_or_unknown() -> None:
    noise = np.random.default_rng(1).normal(0.0, 2.0, SHAPE).astype(np.float32)
    flat = find_contact(noise, PITCH_UM)
    assert flat.centre is None
    assert flat.area_mm2 == 0.0
    assert find_contact(cap_um(60.0), PITCH_UM, np.full(SHAPE, 40.0, np.float32)).centre is None
    unknown = find_contact(np.full(SHAPE, np.nan, np.float32), PITCH_UM)
    assert unknown.depth_um is None


def textures(steps: int, right_px: float, down_px: float, seed: int = 2) -> list[np.ndarray]:
    """Log light of a random texture that moves."""
    random = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(random.uniform(-1.0, 1.0, SHAPE).astype(np.float32), (0, 0), 1.5)
    moved = [np.float32([[1, 0, right_px * i], [0, 1, down_px * i]]) for i in range(steps)]
    return [0.2 * cv2.warpAffine(texture, way, SHAPE[::-1]) for way in moved]


def test_slip_is_the_way_of_the_texture_in_the_contact() -> None:
    contact, slip = find_contact(cap_um(400.0), PITCH_UM), SlipTracker()
    found = [slip.follow(light, contact) for light in textures(4, 1.5, -0.5)]
    assert found[0] == (0.0, 0.0)
    assert found[-1] == pytest.approx((-1.5, 4.5), abs=0.15)
    assert slip.follow(textures(1, 0.0, 0.0)[0], find_contact(np.zeros(SHAPE, np.float32), PITCH_UM)) is None
    assert slip.follow(textures(1, 0.0, 0.0)[0], contact) == (0.0, 0.0)


def test_slip_is_not_held_back_by_the_shading_of_the_object() -> None:
    contact, slip = find_contact(cap_um(400.0), PITCH_UM), SlipTracker()
    random = np.random.default_rng(3)
    shading = 0.01 * cv2.GaussianBlur(np.gradient(cap_um(400.0), axis=1), (0, 0), 2.0)
    for light in textures(8, 1.0, 0.0):
        noise = random.normal(0.0, 0.005, SHAPE)
        found = slip.follow((0.5 * light + shading + noise).astype(np.float32), contact)
    assert found == pytest.approx((0.0, 7.0), abs=0.7)


def test_slip_is_not_known_once_a_frame_shows_another_texture() -> None:
    contact, slip = find_contact(cap_um(400.0), PITCH_UM), SlipTracker()
    frames = [*textures(2, 1.0, 0.0), *textures(2, 1.0, 0.0, seed=5)]
    assert [slip.follow(light, contact) is None for light in frames] == [False, False, True, True]


def test_slip_is_not_known_from_a_frame_without_heights_until_the_next_contact() -> None:
    contact, slip = find_contact(cap_um(400.0), PITCH_UM), SlipTracker()
    unknown = find_contact(np.full(SHAPE, np.nan, np.float32), PITCH_UM)
    lights = textures(4, 1.0, 0.0)
    found = [slip.follow(light, one) for light, one in zip(lights, (contact, contact, unknown, contact), strict=True)]
    assert [one is None for one in found] == [False, False, True, True]


@pytest.mark.parametrize("value", [255, 200, 30])
def test_a_contact_without_texture_has_no_slip(value: int) -> None:
    contact, slip = find_contact(cap_um(400.0), PITCH_UM), SlipTracker()
    light = np.log1p(np.full(SHAPE, value, np.uint8), dtype=np.float32)
    assert [slip.follow(light, contact) for _ in range(2)] == [(0.0, 0.0), None]


def test_chance_does_not_make_a_small_contact_slip() -> None:
    contact = find_contact(cap_um(400.0, radius_px=12.0), PITCH_UM)
    known = 0
    for seed in range(30):
        slip = SlipTracker()
        slip.follow(textures(1, 0.0, 0.0, seed=seed)[0], contact)
        known += slip.follow(textures(1, 0.0, 0.0, seed=100 + seed)[0], contact) is not None
    assert known == 0


def test_slip_of_frames_stored_larger_is_in_lengths_on_the_skin() -> None:
    rows = []
    slip = SlipTracker()
    for number, light in enumerate(textures(3, 2.0, 0.0)):
        stored = cv2.resize(np.uint8(127.0 * np.exp(light)), (2 * SHAPE[1], SHAPE[0]), interpolation=cv2.INTER_CUBIC)
        one = replace(solved(number, cap_um(400.0)), frame=StoredFrame("frame", np.dstack([stored] * 3)))
        rows.append(ContactRow.of(one, number / 25.0, PITCH_UM, slip))
    assert rows[-1].slip_right_um == pytest.approx(4.0 * PITCH_UM, rel=0.1)
    assert rows[-1].slip_down_um == pytest.approx(0.0, abs=0.2 * PITCH_UM)


def solved(number: int, z_um: np.ndarray, reason: str | None = None) -> SolvedFrame:
    figures = None if reason else FrameStatistics(0.1, 0.0, 0.0, float(z_um.max()))
    frame = BadFrame("torn", reason) if reason else StoredFrame("frame", np.zeros((*SHAPE, 3), np.uint8))
    return SolvedFrame(number, "frame", z_um, np.full(SHAPE, 4.0, np.float32), figures, frame, reason)


def test_the_table_has_a_line_for_every_frame_and_the_chart_is_a_picture(tmp_path: Path) -> None:
    frames = [
        solved(0, cap_um(200.0)),
        solved(1, np.full(SHAPE, np.nan, np.float32), "torn: is cut"),
        solved(2, cap_um(300.0)),
    ]
    rows = [ContactRow.of(one, one.number / 25.0, PITCH_UM) for one in frames]
    write_contact_table(tmp_path / "contact.csv", rows)
    draw_contact_chart(tmp_path / "contact.png", rows, "a press")
    table = list(csv.DictReader((tmp_path / "contact.csv").read_text().splitlines()))
    assert tuple(table[0]) == COLUMNS
    assert [float(line["time_s"]) for line in table] == pytest.approx([0.0, 0.04, 0.08])
    assert [line["problem"] for line in table] == ["", "torn: is cut", ""]
    assert float(table[2]["depth_um"]) == pytest.approx(300.0, rel=0.01)
    assert float(table[2]["depth_sigma_um"]) == 4.0
    assert table[1]["depth_um"] == table[0]["slip_right_um"] == ""
    assert cv2.imread(str(tmp_path / "contact.png")).std() > 5.0
