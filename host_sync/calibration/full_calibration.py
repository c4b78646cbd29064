"""The workstation's calibration: from press frames to the models that turn intensity into slope."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from device.ball import gather_samples
from device.errors import CalibrationError
from device.inverse_fit import InverseFit, fit_inverse_map
from device.light_field import LightField
from device.photometry import LinearFrame, blurred_reference
from device.pseudo_reference import pseudo_reference
from device.surface import Float32Array
from host_sync.calibration.assessment import Assessment, assess
from host_sync.calibration.ball_location import (
    PressFrame,
    UsedPress,
    after_fit,
    check_sizes,
    drop_clipped,
    drop_empty_labels,
    locate,
    seen_beyond_labels,
    seen_instead_of_labelled,
)
from host_sync.calibration.calibration_verdict import check_count
from host_sync.calibration.frame_agreement import check_agreement, check_reference
from host_sync.calibration.grid_press import measure_pitch
from host_sync.calibration.held_out import held_out_paper_deg
from host_sync.calibration.paper_model import PaperModel, fit_paper_model
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.calibration.slope_error import SlopeError, measure_slope_error

Method = Literal["direct", "paper"]
Centres = Literal["found", "labelled", "found at labels", "found at labels and beyond"]
METHODS: Final[tuple[Method, ...]] = ("direct", "paper")
FITTED_SAMPLES: Final = 40_000
WORTH_MORE_BALLS: Final = 1.1
"""Balls that no label has are tried when there are so many times as many with them."""

MORE_BALLS_GAIN: Final = 0.95
"""Their held-out error counts as so much smaller: more balls show more of the field than the labelled ones can tell."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that reconstruction needs, and what the report tells.

    calibration_id : digest of the models and the reference
    divisor : float32 array of shape (H, W, 3), what frames are divided by
    has_reference : False when the divisor is a stand-in fitted to the frames
    pitch_um : distance of neighbouring pixels on the skin, µm; measured where a ball grid's spacing is known
    centres : where the balls' centres came from before they were refined
    inverse : the position-aware inverse map and its held-out errors
    paper : the paper's model
    held_out_deg : mean angular error on held-out balls by method
    assessment : what the calibration is worth: the scale's ±, coverage, pass or fail
    """

    calibration_id: str
    divisor: Float32Array
    has_reference: bool
    pitch_um: float
    presses: tuple[UsedPress, ...]
    centres: Centres
    inverse: InverseFit
    paper: PaperModel
    slope_error: SlopeError
    held_out_deg: dict[Method, float]
    assessment: Assessment

    @property
    def pixel_pitch_sigma_um(self) -> float | None:
        """Standard uncertainty of `pitch_um`, None when it was not measured."""
        return self.assessment.scale.pixel_pitch_sigma_um

    @property
    def preferred(self) -> Method:
        """The method that held-out balls prefer."""
        return "paper" if self.held_out_deg["paper"] < self.held_out_deg["direct"] else "direct"


def calibrate(
    presses: Sequence[PressFrame],
    reference: LinearFrame | None,
    pitch_um: float,
    *,
    others: Sequence[LinearFrame] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """The calibration of one gel and set of lights.

    reference : frame of the skin at rest; None fits a stand-in to the presses and `others`
    pitch_um : as stated; where a press shows a grid of known spacing, the pitch that it measures is used instead
    tell : is given a few words as each step begins

    Raises
    ------
    CalibrationError
        No press, too few balls, contradictory radii, a grossly wrong pitch, or held-out balls that are wrong.
    CalibrationMismatch
        Frames of different sizes, channel orders, lights or gels.
    """
    if not presses:
        raise CalibrationError("there is no calibration press: press a ball of known radius into the gel")
    check_sizes(presses, reference)
    if reference is not None:
        check_reference(reference)
    tell("dividing by the reference")
    divisor = blurred_reference(reference) if reference else pseudo_reference([p.frame for p in presses] + list(others))
    tell("finding balls")
    located, pitch = _locate_all(presses, divisor, pitch_um, reference is not None)
    pitch_um = pitch.pitch_um if pitch else pitch_um
    tell("fitting the position-aware inverse map")
    inverse, located, centres = _fit(presses, located, LightField.of(divisor) if reference else None)
    used = after_fit(located, inverse)
    kept = [(press.intensity, press.balls) for press in used]
    taught = gather_samples(kept)
    assessment = assess(presses, used, taught, inverse, pitch)
    tell("building reflectance maps and the lookup table")
    paper = fit_paper_model(taught)
    held_out: dict[Method, float] = {
        "direct": inverse.held_out_deg if inverse.held_out_deg is not None else float("nan"),
        "paper": held_out_paper_deg(kept),
    }
    tell("measuring the slope error")
    error = measure_slope_error(kept, taught, inverse)
    digest = _digest(inverse, divisor, pitch_um)
    return Calibration(
        calibration_id=digest,
        divisor=divisor,
        has_reference=reference is not None,
        pitch_um=pitch_um,
        presses=used,
        centres=centres,
        inverse=inverse,
        paper=paper,
        slope_error=error,
        held_out_deg=held_out,
        assessment=assessment,
    )


def _locate_all(
    presses: Sequence[PressFrame], divisor: Float32Array, stated_um: float, has_reference: bool
) -> tuple[Sequence[UsedPress], PixelPitch | None]:
    """The presses with the balls that may teach, and the pixel pitch that grids among them measure."""
    labelled = drop_empty_labels([locate(press, divisor) for press in presses], [p.labelled_by_hand for p in presses])
    check_agreement([p.called for p in presses], [used.intensity for used in labelled], has_reference)
    located, pitch = measure_pitch(presses, labelled, stated_um)
    located = [drop_clipped(used) for used in located]
    check_count(located)
    return located, pitch


def _fit(
    presses: Sequence[PressFrame], located: Sequence[UsedPress], light: LightField | None
) -> tuple[InverseFit, Sequence[UsedPress], Centres]:
    """The inverse map; where a hand labelled balls, fitted to the balls and centres that held-out labelled ones prefer.

    Balls that no label has count where they make the labelled ones' held-out error smaller.

    light : of untouched skin, None where no reference shows it
    """
    by_hand = [press.labelled_by_hand for press in presses]
    best = _fit_to(located, light)
    if not any(by_hand):
        return best, located, "found"
    chosen: tuple[Sequence[UsedPress], Centres] = (located, "labelled")
    choices: tuple[tuple[Centres, Callable[[UsedPress], UsedPress]], ...] = (
        ("found at labels", seen_instead_of_labelled),
        ("found at labels and beyond", seen_beyond_labels),
    )
    for name, move in choices:
        moved = [move(used) if hand else used for used, hand in zip(located, by_hand, strict=True)]
        more = name == "found at labels and beyond"
        if more and _count(moved) < WORTH_MORE_BALLS * _count(located):
            continue
        fit = _fit_to(moved, light)
        gain = MORE_BALLS_GAIN if more else 1.0
        if gain * _label_error_deg(fit, moved, located) < _label_error_deg(best, chosen[0], located):
            best, chosen = fit, (moved, name)
    return best, *chosen


def _count(presses: Sequence[UsedPress]) -> int:
    return sum(len(press.balls) for press in presses)


def _label_error_deg(fit: InverseFit, fitted: Sequence[UsedPress], located: Sequence[UsedPress]) -> float:
    """Median held-out error of the balls that `located` holds too: the first of each press in `fitted`."""
    common = [i < len(own.balls) for press, own in zip(fitted, located, strict=True) for i in range(len(press.balls))]
    return float(np.median(fit.ball_error_deg[np.array(common)]))


def _fit_to(presses: Sequence[UsedPress], light: LightField | None) -> InverseFit:
    samples = gather_samples([(press.intensity, press.balls) for press in presses])
    balls = [ball for press in presses for ball in press.balls]
    return fit_inverse_map(samples, balls, presses[0].intensity.shape, max_samples=FITTED_SAMPLES, light=light)


def _digest(inverse: InverseFit, divisor: Float32Array, pitch_um: float) -> str:
    """Twelve hexadecimal digits that change when the calibration does."""
    digest = hashlib.sha256(np.float64(pitch_um).tobytes())
    for _, array in sorted(inverse.map.arrays().items()):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(np.ascontiguousarray(divisor).tobytes())
    return digest.hexdigest()[:12]
