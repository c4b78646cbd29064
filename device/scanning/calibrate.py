"""Guided calibration on the device: a reference in air, a ball pressed all over the field, a model fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.ball import BallSamples, gather_samples
from device.ball_finder import BallSearch, find_balls
from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.calibration_limits import FEWEST_BALLS, WORST_HELD_OUT_DEG
from device.errors import CalibrationError
from device.inverse_fit import InverseFit, fit_inverse_map
from device.photometry import bin_bayer, blurred_reference, check_exposed, divide
from device.scanning.calibration_files import AcceptedPress, publish
from device.scanning.capture import CapturePlan, capture
from device.scanning.pushing import await_push
from device.scanning.shining import check_shines
from device.surface import Float32Array
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import LiftOff, PressBall

BINNING: Final = 2
"""Balls are sought and the map is fitted at half size: four times as fast, and with half the noise."""

COLUMNS: Final = 4
ROWS: Final = 3
MOST_TRIES: Final = 3
FITTED_SAMPLES: Final = 20_000


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """The published calibration and what its fit says."""

    bundle: CalibrationBundle
    fit: InverseFit


def press_places() -> list[tuple[float, float]]:
    """Where the ball is to be pressed: shares of the field's columns and rows, row by row."""
    return [((column + 0.5) / COLUMNS, (row + 0.5) / ROWS) for row in range(ROWS) for column in range(COLUMNS)]


def calibrate(
    hardware: Hardware,
    store: BundleStore,
    ball_radius_mm: float,
    tell: Callable[[str], None],
    plan: CapturePlan | None = None,
) -> CalibrationOutcome:
    """Guide through a calibration, publish it and make it active.

    tell : shows one line to the person at the instrument
    plan : exposure and currents, such as `balance` found; the board profile's when none is given

    Every press is held to the very exposure and gain that the reference was granted.

    Raises
    ------
    CalibrationError
        A light does not shine, too few balls, or held-out balls disagree; the calibration before stays active.
    HalError, FrameNotProven, StoreError
        The hardware or the disk refused.
    """
    plan = plan or CapturePlan.of_board(hardware)
    tell("Touch nothing with the gel, then push the button.")
    await_push(hardware, LiftOff())
    for light in hardware.profile.lights:
        if told := check_shines(hardware, plan, light):
            tell(f"Note: the driver says {told} at light {light.name}, which is seen: run `retroscan selftest`.")
    reference = capture(hardware, plan)
    plan = replace(plan, granted=reference.granted)
    check_exposed(bin_bayer(reference, BINNING), "the reference")
    divisor = blurred_reference(bin_bayer(reference, BINNING))
    presses = _guided_presses(hardware, plan, divisor, ball_radius_mm, tell)
    tell("Fitting the model ...")
    fit = _fit(presses, reference.shape)
    bundle = publish(hardware, store, plan, reference, presses, fit, ball_radius_mm)
    store.activate(bundle.calibration_id)
    return CalibrationOutcome(bundle, fit)


def _guided_presses(
    hardware: Hardware,
    plan: CapturePlan,
    divisor: Float32Array,
    ball_radius_mm: float,
    tell: Callable[[str], None],
) -> list[AcceptedPress]:
    """A press for each place of the field; a place without a usable ball is asked for again, then left out."""
    places = press_places()
    radius_px = ball_radius_mm * 1e3 / hardware.profile.sensor.pixel_pitch_um
    presses = []
    for number, (column_share, row_share) in enumerate(places, start=1):
        for _ in range(MOST_TRIES):
            tell(f"{number}/{len(places)}: press the ball {_where(column_share, row_share)}, then push the button.")
            await_push(hardware, PressBall(ball_radius_mm, column_share, row_share))
            press, complaint = _read_press(capture(hardware, plan), divisor, radius_px)
            if press:
                presses.append(press)
                break
            tell(f"  {complaint}; once more.")
    return presses


def _read_press(frame: RawFrame, divisor: Float32Array, radius_px: float) -> tuple[AcceptedPress | None, str]:
    """The press that a frame shows, or None and what is wrong with it."""
    intensity = divide(bin_bayer(frame, BINNING), divisor)
    search: BallSearch = find_balls(intensity, radius_px / BINNING)
    if not search.found:
        reasons = "; ".join(sorted({ball.reason for ball in search.rejected}))
        return None, f"no usable ball is seen ({reasons})" if reasons else "no ball is seen"
    samples = gather_samples([(intensity, search.found)]).enlarged(BINNING)
    balls = tuple(ball.enlarged(BINNING) for ball in search.found)
    rejected = tuple(replace(ball, column=BINNING * ball.column, row=BINNING * ball.row) for ball in search.rejected)
    return AcceptedPress(frame, balls, rejected, samples), ""


def _where(column_share: float, row_share: float) -> str:
    """A place of the field in words."""
    across = ("far left", "left", "right", "far right")[min(int(column_share * COLUMNS), COLUMNS - 1)]
    down = ("at the top", "half-way down", "at the bottom")[min(int(row_share * ROWS), ROWS - 1)]
    return f"{across}, {down}"


def _fit(presses: Sequence[AcceptedPress], shape: tuple[int, int]) -> InverseFit:
    balls = [ball for press in presses for ball in press.balls]
    if len(balls) < FEWEST_BALLS:
        raise CalibrationError(
            f"only {len(balls)} of {len(press_places())} presses showed a usable ball and {FEWEST_BALLS} are needed: "
            "press deeper, wipe ball and gel, and calibrate again"
        )
    fit = fit_inverse_map(_joined(presses), balls, shape, max_samples=FITTED_SAMPLES)
    if fit.held_out_deg is not None and fit.held_out_deg > WORST_HELD_OUT_DEG:
        raise CalibrationError(
            f"the balls contradict each other (held-out error {fit.held_out_deg:.1f} degrees, at most "
            f"{WORST_HELD_OUT_DEG:g}): check the ball's radius, wipe ball and gel, and calibrate again"
        )
    return fit


def _joined(presses: Sequence[AcceptedPress]) -> BallSamples:
    """The samples of all presses, balls numbered through."""
    first = np.cumsum([0] + [len(press.balls) for press in presses])
    samples = [press.samples for press in presses]
    return BallSamples(
        intensity=np.concatenate([part.intensity for part in samples]),
        p=np.concatenate([part.p for part in samples]),
        q=np.concatenate([part.q for part in samples]),
        column=np.concatenate([part.column for part in samples]),
        row=np.concatenate([part.row for part in samples]),
        ball=np.concatenate([part.ball + offset for part, offset in zip(samples, first[:-1], strict=True)]),
    )
