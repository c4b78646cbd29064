"""Synthetic balls with known centres, things that are no balls, and the labelled balls of real frames."""

import os
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from device.balls.detector import SHALLOW, BallSearch, find_balls
from device.errors import CalibrationError
from device.imaging.flat_field import (
    LinearFrame,
    NormalizedImage,
    estimate_flat_field,
    flat_field_correct,
    make_flat_field,
)

RADIUS_PX = 60.0
SHAPE = (400, 520)
DATA = Path(os.environ.get("RETROGRAPH_DATA", Path(__file__).parents[4] / "shared" / "data"))

Centre = tuple[float, float]


def lambertian(
    shape: tuple[int, int],
    p: NDArray[np.float64],
    q: NDArray[np.float64],
    noise: float,
    up_deg: tuple[float, float, float] = (30.0, 30.0, 30.0),
) -> NormalizedImage:
    """Skin of the given slopes under three distant lights, 120 degrees apart and 30 degrees up."""
    around, up = np.radians(np.array([20.0, 140.0, 260.0])), np.radians(np.array(up_deg))
    lights = np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
    normal = np.stack([-p, -q, np.ones(shape)], axis=-1) / np.sqrt(1.0 + p**2 + q**2)[..., None]
    values = np.maximum(normal @ lights, 0.0) / np.sin(up)
    values += np.random.default_rng(5).normal(0.0, noise, values.shape)
    nowhere = np.zeros(shape, np.bool_)
    return NormalizedImage(values.astype(np.float32), ~nowhere, nowhere)


def pressed(
    *centres: Centre,
    contact: float = 0.64,
    radius_px: float = RADIUS_PX,
    shape: tuple[int, int] = SHAPE,
    noise: float = 0.01,
    stretch: float = 1.0,
    up_deg: tuple[float, float, float] = (30.0, 30.0, 30.0),
) -> NormalizedImage:
    """Balls pressed to a contact (share of the radius), around which the slope fades; `stretch` makes them oval."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    p, q = np.zeros(shape), np.zeros(shape)
    for centre in centres:
        across, down = (column - centre[0]) / radius_px / stretch, (row - centre[1]) / radius_px * stretch
        away = np.hypot(across, down) + 1e-9
        inside = np.minimum(away, contact)
        steep = inside / np.sqrt(1.0 - inside**2) * np.exp(-np.maximum(away - contact, 0.0) / (0.2 * contact))
        p -= steep * across / away / stretch
        q -= steep * down / away * stretch
    return lambertian(shape, p, q, noise, up_deg)


def distances(search: BallSearch, centres: list[Centre]) -> NDArray[np.float64]:
    """Distance of each centre to the nearest ball found, px."""
    found = np.array([(ball.column, ball.row) for ball in search.found]).reshape(-1, 1, 2)
    return np.asarray(np.hypot(*(found - np.array(centres)).transpose(2, 0, 1)).min(axis=0))


@pytest.mark.parametrize("contact", [0.4, 0.64])
@pytest.mark.parametrize("radius_px", [16.0, 60.0, 130.0])
def test_one_ball_is_found_to_half_a_pixel(contact: float, radius_px: float) -> None:
    centre = (262.3, 189.7)
    search = find_balls(pressed(centre, contact=contact, radius_px=radius_px), radius_px)
    assert len(search.found) == 1
    assert search.rejected == ()
    assert distances(search, [centre])[0] < 0.5


def test_positions_are_plain_numbers_that_a_record_can_hold() -> None:
    search = find_balls(pressed((150.0, 120.0), (5.0, 200.0)), RADIUS_PX)
    assert search.rejected
    numbers = ("column", "row", "contact_radius_px", "radius_px", "apex_px")
    assert all(type(getattr(ball, name)) is float for ball in search.found for name in numbers)
    assert all(type(ball.column) is float and type(ball.row) is float for ball in search.rejected)


@pytest.mark.parametrize("contact", [0.4, 0.5, 0.64])
def test_the_trusted_contact_stays_inside_the_contact(contact: float) -> None:
    ball = find_balls(pressed((262.3, 189.7), contact=contact), RADIUS_PX).found[0]
    assert 0.85 * contact < ball.contact_radius_px / RADIUS_PX < 1.02 * contact
    assert ball.radius_px == RADIUS_PX


def test_several_balls_are_all_found_and_nothing_else() -> None:
    centres = [(90.2, 100.4), (300.7, 95.1), (180.5, 300.3), (420.9, 290.6)]
    search = find_balls(pressed(*centres), RADIUS_PX)
    assert len(search.found) == len(centres)
    assert distances(search, centres).max() < 0.5


def test_what_is_nearer_than_two_balls_can_stand_is_part_of_the_stronger_dent() -> None:
    strong, beside = pressed((200.0, 200.0), noise=0.0), pressed((278.0, 200.0), contact=0.4, noise=0.0)
    both = NormalizedImage(strong.values + beside.values - np.float32(1.0), strong.valid, strong.clipped)
    search = find_balls(both, RADIUS_PX)
    assert len(search.found) == 1
    assert distances(search, [(200.0, 200.0)])[0] < 3.0
    assert [round(ball.column / 40.0) for ball in search.rejected if ball.reason.startswith("part of")] == [7]
    touching = find_balls(pressed((150.0, 200.0), (150.0 + 2.0 * RADIUS_PX, 200.0)), RADIUS_PX)
    assert len(touching.found) == 2


def test_a_ball_pressed_less_deep_than_the_others_is_refused_with_its_contact() -> None:
    shape, radius_px = (500, 700), 40.0
    deep = [(100.0 + 170.0 * i, 100.0 + 150.0 * j) for i in range(4) for j in range(2)]
    both = pressed(*deep, contact=0.7, radius_px=radius_px, shape=shape, noise=0.0)
    shallow = pressed((350.0, 420.0), contact=0.45, radius_px=radius_px, shape=shape, noise=0.01)
    mixed = NormalizedImage(both.values + shallow.values - np.float32(1.0), both.valid, both.clipped)
    search = find_balls(mixed, radius_px)
    assert len(search.found) == len(deep)
    assert [r.reason.startswith("contact too small (0.4") for r in search.rejected] == [True]
    assert np.hypot(search.rejected[0].column - 350.0, search.rejected[0].row - 420.0) < 1.0


def test_a_ball_cut_by_the_border_is_refused() -> None:
    search = find_balls(pressed((20.0, 200.0), (300.0, 200.0)), RADIUS_PX)
    assert len(search.found) == 1
    assert [r.reason for r in search.rejected] == ["cut by the frame's border"]


@pytest.mark.parametrize("centre", [(27.0, 200.0), (262.3, 25.0), (32.0, 372.0)])
def test_the_only_ball_of_a_press_counts_where_it_is_seen(centre: Centre) -> None:
    search = find_balls(pressed(centre), RADIUS_PX)
    assert len(search.found) == 1
    assert distances(search, [centre])[0] < 0.04 * RADIUS_PX
    assert search.found[0].contact_radius_px < 0.64 * RADIUS_PX


def test_the_only_ball_of_a_press_may_have_a_narrow_contact() -> None:
    centres = [(150.0, 120.0), (380.0, 290.0)]
    alone = find_balls(pressed(centres[0], contact=0.34), RADIUS_PX)
    assert len(alone.found) == 1
    assert 0.28 <= alone.found[0].contact_radius_px / RADIUS_PX < 0.33
    both = find_balls(pressed(*centres, contact=0.34), RADIUS_PX)
    assert both.found == ()
    assert all(r.reason.startswith("contact too small") for r in both.rejected)


def test_a_tiny_contact_is_refused_or_not_seen() -> None:
    search = find_balls(pressed((262.3, 189.7), contact=0.22), RADIUS_PX)
    assert search.found == ()
    assert all(r.reason.startswith("contact too small") for r in search.rejected)


def test_a_ball_of_another_radius_is_refused() -> None:
    search = find_balls(pressed((262.3, 189.7), radius_px=150.0), RADIUS_PX)
    assert search.found == ()
    assert [r.reason.split(":")[0] for r in search.rejected] == ["wider than a ball of this radius can press"]


@pytest.mark.parametrize("column", [-25.0, -10.0, 0.0, 530.0])
def test_a_ball_whose_middle_is_outside_the_frame_is_never_found(column: float) -> None:
    for row in (-10.0, 0.0, 200.0, 405.0):
        assert find_balls(pressed((column, row)), RADIUS_PX).found == ()


@pytest.mark.parametrize("radius_px", [1e-9, 0.3, 3.9])
def test_a_radius_of_a_few_pixels_is_refused(radius_px: float) -> None:
    with pytest.raises(CalibrationError, match=r"the press: .* too small to be seen, 4 px are needed"):
        find_balls(pressed((262.3, 189.7)), radius_px)


@pytest.mark.parametrize("radius_px", [640.0, 1e9, np.inf])
def test_a_radius_beyond_the_frame_is_refused_before_memory_is_taken(radius_px: float) -> None:
    with pytest.raises(CalibrationError, match=r"no useful contact .* fits into 520x400 pixels"):
        find_balls(pressed((262.3, 189.7)), radius_px)


def test_a_look_at_expected_places_adds_the_balls_there_and_no_others() -> None:
    centres = [(90.2, 100.4), (300.7, 95.1)]
    image = pressed(*centres)
    found = find_balls(image, RADIUS_PX, expected=[*centres, (420.0, 300.0)]).found
    assert found == find_balls(image, RADIUS_PX).found


def test_a_hair_over_a_ball_moves_it_little() -> None:
    centre = (262.3, 189.7)
    image = pressed(centre)
    hair = cv2.line(np.zeros(SHAPE, np.uint8), (230, 215), (300, 170), 1, 3).astype(bool)
    image.values[hair] *= np.float32(0.3)
    search = find_balls(image, RADIUS_PX)
    assert len(search.found) == 1
    assert distances(search, [centre])[0] < 0.05 * RADIUS_PX


def test_an_oval_dent_is_no_ball() -> None:
    assert find_balls(pressed((262.3, 189.7), stretch=1.7), RADIUS_PX).found == ()


GRAZING = (4.0, 9.0, 2.5)
"""Lights that set where the skin leans away by a few degrees, each at another slope."""


@pytest.mark.parametrize("contact", [0.4, 0.64])
def test_a_ball_under_lights_that_graze_the_skin_is_found(contact: float) -> None:
    centre = (262.3, 189.7)
    search = find_balls(pressed(centre, contact=contact, up_deg=GRAZING), RADIUS_PX)
    assert len(search.found) == 1, search.rejected
    assert distances(search, [centre])[0] < 0.01 * RADIUS_PX


def test_an_oval_dent_under_lights_that_graze_the_skin_is_no_ball() -> None:
    assert find_balls(pressed((262.3, 189.7), stretch=1.7, up_deg=GRAZING), RADIUS_PX).found == ()


@pytest.mark.parametrize("contact", [0.26, 0.5])
def test_a_shallow_press_of_a_large_ball_is_found_where_it_is_asked_for(contact: float) -> None:
    image = pressed((262.3, 189.7), contact=contact, radius_px=200.0)
    found = find_balls(image, 200.0, shallow=SHALLOW).found
    assert len(found) == 1
    assert np.hypot(found[0].column - 262.3, found[0].row - 189.7) < 2.0
    assert 0.6 * contact < found[0].contact_radius_px / 200.0 < contact


@pytest.mark.parametrize("stretch", [0.6, 1.7])
def test_the_middle_of_an_oval_dent_is_no_shallow_press(stretch: float) -> None:
    image = pressed((262.3, 189.7), stretch=stretch)
    assert find_balls(image, RADIUS_PX, shallow=SHALLOW).found == ()
    assert find_balls(image, 2.0 * RADIUS_PX, shallow=SHALLOW).found == ()


def test_skin_at_rest_shows_no_shallow_press() -> None:
    assert find_balls(pressed(noise=0.02), RADIUS_PX, shallow=SHALLOW).found == ()


DARKER = (0.77, 0.76, 0.78)
"""Intensity of untouched skin in three channels of a frame that automatic exposure made darker."""


def test_a_ball_in_a_darker_frame_is_found_where_it_is_asked_for() -> None:
    image = pressed((262.3, 189.7), contact=0.4, up_deg=(60.0, 60.0, 60.0))
    darker = replace(image, values=image.values * np.float32(DARKER))
    assert find_balls(darker, RADIUS_PX).found == ()
    found = find_balls(darker, RADIUS_PX, shallow=SHALLOW).found
    assert len(found) == 1
    assert np.hypot(found[0].column - 262.3, found[0].row - 189.7) < 0.02 * RADIUS_PX
    assert 0.85 * 0.4 < found[0].contact_radius_px / RADIUS_PX < 1.02 * 0.4


@pytest.mark.parametrize("stretch", [0.0, 0.6, 1.7])
def test_nothing_in_a_darker_frame_that_is_no_ball_is_found(stretch: float) -> None:
    image = pressed((262.3, 189.7), stretch=stretch) if stretch else pressed(noise=0.02)
    darker = replace(image, values=image.values * np.float32(DARKER))
    assert find_balls(darker, RADIUS_PX, shallow=SHALLOW).found == ()


def test_a_groove_is_no_ball() -> None:
    column = np.broadcast_to(np.arange(SHAPE[1]) - 260.0, SHAPE)
    p = np.where(np.abs(column) < 40.0, -column / 60.0, 0.0)
    search = find_balls(lambertian(SHAPE, p, np.zeros(SHAPE), 0.01), RADIUS_PX)
    assert search == BallSearch((), ())


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_skin_at_rest_shows_no_ball(noise: float) -> None:
    assert find_balls(pressed(noise=noise), RADIUS_PX) == BallSearch((), ())


def test_a_drift_of_the_light_over_the_frame_is_no_ball_and_moves_none() -> None:
    centre = (262.3, 189.7)
    slope = np.linspace(0.97, 1.03, SHAPE[1], dtype=np.float32)[None, :, None]
    ball, rest = pressed(centre), pressed()
    assert find_balls(NormalizedImage(rest.values * slope, rest.valid, rest.clipped), RADIUS_PX).found == ()
    search = find_balls(NormalizedImage(ball.values * slope, ball.valid, ball.clipped), RADIUS_PX)
    assert distances(search, [centre])[0] < 0.5


def test_values_that_are_not_finite_do_no_harm() -> None:
    centre = (262.3, 189.7)
    image = pressed(centre)
    image.values[:40, :40] = np.nan
    image.valid[:40, :40] = False
    assert distances(find_balls(image, RADIUS_PX), [centre])[0] < 0.5


@dataclass(frozen=True)
class RealPress:
    """One real frame with its labels."""

    image: NormalizedImage
    radius_px: float
    centres: list[Centre]


def read_set(name: str) -> list[RealPress]:
    """Every labelled frame of a set; skips when the set is absent."""
    folder = DATA / name
    if not (folder / "frameset.toml").is_file():
        pytest.skip(f"real frames {name!r} are not present: set RETROGRAPH_DATA")
    described = tomllib.loads((folder / "frameset.toml").read_text())
    labels = list(described["press"])
    for scan in described["scan"]:
        truth = tomllib.loads((folder / f"truth-{scan['name']}.toml").read_text())
        labels.append({"image": scan["image"], **truth})
    frames = [read_frame(folder, label["image"], described["encoding"]) for label in labels]
    if "reference" in described:
        flat_field = make_flat_field(read_frame(folder, described["reference"]["image"], described["encoding"]))
    else:
        flat_field = estimate_flat_field(frames)
    return [
        RealPress(
            flat_field_correct(frame, flat_field),
            label["ball_radius_mm"] * 1e3 / described["pixel_pitch_um"],
            [(ball["x"], ball["y"]) for ball in label["balls"]],
        )
        for frame, label in zip(frames, labels, strict=True)
    ]


def read_frame(folder: Path, image: str | list[str], encoding: str) -> LinearFrame:
    if isinstance(image, str):
        counts = cv2.imread(str(folder / image), cv2.IMREAD_COLOR)[..., ::-1]
    else:
        counts = np.stack([cv2.imread(str(folder / part), cv2.IMREAD_GRAYSCALE) for part in image], axis=-1)
    share = counts.astype(np.float32) / np.float32(255.0)
    if encoding == "srgb":
        share = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return LinearFrame(share, (counts >= 250).any(axis=-1))


def compare(name: str) -> tuple[NDArray[np.float64], int, int]:
    """Distance (px) of each label to the nearest ball found, number of balls without label, number of balls."""
    errors, false, number = [], 0, 0
    for press in read_set(name):
        search = find_balls(press.image, press.radius_px)
        errors.append(distances(search, press.centres))
        number += len(search.found)
        for ball in search.found:
            apart = [np.hypot(ball.column - column, ball.row - row) for column, row in press.centres]
            false += min(apart) > 0.5 * press.radius_px
    return np.concatenate(errors), false, number


def test_the_ball_grids_of_oem_are_found() -> None:
    errors, false, number = compare("oem-bga")
    assert (errors < 3.0).mean() >= 0.9
    assert np.median(errors) < 2.0
    assert false <= 0.05 * number


def test_the_single_balls_of_taxim_are_found() -> None:
    # Labels are hand-made: of the five that lie over 3 px away, all lie under 4 px, off the dent's own middle.
    errors, false, _ = compare("taxim-small")
    assert (errors < 3.0).mean() >= 0.89
    assert errors.max() < 4.0
    assert false == 0


def test_the_labelled_balls_of_finger_are_found_on_a_grid_of_equal_steps() -> None:
    # Its labels stray by several pixels from any square grid, so that the grid itself judges the centres.
    for press in read_set("finger"):
        search = find_balls(press.image, press.radius_px)
        assert distances(search, press.centres).max() < 0.5 * press.radius_px
        assert grid_error(search) < 0.05 * press.radius_px
        assert any(rejected.reason.startswith("contact too small") for rejected in search.rejected)


def grid_error(search: BallSearch) -> float:
    """Median distance (px) of the balls found from the square grid that fits them best."""
    at = np.array([ball.column + 1j * ball.row for ball in search.found])
    middle = at[np.argmin(np.abs(at - np.median(at.real) - 1j * np.median(at.imag)))]
    apart = np.abs(at - middle)
    step = at[np.argsort(apart)[1]] - middle
    number = np.round((at - middle) / step)
    for _ in range(3):
        design = np.stack([np.ones_like(at), number], axis=-1)
        origin, step = np.linalg.lstsq(design, at, rcond=None)[0]
        number = np.round(((at - origin) / step).real) + 1j * np.round(((at - origin) / step).imag)
    return float(np.median(np.abs(at - origin - step * number)))
