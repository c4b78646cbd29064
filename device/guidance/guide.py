"""The press guide: one reading per live frame, from intensities, the tabulated inverse map and a small integration."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.bundles.scan import VerdictLevel
from device.imaging.flat_field import DARK_FLOOR, SATURATED, NormalizedImage, bin_bayer
from device.imaging.frame_light import Levels
from device.imaging.frame_measures import SHADED
from device.inverse_map.tabulated import TabulatedInverseMap
from device.quality.press_faults import (
    MAX_DEPTH,
    MIN_CONTACT,
    MOVING,
    RAISED,
    STILL_S,
    TILT_CONTACT,
    FaultKind,
    PressFigures,
    press_faults,
)
from device.quality.verdict import border_levels, light_complaint
from device.surface import Float32Array, MaskArray, integrate_dct
from hal.frame import RawFrame

_SIDES: Final = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")
_BASE_PERCENTILE: Final = 10.0
_TOP_PERCENTILE: Final = 99.5
_UPPER_FRACTION: Final = 0.4
"""Tilt is read where the skin is higher than this fraction of its maximum: on the face, not on the flanks around it."""


@dataclass(frozen=True, slots=True, eq=False)
class GuideModel:
    """State of the instrument that the press guide reads.

    flat_field : float32 array of shape (h, w, 3), untouched skin at the small image's size
    slopes : the inverse map at that size; None without a calibration
    pitch_um : pixel pitch of the small image on the skin, µm
    slab_um : thickness of the gel's slab, µm
    lights : their names in R, G, B order
    """

    flat_field: Float32Array
    slopes: TabulatedInverseMap | None
    pitch_um: float
    slab_um: float
    lights: tuple[str, ...] = ("red", "green", "blue")

    @classmethod
    def prepare(
        cls,
        reference: RawFrame,
        slopes: TabulatedInverseMap | None,
        pitch_um: float,
        slab_um: float,
        lights: tuple[str, ...] = ("red", "green", "blue"),
    ) -> GuideModel:
        """Return the model for live frames of the reference frame's size; `pitch_um` is the sensor's."""
        step = downsample_step(reference.shape)
        flat_field = np.maximum(bin_bayer(reference, step).rgb, np.float32(DARK_FLOOR))
        resized = slopes.resized(reference.shape, step) if slopes else None
        return cls(np.ascontiguousarray(flat_field), resized, pitch_um * step, slab_um, lights)


class PressGuide:
    """Reads a live stream; keeps the previous frame and the time since which the contact is still.

    Parameters
    ----------
    model : None without a reference: then only exposure and motion are measured
    """

    def __init__(self, model: GuideModel | None) -> None:
        self._model = model
        self._flat_field = model.flat_field if model else None
        self._previous: Float32Array | None = None
        self._still_since_ns: int | None = None
        self._drift: tuple[VerdictLevel, str] | None = None

    def set_light_levels(self, levels: Levels, drift: tuple[VerdictLevel, str] | None = None) -> None:
        """Correct for untouched skin's levels in R, G, B relative to the reference; `drift` says which light is off."""
        self._drift = drift
        if self._model:
            self._flat_field = self._model.flat_field * np.array(levels, np.float32)

    def motion(self, frame: ReducedFrame) -> float | None:
        """Change in intensity since the last frame read; None before the first."""
        return None if self._previous is None else change(self._previous, self._smooth(frame))

    def read(self, frame: ReducedFrame) -> GuideReading:
        """Return the reading of the next live frame."""
        began_s = time.thread_time()
        model = self._model
        smooth = self._smooth(frame)
        motion = None if self._previous is None else change(self._previous, smooth)
        self._previous = smooth
        press = PressMeasure() if model is None else measure_press(smooth, model)
        border = light_complaint(press.border, model.lights, {}) if model else None
        figures = PressFigures(
            exposure=float(np.percentile(frame.rgb, 99)),
            clipped_fraction=frame.clipped_fraction,
            lights=border or self._drift,
            contact_fraction=press.contact_fraction,
            depth_fraction=press.depth_fraction,
            tilt_deg=press.tilt_deg,
            tilt_towards=press.tilt_towards,
        )
        still_s = self._still_s(frame.at_ns, motion, press.contact_fraction)
        advice, sentence = advise(figures, still_s)
        in_air = press.contact_fraction is not None and press.contact_fraction < MIN_CONTACT
        if not figures.light_is_right:
            press = PressMeasure()
        return GuideReading(
            contact_fraction=press.contact_fraction,
            tilt_deg=press.tilt_deg,
            tilt_towards=press.tilt_towards,
            motion=motion,
            still_s=still_s,
            clipped_fraction=frame.clipped_fraction,
            exposure=figures.exposure,
            depth_um=press.depth_um,
            depth_fraction=None if press.depth_fraction is None else press.depth_fraction / MAX_DEPTH,
            in_air=in_air,
            advice=advice,
            sentence=sentence,
            cpu_ms=1e3 * (time.thread_time() - began_s),
        )

    def _smooth(self, frame: ReducedFrame) -> Float32Array:
        return box_smoothed(frame.rgb if self._flat_field is None else frame.rgb / self._flat_field)

    def _still_s(self, at_ns: int, motion: float | None, fraction: float | None) -> float:
        if motion is None or motion > MOVING or fraction is None or fraction < MIN_CONTACT:
            self._still_since_ns = None
            return 0.0
        if self._still_since_ns is None:
            self._still_since_ns = at_ns
        return (at_ns - self._still_since_ns) * 1e-9


def box_smoothed(values: Float32Array) -> Float32Array:
    """Return the mean over 3x3 pixels with borders repeated: float32 array of shape (h, w, 3)."""
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) * np.float32(1.0 / 9.0), np.float32)


def change(before: Float32Array, now: Float32Array) -> float:
    """Change in intensity, 99th percentile over the field."""
    return float(np.percentile(np.abs(now - before).max(axis=-1), 99))


@dataclass(frozen=True, slots=True)
class PressMeasure:
    """A press as the guide measures it; None means not measurable.

    contact_fraction : fraction of the field where the skin is shaded or raised
    depth_um, depth_fraction : how far the skin is raised, and the same as a fraction of the slab's thickness
    tilt_deg, tilt_towards : tilt of the contact plane, and the side that is pressed deeper
    border : median intensity along the border in R, G and B
    """

    contact_fraction: float | None = None
    depth_um: float | None = None
    depth_fraction: float | None = None
    tilt_deg: float | None = None
    tilt_towards: str = ""
    border: Levels | None = None


def measure_frame(frame: RawFrame, model: GuideModel, levels: Levels) -> PressMeasure:
    """Return the press in a raw frame, under these levels of untouched skin in R, G and B."""
    flat_field = model.flat_field * np.array(levels, np.float32)
    return measure_press(box_smoothed(downsample_bayer(frame).rgb / flat_field), model)


def measure_press(smooth: Float32Array, model: GuideModel) -> PressMeasure:
    """Return the press in a small intensity image, float32 array of shape (h, w, 3)."""
    shaded: MaskArray = np.asarray(np.abs(smooth - 1.0).max(axis=-1) > SHADED)
    every = np.ones(shaded.shape, np.bool_)
    image = NormalizedImage(smooth, every, ~every)
    border = border_levels(image)
    if model.slopes is None:
        return PressMeasure(float(shaded.mean()), border=border)
    field = model.slopes.gradients(image)
    p, q = field.p * field.valid, field.q * field.valid
    z_um = integrate_dct(p, q, model.pitch_um)
    base_um, top_um = (float(value) for value in np.percentile(z_um, (_BASE_PERCENTILE, _TOP_PERCENTILE)))
    contact = float((shaded | (z_um - base_um > RAISED * model.slab_um)).mean())
    depth_um = min(top_um - base_um, model.slab_um)  # skin cannot rise by more than the slab's thickness
    measured = PressMeasure(contact, depth_um, depth_um / model.slab_um, border=border)
    if contact < TILT_CONTACT:
        return measured
    upper = z_um - base_um > _UPPER_FRACTION * depth_um
    lean = float(np.median(p[upper])), float(np.median(q[upper]))
    return replace(measured, tilt_deg=_lean_deg(lean), tilt_towards=_lean_side(lean))


def _lean_deg(lean: tuple[float, float]) -> float:
    return float(np.degrees(np.arctan(np.hypot(*lean))))


def _lean_side(lean: tuple[float, float]) -> str:
    """Return the side that is pressed deeper, where the skin is higher."""
    return _SIDES[round(np.arctan2(lean[1], lean[0]) / (np.pi / 4.0)) % 8]


# The press guide's reading of a live frame, and the one advice that follows from it.

Advice = FaultKind | Literal["calibrate", "hold still", "ready"]


@dataclass(frozen=True, slots=True)
class GuideReading:
    """Figures of one live frame; None means not measurable now, never 0.

    contact_fraction : fraction of the field where the skin is shaded or raised
    tilt_deg, tilt_towards : tilt of the contact plane, and the side that is pressed deeper
    motion : change since the previous frame, in intensity
    still_s : how long the contact has not moved
    clipped_fraction : fraction of saturated pixels
    exposure : 99th percentile of the frame, fraction of full scale
    depth_um, depth_fraction : how far the skin is raised, and the same as a fraction of the slab's maximum
    in_air : nothing touches the skin
    advice : what to do, as one word for programs
    sentence : the same for people
    cpu_ms : CPU time of this reading
    """

    contact_fraction: float | None
    tilt_deg: float | None
    tilt_towards: str
    motion: float | None
    still_s: float
    clipped_fraction: float
    exposure: float
    depth_um: float | None
    depth_fraction: float | None
    in_air: bool
    advice: Advice
    sentence: str
    cpu_ms: float


def advise(figures: PressFigures, still_s: float) -> tuple[Advice, str]:
    """Return advice on a live frame: one word for programs, one sentence for people.

    The word is never "ready" for a press that the verdict would find at fault for the same figures.
    """
    fault = next(press_faults(figures), None)
    if fault:
        return fault.kind, _sentence(fault.cue or fault.sentence)
    if figures.contact_fraction is None:
        return "calibrate", "No reference yet: calibrate first, then contact is shown."
    if still_s < STILL_S:
        return "hold still", "Hold still."
    return "ready", "Ready: push the button."


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


# Raw frames downsampled to small colour images: one Bayer quad per block, cheap enough for every live frame.
#
# Why not the camera's own low-resolution stream: its grey values have been through the image pipeline and no longer
# measure light, and slope and depth need colour. Picking quads costs a fraction of a millisecond.

MAX_COLUMNS: Final = 160


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """A small image of the live stream.

    rgb : float32 array of shape (h, w, 3), linear light as a fraction of full scale
    clipped_fraction : fraction of pixels with a saturated channel
    at_ns : start of the exposure, monotonic ns
    """

    rgb: Float32Array
    clipped_fraction: float
    at_ns: int

    def picture(self) -> np.ndarray:
        """Return the image for a screen: uint8 array of shape (h, w, 3), R, G, B, with gamma applied."""
        return np.asarray(255.0 * np.sqrt(np.clip(self.rgb, 0.0, 1.0)) + 0.5, np.uint8)


def downsample_step(shape: tuple[int, int]) -> int:
    """Return the smallest even step at which the small image has at most `MAX_COLUMNS` columns.

    A step counts sensor pixels per pixel of the small image.
    """
    step = 2
    while shape[1] // step > MAX_COLUMNS:
        step += 2
    return step


def downsample_bayer(frame: RawFrame) -> ReducedFrame:
    """Return the small image of a raw frame, from the middle quad of every block."""
    step = downsample_step(frame.shape)
    rows, columns = (size // step * step for size in frame.shape)
    first = step // 2 // 2 * 2
    scale = np.float32(1.0 / (frame.white_level_dn - frame.black_level_dn))
    sites = [
        frame.mosaic[first + i // 2 : rows : step, first + i % 2 : columns : step].astype(np.float32) for i in range(4)
    ]
    colours = [[site for site, letter in zip(sites, frame.bayer_order, strict=True) if letter == c] for c in "RGB"]
    rgb = np.empty((*sites[0].shape, 3), np.float32)
    brightest = sites[0]
    for channel, same in enumerate(colours):
        rgb[..., channel] = same[0] if len(same) == 1 else np.float32(0.5) * (same[0] + same[1])
        for site in same:
            brightest = np.maximum(brightest, site)
    rgb -= np.float32(frame.black_level_dn)
    rgb *= scale
    limit = frame.black_level_dn + SATURATED / float(scale)
    return ReducedFrame(rgb, float((brightest >= limit).mean()), frame.sensor_timestamp_ns)
