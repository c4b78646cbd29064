"""The balls of calibration presses: given or found, and, where a hand set them, compared with what is seen."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.detector import SHALLOW, BallSearch, RejectedBall, find_balls, fits
from device.balls.sphere import Ball, pixels_inside
from device.calibration.acceptance import MAX_CLIPPED
from device.calibration.fit import CORE_FRACTION, InverseFit, dropped_ball
from device.errors import CalibrationError, CalibrationMismatch
from device.imaging.flat_field import LinearFrame, NormalizedImage, check_exposed, flat_field_correct
from device.imaging.frame_measures import check_channel_order
from device.surface import Float32Array, MaskArray

SAME_BALL: Final = 0.5
"""A found ball this close to a label, as a share of the radius, is the labelled one."""

SAMPLED_STEP: Final = 16
"""Step of the pixels that are compared to distinguish frames."""

MAX_WIDENING: Final = 1.06
"""Labels that draw contacts wider than the finder does widen found ones by this factor at most."""


@dataclass(frozen=True, slots=True)
class GridSpacing:
    """Distance of neighbouring balls of a square grid, and by how much it may be off; None when not stated."""

    pitch_mm: float
    tolerance_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PressFrame:
    """One calibration press: a frame in which balls of one known radius touch the skin.

    balls : where they are, or None to have them found
    labelled_by_hand : the places in `balls` may be some pixels off
    source : the file that the frame came from
    grid : the spacing of the balls when they form a grid
    radius_tolerance : by which share the ball's radius may be off, None when not stated
    """

    name: str
    frame: LinearFrame
    radius_px: float
    balls: tuple[Ball, ...] | None = None
    labelled_by_hand: bool = False
    source: str = ""
    grid: GridSpacing | None = None
    radius_tolerance: float | None = None

    @property
    def label(self) -> str:
        """The press and its file, for messages."""
        return f"{self.name} ({self.source})" if self.source else self.name


@dataclass(frozen=True, slots=True)
class FittedBall:
    """A ball that took part in the fit: its number in the press, from 1, and what became of it."""

    number: int
    ball: Ball
    error_deg: float
    kept: bool


@dataclass(frozen=True, slots=True, eq=False)
class UsedPress:
    """A press in calibration: its intensity, the training balls, and those that were rejected with the reason.

    error : why no ball of the press can be used, empty when one can
    seen : what was found in it, None when its balls were given by the instrument that took it
    fitted : every ball that took part in the fit, in the fit's order
    """

    name: str
    intensity: NormalizedImage
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    error: str = ""
    source: str = ""
    seen: BallSearch | None = None
    fitted: tuple[FittedBall, ...] = ()

    @property
    def label(self) -> str:
        """The press and its file, for messages."""
        return f"{self.name} ({self.source})" if self.source else self.name


def check_sizes(presses: Sequence[PressFrame], reference: LinearFrame | None) -> None:
    """Refuse frames of different sizes.

    Raises
    ------
    CalibrationMismatch
        Names the press and both sizes.
    """
    shape = reference.shape if reference else presses[0].frame.shape
    other = "the reference" if reference else presses[0].label
    for press in presses:
        if press.frame.shape != shape:
            raise CalibrationMismatch(
                f"{press.label} is {press.frame.shape[1]}x{press.frame.shape[0]} pixels, "
                f"{other} {shape[1]}x{shape[0]}: use frames of one camera mode"
            )


def check_distinct(presses: Sequence[PressFrame]) -> None:
    """Refuse one frame under two names: balls left out would be judged by their own pixels.

    Raises
    ------
    CalibrationError
        Names both presses.
    """
    seen: dict[bytes, list[PressFrame]] = {}
    for press in presses:
        sample = np.ascontiguousarray(press.frame.rgb[::SAMPLED_STEP, ::SAMPLED_STEP]).tobytes()
        for twin in seen.setdefault(sample, []):
            if _may_show_one_ball(twin, press) and np.array_equal(twin.frame.rgb, press.frame.rgb):
                raise CalibrationError(
                    f"{press.label} is the same frame as {twin.label}: leave one out, each press must be another one"
                )
        seen[sample].append(press)


def _may_show_one_ball(one: PressFrame, other: PressFrame) -> bool:
    """Return False for presses of one frame whose labels are of different balls."""
    if not one.balls or not other.balls:
        return True
    return any(
        np.hypot(ball.column - near.column, ball.row - near.row) < max(ball.contact_radius_px, near.contact_radius_px)
        for ball in one.balls
        for near in other.balls
    )


def locate(press: PressFrame, flat_field: Float32Array) -> UsedPress:
    """Return a press with its balls as given, or found where none are given.

    What cannot be used for training is listed with the reason.

    Raises
    ------
    FrameError, CalibrationMismatch
        The frame is black, saturated, or its channels are swapped.
    CalibrationError
        No frame of this size could show a ball of that radius.
    """
    check_exposed(press.frame, press.label)
    check_channel_order(press.frame, flat_field, press.label)
    intensity = flat_field_correct(press.frame, flat_field)
    seen = None
    # A lens that fills the field shows gentle slopes only; its label is believed, for no finder could confirm it.
    if press.balls is None or press.grid or (press.labelled_by_hand and fits(press.radius_px, intensity.shape)):
        seen = find_balls(intensity, press.radius_px, name=press.label, shallow=SHALLOW)
    used = UsedPress(press.name, intensity, press.balls or (), (), "", press.source, seen)
    return used if press.balls is not None or seen is None else with_found(used, seen, press.radius_px)


def with_found(press: UsedPress, seen: BallSearch, radius_px: float) -> UsedPress:
    """Return the press with the balls of a search as its own."""
    fault = ""
    if not seen.found:
        kinds = {re.sub(r"[0-9.]+", "#", ball.reason): ball.reason for ball in reversed(seen.rejected)}
        reasons = "; ".join(sorted(kinds.values())) or "no place is shaded as it would be"
        fault = f"shows no ball of radius {radius_px:.0f} px ({reasons})"
    return replace(press, balls=seen.found, rejected=seen.rejected, error=fault, seen=seen)


def drop_clipped(press: UsedPress) -> UsedPress:
    """Return the press without balls whose contacts are saturated."""
    shares = [clipped_share(press.intensity, ball) for ball in press.balls]
    worst = max(shares, default=0.0)
    reason = f"{worst:.0%} of its contact is saturated in a channel, at most {MAX_CLIPPED:.0%} may be"
    return without_balls(press, [share > MAX_CLIPPED for share in shares], reason)


def clipped_share(image: NormalizedImage, ball: Ball) -> float:
    """Return the share of the pixels inside a ball's contact that are saturated in a channel."""
    row, column = pixels_inside(ball, image.shape)
    return float(image.clipped[row, column].mean()) if row.size else 0.0


def without_balls(press: UsedPress, out: Sequence[bool] | MaskArray, reason: str) -> UsedPress:
    """Return the press with the marked balls among the rejected."""
    if not np.any(out):
        return press
    balls = tuple(ball for ball, gone in zip(press.balls, out, strict=True) if not gone)
    rejected = tuple(
        RejectedBall(ball.column, ball.row, reason) for ball, gone in zip(press.balls, out, strict=True) if gone
    )
    return replace(press, balls=balls, rejected=press.rejected + rejected, error="" if balls else reason)


def relocate_labels(press: UsedPress) -> UsedPress:
    """Return the press with each labelled ball moved to the one that is seen there.

    Its contact does not grow. A label at which nothing is seen is used as it was set: held-out balls decide whether it
    is right.
    """
    found = _as_wide_as_labels_say(press)
    return replace(press, balls=tuple(_nearest(ball, found) for ball in press.balls))


def cut_to_core(press: UsedPress) -> UsedPress:
    """Return the press with only the core of each ball's contact."""
    cut = (replace(ball, contact_radius_px=CORE_FRACTION * ball.contact_radius_px) for ball in press.balls)
    return replace(press, balls=tuple(cut))


def add_detections(press: UsedPress) -> UsedPress:
    """Return the press as `relocate_labels` does, with all other balls that are seen after those."""
    at_labels = relocate_labels(press)
    beyond = tuple(ball for ball in _as_wide_as_labels_say(press) if not _is_one_of(ball, press.balls))
    return replace(at_labels, balls=at_labels.balls + beyond)


def _as_wide_as_labels_say(press: UsedPress) -> tuple[Ball, ...]:
    """Return the balls that are seen, with wider contacts where labels say that the finder cuts them early."""
    found = press.seen.found if press.seen else ()
    pairs = [(label, ball) for label in press.balls for ball in found if _is_one_of(ball, (label,))]
    if not pairs:
        return found
    wider = float(np.median([label.contact_radius_px / ball.contact_radius_px for label, ball in pairs]))
    factor = min(max(wider, 1.0), MAX_WIDENING)
    return tuple(replace(ball, contact_radius_px=factor * ball.contact_radius_px) for ball in found)


def _is_one_of(ball: Ball, others: Sequence[Ball]) -> bool:
    return any(np.hypot(ball.column - o.column, ball.row - o.row) < SAME_BALL * o.radius_px for o in others)


def _nearest(label: Ball, found: Sequence[Ball]) -> Ball:
    near = [
        (apart, ball)
        for ball in found
        if (apart := float(np.hypot(ball.column - label.column, ball.row - label.row))) < SAME_BALL * label.radius_px
    ]
    if not near:
        return label
    _, ball = min(near, key=lambda pair: pair[0])
    contact_px = min(label.contact_radius_px, ball.contact_radius_px)
    return replace(label, column=ball.column, row=ball.row, contact_radius_px=contact_px)


def apply_fit(located: Sequence[UsedPress], inverse: InverseFit) -> tuple[UsedPress, ...]:
    """Return the presses with refined centres; balls that the fit dropped go to the rejected."""
    used = []
    first = 0
    for press in located:
        span = range(first, first + len(press.balls))
        first += len(press.balls)
        kept = tuple(inverse.balls[i] for i in span if inverse.kept[i])
        dropped = tuple(dropped_ball(inverse, i) for i in span if not inverse.kept[i])
        fitted = tuple(
            FittedBall(number, inverse.balls[i], float(inverse.ball_error_deg[i]), bool(inverse.kept[i]))
            for number, i in enumerate(span, start=1)
        )
        fault = press.error if kept else press.error or "; ".join(ball.reason for ball in dropped)
        used.append(replace(press, balls=kept, rejected=press.rejected + dropped, error=fault, fitted=fitted))
    return tuple(used)
