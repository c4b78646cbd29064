"""The balls of all presses of a calibration; and where too few can be used, the reason that most presses share."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.balls.detector import MIN_CONTACT, BallSearch, RejectedBall, find_balls
from device.balls.sphere import Ball
from device.calibration.acceptance import MIN_BALLS
from device.errors import CalibrationError
from device.imaging.flat_field import (
    MAX_DISAGREEMENT,
    LinearFrame,
    NormalizedImage,
    estimate_flat_field,
    make_flat_field,
)
from device.surface import Float32Array, Float64Array
from host_sync.calibration.balls import PressFrame, UsedPress, drop_clipped, locate, with_found
from host_sync.calibration.consistency import check_agreement, check_untouched
from host_sync.calibration.lattice import GROWTH, ON_LATTICE, BallLattice, find_lattice, project
from host_sync.calibration.pixel_pitch import PitchReading, PixelPitch, join_readings, read_pitch
from host_sync.calibration.radii import fitting_radius

NAMED: Final = 3
"""At most so many presses are named that share a reason."""

ONE_LIGHT: Final = 0.1
"""Frames whose colour changes less than this fraction of their brightness show one light in all channels."""

COARSE_PX: Final = 60
"""Length of a frame's shorter side in which colours are compared: averages of blocks show little noise."""

ONE_LIGHT_WORDS: Final = (
    "all channels show the same light (a grey image, or white lights): balls are found by lights of three colours, one "
    "a channel"
)

OTHER_RADIUS: Final = 1.25
"""Up to this factor another radius is the same one: contacts do not distinguish them."""

LOOKED_AT: Final = 12
"""At most so many presses are searched for balls of another radius."""


def flat_field_of(frames: Sequence[LinearFrame], reference: LinearFrame | None) -> Float32Array:
    """Return what frames are divided by: the frame of untouched skin, else a stand-in fitted to the frames."""
    return make_flat_field(reference) if reference else estimate_flat_field(list(frames))


def locate_usable(press: PressFrame, flat_field: Float32Array) -> UsedPress:
    """Return a press, not one of a grid, with the balls that may be used for training; errors as for `locate`."""
    return drop_clipped(locate(press, flat_field))


def locate_all(
    presses: Sequence[PressFrame], flat_field: Float32Array, stated_um: float, reference: LinearFrame | None
) -> tuple[Sequence[UsedPress], PixelPitch | None]:
    """Return the presses with the balls for training, and the pixel pitch that grids among them measure.

    stated_um : the pixel pitch as stated

    Raises
    ------
    FrameError, CalibrationMismatch
        Frames do not belong together, or something touches the skin in the reference.
    CalibrationError
        Too few balls can be used.
    """
    labelled = [(locate if press.grid else locate_usable)(press, flat_field) for press in presses]
    if not any(used.balls for used in labelled):
        # Frames of something else agree in nothing, and that is not the reason.
        check_count(labelled, stated_um, presses[0].radius_px)
    check_agreement(
        [p.label for p in presses], [used.intensity for used in labelled], flat_field, reference is not None
    )
    if reference is not None:
        check_untouched(reference, [press.frame for press in presses])
    located, pitch = measure_pitch(presses, labelled, stated_um)
    located = [drop_clipped(used) if press.grid else used for press, used in zip(presses, located, strict=True)]
    check_count(located, stated_um, presses[0].radius_px)
    return located, pitch


def check_count(presses: Sequence[UsedPress], pitch_um: float, radius_px: float) -> None:
    """Refuse presses that show too few balls.

    radius_px : of the balls as stated

    Raises
    ------
    CalibrationError
        Names the number, why the others were rejected, and what explains it.
    """
    balls = sum(len(press.balls) for press in presses)
    if balls >= MIN_BALLS:
        return
    why = "; ".join(_grouped(presses))
    advice = _advice(presses, pitch_um, radius_px)
    raise CalibrationError(
        f"{balls} usable balls in {len(presses)} calibration presses{f' ({why})' if why else ''}, and {MIN_BALLS} are "
        f"needed: {advice}"
    )


def _grouped(presses: Sequence[UsedPress]) -> list[str]:
    """Return the reasons why presses cannot be used, each once with its presses; figures are those of the first."""
    groups: dict[str, tuple[str, list[str]]] = {}
    for press in presses:
        reasons = (
            [press.error]
            if press.error
            else [f"shows a ball that is not used ({ball.reason})" for ball in press.rejected]
        )
        for reason in reasons:
            _, names = groups.setdefault(re.sub(r"[0-9.]+", "#", reason), (reason, []))
            if press.label not in names:
                names.append(press.label)
    found = sorted(groups.values(), key=lambda group: -len(group[1]))[:MIN_BALLS]
    return [f"{_listed(names)} {reason}" for reason, names in found]


def _listed(names: Sequence[str]) -> str:
    more = len(names) - NAMED
    return f"{', '.join(names[:NAMED])} and {more} more:" if more > 0 else f"{', '.join(names)}"


def _advice(presses: Sequence[UsedPress], pitch_um: float, radius_px: float) -> str:
    """Return the mend that the presses themselves suggest where most show no ball."""
    images = [press.intensity for press in presses if not press.balls]
    if images and float(np.median([colour_over_brightness(image) for image in images])) < ONE_LIGHT:
        return ONE_LIGHT_WORDS
    level = float(np.median([np.nanmedian(image.values) for image in images])) if images else 1.0
    if abs(np.log(max(level, 1e-3))) > np.log1p(MAX_DISAGREEMENT):
        return (
            f"the presses are {level:.2f} times as bright as the reference: take the reference again with "
            "this gel, these lights and this exposure"
        )
    found = fitting_radius([press.intensity for press in presses[:: max(1, len(presses) // LOOKED_AT)]])
    used = len(presses) - len(images)
    if found is not None and found.presses > 1 and found.presses * len(presses) > used * found.looked_at:
        ratio = found.radius_px / radius_px
        if not 1.0 / OTHER_RADIUS < ratio < OTHER_RADIUS:
            return f"{found.sentence(pitch_um, radius_px)}: {mend_of_radius(ratio, 'ball_radius_mm', 'pixel_pitch_um')}"
    return "press balls of known radius all over the gel"


def mend_of_radius(ratio: float, radius: str, pitch: str) -> str:
    """Return the mend where balls of another radius show, by the names of the two options.

    ratio : of the radius that shows to the one that is stated; contacts of one size fit radii within a factor of 1.5
    """
    question = " (is it the diameter?)" if 0.33 < ratio < 0.75 else ""
    return f"check {radius}{question} and {pitch}{', or press deeper' if ratio < 1.0 else ''}"


def colour_over_brightness(image: NormalizedImage) -> float:
    """Return the root mean square of what colour changes where a frame changes most, over that of brightness."""
    rows, columns = (max(1, round(size * COARSE_PX / min(image.shape))) for size in image.shape)
    small = cv2.resize(np.nan_to_num(image.values), (columns, rows), interpolation=cv2.INTER_AREA)
    values = np.log(np.maximum(small.reshape(rows, columns, -1), 1e-3))
    brightness = values.mean(axis=-1)
    brightness = brightness - np.median(brightness)
    most = np.abs(brightness) >= np.percentile(np.abs(brightness), 90.0)
    colour = values - values.mean(axis=-1, keepdims=True)
    colour = colour - np.median(colour, axis=(0, 1))
    return float(np.sqrt((colour[most] ** 2).mean() / max(float((brightness[most] ** 2).mean()), 1e-12)))


# Grid presses: the lattice helps to find the balls, and the balls measure the pixel pitch.

DEEPEST_FRACTION = 0.98
"""A given contact is held to this share of the ball's radius when the radius in pixels is corrected."""


@dataclass(frozen=True, slots=True, eq=False)
class GridDetection:
    """Balls of a grid press less those off the lattice, and the lattice, None when they form none."""

    search: BallSearch
    lattice: BallLattice | None


def detect_grid(image: NormalizedImage, seen: BallSearch, radius_px: float) -> GridDetection:
    """Return the balls of a grid press; where the lattice expects one that was missed, it is looked for once more."""
    lattice = find_lattice(_centres(seen))
    if lattice is None:
        return GridDetection(seen, None)
    expected = _unseen(lattice, seen, image.shape, radius_px)
    if expected:
        again = find_balls(image, radius_px, expected)
        relaid = find_lattice(_centres(again))
        if relaid is not None and relaid.on.sum() >= lattice.on.sum():
            # A look at a place where nothing is finds nothing good; only what was rejected unasked is worth a word.
            seen, lattice = BallSearch(again.found, seen.rejected), relaid
    return _on_lattice(seen, lattice)


def measure_pitch(
    presses: Sequence[PressFrame], located: Sequence[UsedPress], stated_um: float
) -> tuple[list[UsedPress], PixelPitch | None]:
    """Return the presses, their balls held to the lattice and to the measured scale, and the pixel pitch.

    The pitch is None where no press shows a grid of known spacing.

    Raises
    ------
    CalibrationError
        The stated pitch is grossly wrong.
    """
    found: list[UsedPress] = []
    readings: list[PitchReading] = []
    for press, used in zip(presses, located, strict=True):
        if press.grid is None or used.seen is None:
            found.append(used)
            continue
        grid = detect_grid(used.intensity, used.seen, press.radius_px)
        own = replace(used, seen=grid.search)
        found.append(own if press.balls is not None else with_found(own, grid.search, press.radius_px))
        if grid.lattice is not None:
            balls, shape = grid.search.found, used.intensity.shape
            readings.append(read_pitch(press.label, grid.lattice, balls, press.grid, shape))
    if not readings:
        return found, None
    pitch = join_readings(stated_um, readings)
    return [_rescaled(used, stated_um / pitch.pitch_um) for used in found], pitch


def _on_lattice(seen: BallSearch, lattice: BallLattice) -> GridDetection:
    """Return the search with the balls off the lattice among the rejected, the lattice for the others alone.

    What the finder itself rejected off the lattice is no ball at all and is forgotten.
    """
    places = lattice.pixels(lattice.index)
    off = []
    for number in np.flatnonzero(~lattice.on):
        ball = seen.found[number]
        away_px = float(np.hypot(ball.column - places[number, 0], ball.row - places[number, 1]))
        share = away_px / lattice.step_px(lattice.index[number])
        off.append(RejectedBall(ball.column, ball.row, f"off the grid by {away_px:.1f} px ({share:.0%} of its step)"))
    on = lattice.on
    balls = tuple(ball for ball, kept in zip(seen.found, on, strict=True) if kept)
    kept_lattice = BallLattice(lattice.index[on], on[on], lattice.to_pixels)
    rejected = tuple(ball for ball in seen.rejected if _stray(lattice, ball) < GROWTH)
    return GridDetection(BallSearch(balls, rejected + tuple(off)), kept_lattice)


def _stray(lattice: BallLattice, ball: RejectedBall) -> float:
    """Return the distance of a rejected ball from the nearest place of the lattice, in steps."""
    place = project(np.asarray(np.linalg.inv(lattice.to_pixels), np.float64), np.array([[ball.column, ball.row]]))
    return float(np.hypot(*(place - np.round(place))[0]))


def _unseen(
    lattice: BallLattice, seen: BallSearch, shape: tuple[int, int], radius_px: float
) -> list[tuple[float, float]]:
    """Return lattice places (column, row) that the frame could show and where nothing is seen.

    A rejected ball counts as seen.
    """
    missing = lattice.missing()
    if not len(missing):
        return []
    places = lattice.pixels(missing)
    margin = np.minimum(places, np.array([shape[1] - 1.0, shape[0] - 1.0]) - places).min(axis=1)
    known = np.array([(b.column, b.row) for b in seen.found] + [(b.column, b.row) for b in seen.rejected])
    apart = np.hypot(*(places[:, None] - known).transpose(2, 0, 1)).min(axis=1)
    wanted = (margin > MIN_CONTACT * radius_px) & (apart > ON_LATTICE * lattice.step_px(np.zeros(2)))
    return [(float(column), float(row)) for column, row in places[wanted]]


def _centres(search: BallSearch) -> Float64Array:
    return np.array([(ball.column, ball.row) for ball in search.found], np.float64).reshape(-1, 2)


def _rescaled(press: UsedPress, factor: float) -> UsedPress:
    """Return the press with balls whose radius in pixels is `factor` times as large."""
    seen = press.seen and replace(press.seen, found=tuple(_with_radius(ball, factor) for ball in press.seen.found))
    return replace(press, balls=tuple(_with_radius(ball, factor) for ball in press.balls), seen=seen)


def _with_radius(ball: Ball, factor: float) -> Ball:
    radius_px = factor * ball.radius_px
    return replace(
        ball, radius_px=radius_px, contact_radius_px=min(ball.contact_radius_px, DEEPEST_FRACTION * radius_px)
    )
