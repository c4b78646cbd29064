"""The verdict on a press, from its binned frame and the state of lights and gel. It needs no reconstruction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from device.bundles.scan import VerdictLevel, VerdictRecord
from device.imaging.flat_field import BLACK_FRAME, LinearFrame, NormalizedImage
from device.imaging.frame_light import Levels
from device.imaging.frame_measures import shaded_fraction, sharpness
from device.quality.press_faults import (
    CLIPPED_DOUBTFUL,
    DRIFTED,
    DRIFTED_FAR,
    LIGHT_DRIFTED,
    MAX_DARK_SPOTS,
    MAX_DEFECTS,
    MIN_CONTACT,
    MOTION_DOUBTFUL,
    SHARP,
    PressFigures,
    press_faults,
)
from device.quality.untouched import dark_spots
from device.surface import MaskArray

LIGHTS_UNKNOWN: Final = "the lights could not be checked: lift off for a moment after each press"

_WORST_FIRST: Final[tuple[VerdictLevel, ...]] = ("retake", "doubtful")


@dataclass(frozen=True, slots=True)
class InstrumentContext:
    """State of the instrument apart from the frame itself; None means not measured, never 0.

    motion : change of intensity between the last live frame and the scan's
    light_change : relative change of each light since calibration, by name
    reference_change : rms change of the untouched skin's pattern since calibration
    defect_fraction : fraction of the field with scratches, dust or stains
    gel_presses : number of presses of this gel
    contact_fraction, depth_fraction, tilt_deg, tilt_towards : of the press, as the press guide measures them; see
        `PressFigures`
    covers_field : whether a gentle object covers the whole field, so that its contact cannot be measured
    failed_check : the last check of the check standard, if it failed
    """

    motion: float | None = None
    light_change: Mapping[str, float | None] = field(default_factory=dict)
    reference_change: float | None = None
    defect_fraction: float | None = None
    gel_presses: int | None = None
    contact_fraction: float | None = None
    depth_fraction: float | None = None
    tilt_deg: float | None = None
    tilt_towards: str = ""
    covers_field: bool = False
    failed_check: str = ""

    @property
    def figures(self) -> dict[str, float | None]:
        """The figures as a scan's record keeps them."""
        lights = {f"light_change_{name}": change for name, change in self.light_change.items()}
        return lights | {
            "motion": self.motion,
            "reference_change": self.reference_change,
            "defect_share": self.defect_fraction,
            "gel_presses": None if self.gel_presses is None else float(self.gel_presses),
            "depth_share": self.depth_fraction,
            "tilt_deg": self.tilt_deg,
        }


@dataclass(frozen=True, slots=True)
class FrameMetrics:
    """Figures of the frame itself, as fractions of full scale or of the field; None without an intensity image.

    dark_spots : fraction of the field with dust, scratches or stains since the calibration
    """

    exposure: float
    clipped: float
    contact: float | None
    sharp: float | None
    dark_spots: float | None

    @classmethod
    def of(cls, frame: LinearFrame, intensity: NormalizedImage | None) -> FrameMetrics:
        """Return the metrics of a frame."""
        return cls(
            exposure=float(np.percentile(frame.rgb[::2, ::2], 99)),
            clipped=float(frame.clipped.mean()),
            contact=None if intensity is None else shaded_fraction(intensity),
            sharp=None if intensity is None else sharpness(intensity),
            dark_spots=None if intensity is None else float(dark_spots(intensity).mean()),
        )

    @property
    def figures(self) -> dict[str, float | None]:
        """The figures as a scan's record keeps them."""
        return {
            "exposure_p99": self.exposure,
            "clipped_share": self.clipped,
            "contact_share": self.contact,
            "sharpness": self.sharp,
            "dark_spot_share": self.dark_spots,
        }


@dataclass(frozen=True, slots=True)
class Evidence:
    """Everything that a verdict follows from.

    metrics : of the frame
    border : median intensity along the border; None if not measured
    lights : their names in R, G, B order
    flags : the light driver's flags during the exposure by light, such as "open"
    known : state of operator, lights and gel
    """

    metrics: FrameMetrics
    border: Levels | None
    lights: tuple[str, ...]
    flags: Mapping[str, str]
    known: InstrumentContext

    @classmethod
    def of(
        cls,
        frame: LinearFrame,
        intensity: NormalizedImage | None,
        lights: Sequence[str],
        flags: Mapping[str, str],
        known: InstrumentContext,
    ) -> Evidence:
        """Return the evidence in a frame; `intensity` is None if it could not be flat-field-corrected."""
        border = None if intensity is None else border_levels(intensity)
        return cls(FrameMetrics.of(frame, intensity), border, tuple(lights), flags, known)

    @property
    def lacks_only_lights(self) -> bool:
        """True if everything is good except that the lights' levels at this press are not known."""
        return self.verdict().reason == LIGHTS_UNKNOWN

    @property
    def light_fault(self) -> str:
        """Return what is wrong with the lights, in a sentence; empty if nothing is known to be."""
        return "" if self._press.lights is None else self._press.lights[1]

    @property
    def lacks_contact(self) -> bool:
        """True if nothing touches the skin, as far as the frame shows."""
        contact = self._press.contact_fraction
        return contact is not None and contact < MIN_CONTACT

    def with_light_change(self, change: Mapping[str, float | None]) -> Evidence:
        """Return the same with another measurement of the lights."""
        return replace(self, known=replace(self.known, light_change=change))

    def with_failed_check(self, sentence: str) -> Evidence:
        """Return the same after a failed check of the check standard."""
        return replace(self, known=replace(self.known, failed_check=sentence))

    def verdict(self) -> VerdictRecord:
        """Return the verdict's level, reason and figures."""
        metrics, known = self.metrics, self.known
        figures = metrics.figures | border_figures(self.border) | known.figures
        figures["contact_share"] = self._press.contact_fraction
        if not self._press.light_is_right:
            figures |= dict.fromkeys(("contact_share", "depth_share", "tilt_deg"))
        if metrics.exposure < BLACK_FRAME:
            flagged = "".join(f"; the driver reports {kind} at light {light}" for light, kind in self.flags.items())
            return VerdictRecord(
                level="retake", reason=f"the frame is black{flagged}: check the lights", figures=figures
            )
        complaints = [
            *((fault.level, fault.sentence) for fault in press_faults(self._press)),
            *_frame_complaints(metrics),
            *_complaints(known),
            *_unknown_lights(known, self.lights),
        ]
        for level in _WORST_FIRST:
            for found, reason in complaints:
                if found == level:
                    return VerdictRecord(level=level, reason=reason, figures=figures)
        contact = self._press.contact_fraction
        relief = "" if contact is None else f", relief over {contact:.0%} of the field"
        return VerdictRecord(level="good", reason=f"exposure {metrics.exposure:.0%}{relief}", figures=figures)

    @property
    def _press(self) -> PressFigures:
        """The figures that the press guide judges too."""
        metrics, known = self.metrics, self.known
        drift = drift_complaints(known.light_change, None)
        contact = metrics.contact if known.contact_fraction is None else known.contact_fraction
        return PressFigures(
            exposure=metrics.exposure,
            clipped_fraction=metrics.clipped,
            lights=light_complaint(self.border, self.lights, self.flags) or next(drift, None),
            contact_fraction=None if known.covers_field else contact,
            depth_fraction=known.depth_fraction,
            tilt_deg=known.tilt_deg,
            tilt_towards=known.tilt_towards,
        )


def border_figures(levels: Levels | None) -> dict[str, float | None]:
    """Return the median intensity along the border by channel, 1 as calibrated."""
    return {
        f"border_level_{colour}": None if levels is None else level
        for colour, level in zip(("red", "green", "blue"), levels or (None,) * 3, strict=True)
    }


def _frame_complaints(metrics: FrameMetrics) -> Iterator[tuple[VerdictLevel, str]]:
    """Return what is wrong with the frame apart from the press."""
    if metrics.clipped > CLIPPED_DOUBTFUL:
        yield "doubtful", f"{metrics.clipped:.1%} of the frame is saturated: slopes there are interpolated"
    if metrics.sharp is not None and metrics.sharp < SHARP:
        yield (
            "doubtful",
            f"no sharp edge ({metrics.sharp:.2f}, {SHARP:g} expected): hold still, check the lens",
        )
    if metrics.dark_spots is not None and metrics.dark_spots > MAX_DARK_SPOTS:
        yield "doubtful", dirt_sentence(metrics.dark_spots)


def _complaints(known: InstrumentContext) -> Iterator[tuple[VerdictLevel, str]]:
    """Return what is wrong with operator, lights and gel."""
    if known.motion is not None and known.motion > MOTION_DOUBTFUL:
        yield "doubtful", f"the contact moved during the exposure ({known.motion:.0%} of intensity): hold still"
    yield from drift_complaints(known.light_change, known.reference_change)
    if known.failed_check:
        yield "doubtful", known.failed_check
    if known.defect_fraction is not None and known.defect_fraction > MAX_DEFECTS:
        yield "doubtful", dirt_sentence(known.defect_fraction)


def dirt_sentence(fraction: float) -> str:
    """Return what to do about a skin with defects over this fraction."""
    return f"{fraction:.1%} of the skin is scratched or dirty: wipe or change the gel"


def _unknown_lights(known: InstrumentContext, lights: Sequence[str]) -> Iterator[tuple[VerdictLevel, str]]:
    """Yield lights whose level at this press is not known may be wrong: unknown is never taken as unchanged."""
    if any(known.light_change.get(name) is None for name in lights):
        yield "doubtful", LIGHTS_UNKNOWN


def drift_complaints(
    light_change: Mapping[str, float | None], reference_change: float | None
) -> Iterator[tuple[VerdictLevel, str]]:
    """Return what has drifted since calibration, worst light first."""
    changes = {name: change for name, change in light_change.items() if change is not None}
    for name, change in sorted(changes.items(), key=lambda item: -abs(item[1])):
        if abs(change) > LIGHT_DRIFTED:
            how = f"{abs(change):.1%} {'weaker' if change < 0.0 else 'stronger'} than at calibration"
            lost = abs(change) > DRIFTED_FAR
            advice = "calibrate before the next scan" if lost else "calibrate soon, heights are off by about as much"
            yield "doubtful", f"light {name} is {how}: {advice}"
    if reference_change is not None and reference_change > DRIFTED:
        yield "doubtful", f"the untouched skin has changed by {reference_change:.1%}: wipe the gel, or calibrate again"


# Light levels at the field's border and the light driver's flags, compared with the calibration.
#
# A press rarely reaches the border, where the skin then matches the reference and intensity is 1. Driver flags are
# advisory because they are sometimes wrong: they alone never reject a press that the camera saw well lit.

BORDER_FRACTION: Final = 1 / 12
"""Width of the border as a fraction of the field's shorter side."""

OUT_LEVEL: Final = 0.75
"""Below this fraction of its calibrated level a light, or one of its two LEDs, is out: no slope can be trusted."""

WEAK_LEVEL: Final = 0.9
"""Below this fraction slopes are off by degrees."""


def border_levels(intensity: NormalizedImage) -> Levels | None:
    """Return the median intensity of R, G and B along the border, 1 as calibrated; None if no border pixel is valid."""
    border = _border(intensity.shape) & intensity.valid
    if not border.any():
        return None
    red, green, blue = (float(level) for level in np.median(intensity.values[border], axis=0))
    return red, green, blue


def light_complaint(
    levels: Levels | None, names: Sequence[str], flags: Mapping[str, str]
) -> tuple[Literal["doubtful", "retake"], str] | None:
    """Return what is wrong with the lights, as a verdict's level and reason; None if nothing is.

    levels : from `border_levels`; None if not measured
    names : of the lights in R, G, B order
    flags : the driver's flags by light, such as "open"
    """
    measured: dict[str, float] = {} if levels is None else dict(zip(names, levels, strict=True))
    out = [name for name in names if (measured[name] < OUT_LEVEL if measured else name in flags)]
    if out:
        found = "; ".join(_describe(name, measured.get(name), flags.get(name)) for name in out)
        return "retake", f"{found}: check its LEDs and wires, and run `retroscan selftest`"
    suspect = [name for name in names if name in flags or measured.get(name, 1.0) < WEAK_LEVEL]
    if suspect:
        found = "; ".join(_describe(name, measured[name], flags.get(name)) for name in suspect)
        return "doubtful", f"{found}: run `retroscan selftest`" + ("" if flags else ", then calibrate again")
    return None


def _describe(name: str, level: float | None, flag: str | None) -> str:
    seen = "" if level is None else f" is at {level:.0%} of its calibrated level"
    return f"light {name}{seen}" + (f"{' and' if seen else ':'} the driver reports {flag}" if flag else "")


def _border(shape: tuple[int, int]) -> MaskArray:
    """True along the border of a field of shape (H, W)."""
    width = max(round(BORDER_FRACTION * min(shape)), 1)
    border = np.ones(shape, np.bool_)
    border[width:-width, width:-width] = False
    return border
