"""The coach: one reading a live frame, from intensities, the tabulated inverse map and a small integration."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.coaching.advice import advise
from device.coaching.coach_reading import CoachReading
from device.coaching.thin_frame import ThinFrame, thinning
from device.fft_integrator import integrate_dct
from device.health_limits import DEEPEST_SHARE, LEAST_CONTACT, MOVING, RAISED_SHARE, SHADED, TILT_CONTACT
from device.photometry import DARK_FLOOR, IntensityImage, bin_bayer
from device.quick_look_table import SlopeTable
from device.surface import Float32Array, MaskArray
from hal.frame import RawFrame

_SIDES: Final = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")
_REST_PERCENTILE: Final = 10.0
_TOP_PERCENTILE: Final = 99.5
_UPPER_SHARE: Final = 0.4
"""A face is read where the skin stands higher than this share of its highest: beside it the skin falls to all sides."""


@dataclass(frozen=True, slots=True, eq=False)
class CoachModel:
    """What the coach knows of the instrument.

    divisor : float32 array of shape (h, w, 3), the resting skin at the coach's size
    slopes : the inverse map for pictures of that size; None before there is a calibration
    pitch_um : distance of neighbouring thin pixels on the skin, µm
    slab_um : thickness of the gel's slab, µm
    """

    divisor: Float32Array
    slopes: SlopeTable | None
    pitch_um: float
    slab_um: float

    @classmethod
    def prepare(cls, reference: RawFrame, slopes: SlopeTable | None, pitch_um: float, slab_um: float) -> CoachModel:
        """The model for live frames that a reference frame of the same size tells; `pitch_um` is the sensor's."""
        step = thinning(reference.shape)
        divisor = np.maximum(bin_bayer(reference, step).rgb, np.float32(DARK_FLOOR))
        resized = slopes.resized(reference.shape, step) if slopes else None
        return cls(np.ascontiguousarray(divisor), resized, pitch_um * step, slab_um)


class Coach:
    """Readings of a live stream; it remembers the frame before, and since when the contact is still.

    Parameters
    ----------
    model : None while there is no reference: then exposure and motion are all that can be told
    """

    def __init__(self, model: CoachModel | None) -> None:
        self._model = model
        self._divisor = model.divisor if model else None
        self._before: Float32Array | None = None
        self._still_since_ns: int | None = None

    def expect(self, levels: tuple[float, float, float]) -> None:
        """Take the lights' present levels, R, G, B over the reference's, for those of untouched skin."""
        if self._model:
            self._divisor = self._model.divisor * np.array(levels, np.float32)

    def motion(self, frame: ThinFrame) -> float | None:
        """How much a frame differs from the one that was looked at last, in intensity; None when there was none."""
        return None if self._before is None else change(self._before, self._smooth(frame))

    def look(self, frame: ThinFrame) -> CoachReading:
        """The reading of the next live frame."""
        began_s = time.thread_time()
        model = self._model
        smooth = self._smooth(frame)
        motion = None if self._before is None else change(self._before, smooth)
        self._before = smooth
        contact, depth_um, lean = (None, None, None) if model is None else _touched(smooth, model)
        share = None if contact is None else float(contact.mean())
        tilted = lean is not None and share is not None and share >= TILT_CONTACT
        exposure = float(np.percentile(frame.rgb, 99))
        reading = CoachReading(
            contact_share=share,
            tilt_deg=_lean_deg(lean) if tilted and lean else None,
            tilt_towards=_lean_side(lean) if tilted and lean else "",
            motion=motion,
            still_s=self._still_s(frame.at_ns, motion, share),
            clipped_share=frame.clipped_share,
            exposure=exposure,
            depth_um=depth_um,
            depth_share=None if depth_um is None or model is None else depth_um / (DEEPEST_SHARE * model.slab_um),
            in_air=share is not None and share < LEAST_CONTACT,
            advice="press",
            sentence="",
            cpu_ms=0.0,
        )
        return advise(reading, 1e3 * (time.thread_time() - began_s))

    def _smooth(self, frame: ThinFrame) -> Float32Array:
        return box_smoothed(frame.rgb if self._divisor is None else frame.rgb / self._divisor)

    def _still_s(self, at_ns: int, motion: float | None, share: float | None) -> float:
        if motion is None or motion > MOVING or share is None or share < LEAST_CONTACT:
            self._still_since_ns = None
            return 0.0
        if self._still_since_ns is None:
            self._still_since_ns = at_ns
        return (at_ns - self._still_since_ns) * 1e-9


def box_smoothed(values: Float32Array) -> Float32Array:
    """Mean over 3x3 pixels, borders repeated: float32 array of shape (h, w, 3)."""
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) * np.float32(1.0 / 9.0), np.float32)


def change(before: Float32Array, now: Float32Array) -> float:
    """How much the quickest-changing hundredth of the field changed, in intensity."""
    return float(np.percentile(np.abs(now - before).max(axis=-1), 99))


def _touched(smooth: Float32Array, model: CoachModel) -> tuple[MaskArray, float | None, tuple[float, float] | None]:
    """Where the skin is not at rest, how high it stands at most (µm), and its median slope: a face's, not its rim's."""
    shaded: MaskArray = np.asarray(np.abs(smooth - 1.0).max(axis=-1) > SHADED)
    if model.slopes is None:
        return shaded, None, None
    every = np.ones(shaded.shape, np.bool_)
    field = model.slopes.gradients(IntensityImage(smooth, every, ~every))
    p, q = field.p * field.valid, field.q * field.valid
    z_um = integrate_dct(p, q, model.pitch_um)
    rest_um, top_um = np.percentile(z_um, (_REST_PERCENTILE, _TOP_PERCENTILE))
    touched: MaskArray = shaded | (z_um - rest_um > RAISED_SHARE * model.slab_um)
    upper = z_um - rest_um > _UPPER_SHARE * (top_um - rest_um)
    return touched, float(top_um - rest_um), (float(np.median(p[upper])), float(np.median(q[upper])))


def _lean_deg(lean: tuple[float, float]) -> float:
    return float(np.degrees(np.arctan(np.hypot(*lean))))


def _lean_side(lean: tuple[float, float]) -> str:
    """The side that is pressed deeper: there the skin stands higher."""
    return _SIDES[round(np.arctan2(lean[1], lean[0]) / (np.pi / 4.0)) % 8]
