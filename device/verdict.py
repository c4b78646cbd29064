"""The verdict on a press: what its binned frame and the state of lights and gel say. It never waits for a
reconstruction to succeed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import cv2
import numpy as np

from device.exposure_levels import Levels
from device.health_limits import (
    CLIPPED_DOUBTFUL,
    CLIPPED_RETAKE,
    DEEPEST_SHARE,
    DEFECTS_DOUBTFUL,
    DRIFTED,
    DRIFTED_FAR,
    LEAST_CONTACT,
    MOTION_DOUBTFUL,
    SHADED,
    SHARP,
)
from device.light_check import border_levels, light_complaint
from device.photometry import BLACK_FRAME, IntensityImage, LinearFrame
from device.scan_bundle import VerdictLevel, VerdictRecord
from device.sharpness import sharpness

_WORST_FIRST: Final[tuple[VerdictLevel, ...]] = ("retake", "doubtful")


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What is known beside the frame itself; None is "not seen", never 0.

    at_rest : whether the whole skin lies as in the reference
    motion : change of intensity between the last live frame and the scan's
    light_change : of each light by name since calibration, relative
    reference_change : of the resting skin's pattern since calibration, root mean square
    defect_share : of the field under scratches, dust or stains
    gel_presses : how often this gel was pressed
    depth_share : of the slab's thickness to which the skin is pushed up
    """

    at_rest: bool | None = None
    motion: float | None = None
    light_change: Mapping[str, float | None] = field(default_factory=dict)
    reference_change: float | None = None
    defect_share: float | None = None
    gel_presses: int | None = None
    depth_share: float | None = None

    @property
    def figures(self) -> dict[str, float | None]:
        """The same as a scan's record keeps them."""
        lights = {f"light_change_{name}": change for name, change in self.light_change.items()}
        return lights | {
            "motion": self.motion,
            "reference_change": self.reference_change,
            "defect_share": self.defect_share,
            "gel_presses": None if self.gel_presses is None else float(self.gel_presses),
            "depth_share": self.depth_share,
        }


@dataclass(frozen=True, slots=True)
class Seen:
    """What the frame itself says; shares of full scale or of the field, None where no intensity could be had."""

    exposure: float
    clipped: float
    contact: float | None
    sharp: float | None

    @classmethod
    def of(cls, frame: LinearFrame, intensity: IntensityImage | None) -> Seen:
        """The figures of a frame."""
        return cls(
            exposure=float(np.percentile(frame.rgb[::2, ::2], 99)),
            clipped=float(frame.clipped.mean()),
            contact=None if intensity is None else shaded_share(intensity),
            sharp=None if intensity is None else sharpness(intensity),
        )

    @property
    def figures(self) -> dict[str, float | None]:
        """The same as a scan's record keeps them."""
        return {
            "exposure_p99": self.exposure,
            "clipped_share": self.clipped,
            "contact_share": self.contact,
            "sharpness": self.sharp,
        }


def judge(
    frame: LinearFrame,
    intensity: IntensityImage | None,
    lights: Sequence[str] = ("red", "green", "blue"),
    flags: Mapping[str, str] = MappingProxyType({}),
    known: Circumstances | None = None,
) -> VerdictRecord:
    """Level, reason and figures.

    intensity : None when the frame could not be divided by a reference
    lights : their names in R, G, B order
    flags : what the light driver said while they shone, such as "open", by light
    known : of hand, lights and gel, as far as anybody looked
    """
    known = known or Circumstances()
    seen = Seen.of(frame, intensity)
    border = None if intensity is None else border_levels(intensity)
    figures = seen.figures | border_figures(border) | known.figures
    if seen.exposure < BLACK_FRAME:
        told = "".join(f"; the driver says {kind} at light {light}" for light, kind in flags.items())
        return VerdictRecord(level="retake", reason=f"the frame is black{told}: check the lights", figures=figures)
    complaint = light_complaint(border, lights, flags)
    complaints = [*([complaint] if complaint else []), *_of_frame(seen, known.at_rest), *_of_circumstances(known)]
    for level in _WORST_FIRST:
        for found, reason in complaints:
            if found == level:
                return VerdictRecord(level=level, reason=reason, figures=figures)
    relief = "" if seen.contact is None else f", relief over {seen.contact:.0%} of the field"
    return VerdictRecord(level="good", reason=f"exposure {seen.exposure:.0%}{relief}", figures=figures)


def border_figures(levels: Levels | None) -> dict[str, float | None]:
    """The skin's level along the border by channel, 1 as calibrated."""
    return {
        f"border_level_{colour}": None if levels is None else level
        for colour, level in zip(("red", "green", "blue"), levels or (None,) * 3, strict=True)
    }


def _of_frame(seen: Seen, at_rest: bool | None) -> Iterator[tuple[VerdictLevel, str]]:
    """What is wrong with the frame, the most telling first; a smooth thing over the whole field hardly shades it."""
    if seen.clipped > CLIPPED_RETAKE:
        yield "retake", f"{seen.clipped:.0%} of the frame is saturated: lower the exposure or press more evenly"
    if seen.contact is not None and seen.contact < LEAST_CONTACT and at_rest is not False:
        yield "doubtful", "hardly anything presses the skin: press harder or check the place"
    if seen.clipped > CLIPPED_DOUBTFUL:
        yield (
            "doubtful",
            f"{seen.clipped:.1%} of the frame is saturated: slopes there are guessed from their neighbours",
        )
    if seen.sharp is not None and seen.sharp < SHARP:
        yield "doubtful", f"no edge is sharp ({seen.sharp:.2f}, {SHARP:g} is usual): hold still, check the lens"


def _of_circumstances(known: Circumstances) -> Iterator[tuple[VerdictLevel, str]]:
    """What is wrong with hand, lights and gel."""
    if known.motion is not None and known.motion > MOTION_DOUBTFUL:
        yield "doubtful", f"the contact moved by {known.motion:.0%} of intensity as the frame was taken: hold still"
    if known.depth_share is not None and known.depth_share > DEEPEST_SHARE:
        yield "doubtful", f"pressed to {known.depth_share:.0%} of the gel's thickness: press less, the gel may tear"
    yield from drift_complaints(known.light_change, known.reference_change)
    if known.defect_share is not None and known.defect_share > DEFECTS_DOUBTFUL:
        yield "doubtful", f"{known.defect_share:.1%} of the skin is scratched or dirty: wipe the gel or change it"


def drift_complaints(
    light_change: Mapping[str, float | None], reference_change: float | None
) -> Iterator[tuple[VerdictLevel, str]]:
    """What has drifted since calibration, the worst light first."""
    changes = {name: change for name, change in light_change.items() if change is not None}
    for name, change in sorted(changes.items(), key=lambda item: -abs(item[1])):
        if abs(change) > DRIFTED:
            how = f"{abs(change):.1%} {'weaker' if change < 0.0 else 'stronger'} than at calibration"
            lost = abs(change) > DRIFTED_FAR
            advice = "calibrate before the next scan" if lost else "calibrate soon, heights are off by as much"
            yield "doubtful", f"light {name} is {how}: {advice}"
    if reference_change is not None and reference_change > DRIFTED:
        yield "doubtful", f"the resting skin has changed by {reference_change:.1%}: wipe the gel, or calibrate anew"


def shaded_share(intensity: IntensityImage) -> float:
    """Share of the field whose intensity says that the skin is not flat."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    red, green, blue = np.moveaxis(np.abs(smooth - 1.0) > SHADED, -1, 0)
    shaded = red | green | blue
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0
