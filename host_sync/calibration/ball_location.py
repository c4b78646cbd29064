"""The balls of calibration presses: given or found, and, where a hand set them, compared with what is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.ball import Ball
from device.ball_finder import RejectedBall, find_balls
from device.channel_order import check_channel_order
from device.errors import CalibrationError, CalibrationMismatch
from device.inverse_fit import InverseFit
from device.photometry import IntensityImage, LinearFrame, check_exposed, divide
from device.surface import Float32Array

SAME_BALL: Final = 0.5
"""A found ball this close to a label, as a share of the radius, is the labelled one."""


@dataclass(frozen=True, slots=True, eq=False)
class PressFrame:
    """One calibration press: a frame in which balls of one known radius touch the skin.

    balls : where they are, or None to have them found
    labelled_by_hand : the places in `balls` may be some pixels off
    """

    name: str
    frame: LinearFrame
    radius_px: float
    balls: tuple[Ball, ...] | None = None
    labelled_by_hand: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class UsedPress:
    """A press in calibration: its intensity, the balls that teach, and those that were rejected with the reason."""

    name: str
    intensity: IntensityImage
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]


def check_sizes(presses: Sequence[PressFrame], reference: LinearFrame | None) -> None:
    """Refuse frames of different sizes.

    Raises
    ------
    CalibrationMismatch
        Names the press and both sizes.
    """
    shape = reference.shape if reference else presses[0].frame.shape
    for press in presses:
        if press.frame.shape != shape:
            raise CalibrationMismatch(
                f"{press.name} is {press.frame.shape[1]}x{press.frame.shape[0]} pixels, "
                f"the others {shape[1]}x{shape[0]}: use frames of one camera mode"
            )


def locate(press: PressFrame, divisor: Float32Array) -> UsedPress:
    """A press with its balls as given, or found when none are given.

    Raises
    ------
    FrameError, CalibrationMismatch
        The frame is black, saturated, or its channels are swapped.
    CalibrationError
        No ball is found.
    """
    check_exposed(press.frame, press.name)
    check_channel_order(press.frame, divisor, press.name)
    intensity = divide(press.frame, divisor)
    if press.balls is not None:
        return UsedPress(press.name, intensity, press.balls, ())
    search = find_balls(intensity, press.radius_px)
    if not search.found:
        reasons = "; ".join(sorted({ball.reason for ball in search.rejected})) or "nothing presses the skin"
        raise CalibrationError(
            f"{press.name} shows no ball of radius {press.radius_px:.0f} px ({reasons}): press the ball again, or take "
            "this press out of the calibration"
        )
    return UsedPress(press.name, intensity, search.found, search.rejected)


def seen_instead_of_labelled(press: UsedPress, radius_px: float) -> UsedPress:
    """The press with each labelled ball moved to the one that is seen there, its contact not larger; others stay."""
    found = find_balls(press.intensity, radius_px).found
    return replace(press, balls=tuple(_nearest(ball, found) for ball in press.balls))


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


def after_fit(located: Sequence[UsedPress], inverse: InverseFit) -> tuple[UsedPress, ...]:
    """The presses with refined centres; balls that the fit dropped go to the rejected."""
    used = []
    first = 0
    for press in located:
        span = range(first, first + len(press.balls))
        first += len(press.balls)
        kept = tuple(inverse.balls[i] for i in span if inverse.kept[i])
        dropped = tuple(
            RejectedBall(
                inverse.balls[i].column,
                inverse.balls[i].row,
                f"does not follow the sphere (held-out error {inverse.ball_error_deg[i]:.1f} degrees)",
            )
            for i in span
            if not inverse.kept[i]
        )
        used.append(UsedPress(press.name, press.intensity, kept, press.rejected + dropped))
    return tuple(used)
