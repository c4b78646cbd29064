"""The verdict on a press, from its binned frame and the state of lights and gel. It needs no reconstruction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np

from device.bundles.scan import VerdictLevel, VerdictRecord
from device.imaging.exposure import Levels
from device.imaging.flat_field import BLACK_FRAME, LinearFrame, NormalizedImage
from device.imaging.frame_measures import shaded_fraction, sharpness
from device.quality.lights import border_levels, light_complaint
from device.quality.thresholds import (
    CLIPPED_DOUBTFUL,
    CLIPPED_RETAKE,
    DRIFTED,
    DRIFTED_FAR,
    MAX_DEFECTS,
    MAX_DEPTH,
    MIN_CONTACT,
    MOTION_DOUBTFUL,
    SHARP,
)

_WORST_FIRST: Final[tuple[VerdictLevel, ...]] = ("retake", "doubtful")


@dataclass(frozen=True, slots=True)
class InstrumentContext:
    """What is known apart from the frame itself; None means not measured, never 0.

    at_rest : whether the whole skin matches the reference
    motion : change of intensity between the last live frame and the scan's
    light_change : relative change of each light since calibration, by name
    reference_change : rms change of the untouched skin's pattern since calibration
    defect_fraction : fraction of the field with scratches, dust or stains
    gel_presses : number of presses of this gel
    depth_fraction : height of the raised skin as a fraction of the slab's thickness
    """

    at_rest: bool | None = None
    motion: float | None = None
    light_change: Mapping[str, float | None] = field(default_factory=dict)
    reference_change: float | None = None
    defect_fraction: float | None = None
    gel_presses: int | None = None
    depth_fraction: float | None = None

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
        }


@dataclass(frozen=True, slots=True)
class FrameMetrics:
    """Figures of the frame itself, as fractions of full scale or of the field; None without an intensity image."""

    exposure: float
    clipped: float
    contact: float | None
    sharp: float | None

    @classmethod
    def of(cls, frame: LinearFrame, intensity: NormalizedImage | None) -> FrameMetrics:
        """The metrics of a frame."""
        return cls(
            exposure=float(np.percentile(frame.rgb[::2, ::2], 99)),
            clipped=float(frame.clipped.mean()),
            contact=None if intensity is None else shaded_fraction(intensity),
            sharp=None if intensity is None else sharpness(intensity),
        )

    @property
    def figures(self) -> dict[str, float | None]:
        """The figures as a scan's record keeps them."""
        return {
            "exposure_p99": self.exposure,
            "clipped_share": self.clipped,
            "contact_share": self.contact,
            "sharpness": self.sharp,
        }


def judge(
    frame: LinearFrame,
    intensity: NormalizedImage | None,
    lights: Sequence[str] = ("red", "green", "blue"),
    flags: Mapping[str, str] = MappingProxyType({}),
    known: InstrumentContext | None = None,
) -> VerdictRecord:
    """The verdict's level, reason and figures.

    intensity : None if the frame could not be flat-field-corrected
    lights : their names in R, G, B order
    flags : the light driver's flags during the exposure by light, such as "open"
    known : state of operator, lights and gel
    """
    known = known or InstrumentContext()
    metrics = FrameMetrics.of(frame, intensity)
    border = None if intensity is None else border_levels(intensity)
    figures = metrics.figures | border_figures(border) | known.figures
    if metrics.exposure < BLACK_FRAME:
        flagged = "".join(f"; the driver reports {kind} at light {light}" for light, kind in flags.items())
        return VerdictRecord(level="retake", reason=f"the frame is black{flagged}: check the lights", figures=figures)
    complaint = light_complaint(border, lights, flags)
    complaints = [*([complaint] if complaint else []), *_frame_complaints(metrics, known.at_rest), *_complaints(known)]
    for level in _WORST_FIRST:
        for found, reason in complaints:
            if found == level:
                return VerdictRecord(level=level, reason=reason, figures=figures)
    relief = "" if metrics.contact is None else f", relief over {metrics.contact:.0%} of the field"
    return VerdictRecord(level="good", reason=f"exposure {metrics.exposure:.0%}{relief}", figures=figures)


def border_figures(levels: Levels | None) -> dict[str, float | None]:
    """Median intensity along the border by channel, 1 as calibrated."""
    return {
        f"border_level_{colour}": None if levels is None else level
        for colour, level in zip(("red", "green", "blue"), levels or (None,) * 3, strict=True)
    }


def _frame_complaints(metrics: FrameMetrics, at_rest: bool | None) -> Iterator[tuple[VerdictLevel, str]]:
    """What is wrong with the frame, most specific first; a smooth object over the whole field hardly shades it."""
    if metrics.clipped > CLIPPED_RETAKE:
        yield "retake", f"{metrics.clipped:.0%} of the frame is saturated: lower the exposure or press more evenly"
    if metrics.contact is not None and metrics.contact < MIN_CONTACT and at_rest is not False:
        yield "doubtful", "hardly any contact: press harder, or press inside the field"
    if metrics.clipped > CLIPPED_DOUBTFUL:
        yield "doubtful", f"{metrics.clipped:.1%} of the frame is saturated: slopes there are interpolated"
    if metrics.sharp is not None and metrics.sharp < SHARP:
        yield (
            "doubtful",
            f"no sharp edge ({metrics.sharp:.2f}, {SHARP:g} expected): hold still, check the lens",
        )


def _complaints(known: InstrumentContext) -> Iterator[tuple[VerdictLevel, str]]:
    """What is wrong with operator, lights and gel."""
    if known.motion is not None and known.motion > MOTION_DOUBTFUL:
        yield "doubtful", f"the contact moved during the exposure ({known.motion:.0%} of intensity): hold still"
    if known.depth_fraction is not None and known.depth_fraction > MAX_DEPTH:
        yield (
            "doubtful",
            f"pressed to {known.depth_fraction:.0%} of the gel's thickness: press less, it may tear",
        )
    yield from drift_complaints(known.light_change, known.reference_change)
    if known.defect_fraction is not None and known.defect_fraction > MAX_DEFECTS:
        yield "doubtful", f"{known.defect_fraction:.1%} of the skin is scratched or dirty: wipe or change the gel"


def drift_complaints(
    light_change: Mapping[str, float | None], reference_change: float | None
) -> Iterator[tuple[VerdictLevel, str]]:
    """What has drifted since calibration, worst light first."""
    changes = {name: change for name, change in light_change.items() if change is not None}
    for name, change in sorted(changes.items(), key=lambda item: -abs(item[1])):
        if abs(change) > DRIFTED:
            how = f"{abs(change):.1%} {'weaker' if change < 0.0 else 'stronger'} than at calibration"
            lost = abs(change) > DRIFTED_FAR
            advice = "calibrate before the next scan" if lost else "calibrate soon, heights are off by about as much"
            yield "doubtful", f"light {name} is {how}: {advice}"
    if reference_change is not None and reference_change > DRIFTED:
        yield "doubtful", f"the untouched skin has changed by {reference_change:.1%}: wipe the gel, or calibrate again"
