"""From a frame to slopes per pixel: intensity, checks, noise, the calibration's method, and lights that are hidden.

A light-by-light sequence holds what each light alone shows, without ambient light. With all lights on, a channel also
shows what the other lights put into it. Under its own light alone it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from device.balls.sphere import Viewpoint
from device.errors import CalibrationMismatch, FrameError, RecordError
from device.imaging.flat_field import DARK_FLOOR, LinearFrame, NormalizedImage, bin_bayer, flat_field_correct
from device.imaging.frame_light import without_ambient
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface import Float32Array, GradientField, HeightMap, MaskArray
from hal.frame import RawFrame
from host_sync.frame_checks.colour_check import check_frame
from host_sync.gradients.confidence import even_confidence, out_of_domain_blocks
from host_sync.gradients.flat_field_kernel import check_exposure, raw_intensity, take_out_light
from host_sync.gradients.inverse_map_kernel import SlopeKernel
from host_sync.johnson2009.model import estimate_gradients
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import BackgroundCall, parallel_rows
from host_sync.light.reading import CellCorrection, correct_slopes
from host_sync.light_groups import CHANNELS, in_group, joined
from host_sync.results.record import FrameCheck, refusals

if TYPE_CHECKING:
    from device.bundles.scan import ScanBundle
    from host_sync.calibration.calibrate import Calibration, Method


LIT: Final = 0.5
"""Intensity over the reference from which a light arrives."""

MIN_OWN: Final = 0.1
"""Less of its own light no channel shows."""

SEQUENCE_STEP: Final = 4
"""Step of the pixels that show how much of a channel's light is its own."""


@dataclass(frozen=True, slots=True, eq=False)
class LightSequence:
    """Single lights' frames.

    lights : the light that each channel shows most of, in the order R, G, B
    alone : float32 array of shape (H/2, W/2, 3), each channel under its own light alone, fractions of full scale
    """

    lights: tuple[str, ...]
    alone: Float32Array

    def over_untouched(self, intensity: NormalizedImage, flat_field: Float32Array) -> Float32Array:
        """Return what each light alone shows over what it shows of untouched skin: float32 array of shape (H, W, 3).

        intensity : of the frame under all lights, over its reference
        flat_field : the reference's light, shape (H, W, 3)

        Where a light arrives, its frame and that of all lights differ by the share of the other lights in its channel.
        """
        size = (flat_field.shape[1], flat_field.shape[0])
        found = np.empty(flat_field.shape, np.float32)
        for channel in range(CHANNELS):
            here = cv2.resize(np.ascontiguousarray(self.alone[..., channel]), size, interpolation=cv2.INTER_LINEAR)
            over = here / np.maximum(flat_field[..., channel], DARK_FLOOR)
            all_lights = intensity.values[::SEQUENCE_STEP, ::SEQUENCE_STEP, channel]
            lit = intensity.valid[::SEQUENCE_STEP, ::SEQUENCE_STEP] & (all_lights > LIT)
            own = float(np.median(over[::SEQUENCE_STEP, ::SEQUENCE_STEP][lit] / all_lights[lit])) if lit.any() else 1.0
            found[..., channel] = over / np.float32(max(own, MIN_OWN))
        return found


def read_light_sequence(scan: ScanBundle) -> LightSequence | str:
    """Return the sequence of a scan, or a sentence that says why it cannot be used; empty if none was taken."""
    exposures = scan.record.exposures
    if exposures.alone_moved:
        return "the object moved while each light was alone, so that those frames were left out"
    if not exposures.alone_files:
        return ""
    if len(exposures.alone_files) != CHANNELS:
        return f"{len(exposures.alone_files)} lights were taken alone, and {CHANNELS} are needed"
    try:
        dark = scan.dark_frame()
        if dark is None:
            return "each light was taken alone, but no frame under no light"
        seen = {
            light: bin_bayer(without_ambient(scan.named_frame(name), dark)).rgb
            for light, name in exposures.alone_files.items()
        }
    except (RecordError, FrameError) as error:
        return f"the frames of single lights cannot be read: {error}"
    own = {int(np.argmax(rgb.mean(axis=(0, 1)))): light for light, rgb in seen.items()}
    if len(own) != CHANNELS:
        return "two lights alone show most in the same channel"
    lights = tuple(own[channel] for channel in range(CHANNELS))
    alone = np.stack([seen[light][..., channel] for channel, light in enumerate(lights)], axis=-1)
    return LightSequence(lights, alone)


@dataclass(frozen=True, slots=True, eq=False)
class UncorrectedResults:
    """Results on a frame that do not depend on its correction, and are computed beside it.

    raw : slopes of the frame with its noise, as of `uncorrected`; None where nothing was shrunk
    out_of_domain : as `out_of_domain_blocks` returns it; None of groups of lights after the first, whose blocks count
        for all
    """

    raw: GradientField | None
    out_of_domain: MaskArray | None

    @classmethod
    def of(
        cls,
        raw: NormalizedImage,
        intensity: NormalizedImage,
        calibration: Calibration,
        method: Method,
        is_first: bool,
    ) -> UncorrectedResults:
        """Return the results of a frame as seen and with its noise shrunk, the same where none was.

        is_first : whether these are the first three lights
        """
        found = None if intensity is raw else uncorrected(raw, calibration, method, intensity)
        return cls(found, out_of_domain_blocks(intensity, calibration.inverse.map) if is_first else None)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelReading:
    """Slopes from three channels of a frame.

    raw, intensity : as seen, and with its noise shrunk where the calibration can separate noise from detail
    gradients : slopes of `intensity`, corrected
    correction : what the light model changes in slopes of both, at the middles of cells; None by the paper's method and
        where held-out balls do not confirm the model
    uncorrected_results : found while the correction was looked for
    rest : where the light is that of skin at rest; None without a reference
    """

    calibration: Calibration
    raw: NormalizedImage
    intensity: NormalizedImage
    checks: tuple[FrameCheck, ...]
    gradients: GradientField
    correction: CellCorrection | None
    uncorrected_results: BackgroundCall[UncorrectedResults]
    rest: RestEvidence | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SlopeReading:
    """Slopes from all lights of a frame.

    groups : by group of lights; one where there are three lights
    left_out : for each group, where one of its lights is hidden or mirrored
    warnings : what speaks against the frame
    """

    method: Method
    groups: tuple[ChannelReading, ...]
    left_out: tuple[MaskArray, ...]
    warnings: list[str]

    @property
    def first(self) -> ChannelReading:
        """The first group's; its calibration's uncertainties are taken for all."""
        return self.groups[0]

    @property
    def gradients(self) -> GradientField:
        """Slopes of all groups together."""
        return joined([group.gradients for group in self.groups], self.left_out)

    @property
    def rest(self) -> tuple[RestEvidence, ...]:
        """Evidence of skin at rest of every group; empty where one has none, or the light shows that none rests."""
        found = tuple(group.rest for group in self.groups if group.rest is not None)
        return found if self.has_rest and len(found) == len(self.groups) else ()

    @property
    def has_rest(self) -> bool:
        """True if some skin may be untouched; False where the light shows that none is."""
        return all(group.correction is None or group.correction.has_rest for group in self.groups)

    def raw_gradients(self) -> GradientField:
        """Return slopes of all groups together with the frame's noise in them, less what null colours know of it.

        To be asked for once: corrections are added in place. Where nothing was shrunk they are `gradients`.
        """
        found = []
        for group in self.groups:
            gradients = group.uncorrected_results.result().raw
            if gradients is None:
                found.append(group.gradients)
                continue
            if group.correction is not None:
                group.correction.apply(gradients)
            found.append(gradients)
        return joined(found, self.left_out)


def read_slopes(
    frame: LinearFrame | RawFrame,
    calibration: Calibration,
    name: str,
    method: Method,
    *,
    force: bool,
    sequence: LightSequence | None = None,
) -> SlopeReading:
    """Return slopes of a frame with as many lights as its calibration; errors as for `reconstruct`.

    sequence : of the same press with three lights
    """
    lights = calibration.lights
    count = CHANNELS if isinstance(frame, RawFrame) else frame.rgb.shape[2]
    if count != (CHANNELS if lights is None else lights.count):
        wanted = CHANNELS if lights is None else lights.count
        raise CalibrationMismatch(
            f"{name} shows {count} light{'s' * (count > 1)} and its calibration {wanted}: use a calibration of these"
        )
    if lights is None or isinstance(frame, RawFrame):
        reading, warnings = _read_channels(frame, calibration, name, method, force=force, sequence=sequence)
        return SlopeReading(method, (reading,), (), warnings)
    warnings = lights.check(frame, name)
    raise_on_warnings(warnings, name, force=force)
    groups: list[ChannelReading] = []
    for group, own in zip(lights.groups, (calibration, *calibration.beside), strict=True):
        reading, against = _read_channels(in_group(frame, group), own, name, method, force=force, is_first=not groups)
        groups.append(reading)
        warnings += [warning for warning in against if warning not in warnings]
    return SlopeReading(method, tuple(groups), tuple(lights.left_out(frame)), warnings)


def _read_channels(
    frame: LinearFrame | RawFrame,
    calibration: Calibration,
    name: str,
    method: Method,
    *,
    force: bool,
    sequence: LightSequence | None = None,
    is_first: bool = True,
) -> tuple[ChannelReading, list[str]]:
    """Return the slopes that three channels show, the first ones or others, and what speaks against them."""
    if isinstance(frame, RawFrame):
        intensity = raw_intensity(frame, calibration.flat_field)
    else:
        intensity = flat_field_correct(frame, calibration.flat_field)
    check_exposure(intensity, calibration.flat_field, name)
    checks = calibration.frame_model.check(intensity, calibration.flat_field)
    raw, shrinkage = intensity, calibration.shrinkage
    rest = None if calibration.skin_at_rest is None else calibration.skin_at_rest.evidence(raw)
    if rest is not None and rest.has_rest:
        checks = (*checks, *calibration.frame_model.levels.check_light(rest.light))
        take_out_light(rest.light, raw.values, calibration.flat_field)
    if shrinkage is not None:
        intensity = shrinkage.shrunk(raw)
    warnings = refusals(checks)
    raise_on_warnings(warnings, name, force=force)
    colours = BackgroundCall(check_frame, intensity, calibration.flat_field, calibration.inverse.map)
    if not warnings:
        colours.start()
    gradients = uncorrected(intensity, calibration, method)
    if not warnings:
        warnings = colours.result()
        raise_on_warnings(warnings, name, force=force)
    uncorrected_results = BackgroundCall(UncorrectedResults.of, raw, intensity, calibration, method, is_first)
    uncorrected_results.start()
    alone = None if sequence is None else sequence.over_untouched(intensity, calibration.flat_field)
    correction = None
    if method == "direct" and calibration.light.confirmed:
        correction = correct_slopes(
            gradients, intensity, calibration.light, calibration.prior_sigma, calibration.elevation, alone, rest
        )
        correction.apply(gradients)
    return ChannelReading(
        calibration, raw, intensity, checks, gradients, correction, uncorrected_results, rest
    ), warnings


def raise_on_warnings(warnings: Sequence[str], name: str, *, force: bool) -> None:
    """Refuse a frame that something speaks against, unless it is forced.

    Raises
    ------
    CalibrationMismatch
        Says what speaks against it.
    """
    if warnings and not force:
        raise CalibrationMismatch(
            f"{name} was not made as its calibration was: {'; '.join(warnings)}. Use a calibration of these lights and "
            "this gel, or force to reconstruct it all the same (--force; force=True in Python)"
        )


def uncorrected(
    intensity: NormalizedImage,
    calibration: Calibration,
    method: Method,
    shrunk: NormalizedImage | None = None,
    kernel: SlopeKernel | None = None,
) -> GradientField:
    """Return slopes per pixel by the method, as if all skin stood where untouched skin does.

    shrunk : the intensity with its noise shrunk, by which the inverse map's bias from noise is removed
    kernel : the compiled inverse map of the calibration; None to make it
    """
    if method == "paper":
        return estimate_gradients(calibration.paper_model, intensity)
    kernel = kernel or SlopeKernel(calibration.inverse.map, null_colour=calibration.null_colour)
    gradients = kernel.evaluate(intensity, shrunk)
    even_confidence(gradients, intensity.clipped)
    return gradients


# Heights on the grid of pixels that a camera nearby sees, from slopes of the skin itself.
#
# A camera at the height h sees skin of slope (p, q) and elevation z, over the place (x, y) from the middle, at
# (x, y) / (1 - z / h). On its pixels heights rise by (p, q) (1 - z / h) / (1 + (x p + y q) / h). Integrated without the
# first factor they are -h log(1 - z / h), so that neither needs to be known beforehand.

MIN_FACING: Final = 0.2
"""Skin that faces the camera less than this share of what level skin does is taken to face it so much: at 0 it would
be seen edge on, and no height map holds what lies behind."""


def seen_slopes(
    gradients: GradientField, viewpoint: Viewpoint, height: HeightMap | None = None, out: GradientField | None = None
) -> GradientField:
    """Return the rise of heights per pixel as the camera sees skin with these slopes.

    Without heights the factor of elevation is left out.

    height : over untouched skin, arrays of shape (H, W); where it is not known skin counts as untouched
    out : receives p and q; may be `gradients`
    """
    p, q = (np.empty_like(gradients.p), np.empty_like(gradients.q)) if out is None else (out.p, out.q)
    z_um = np.empty((0, 0), np.float32) if height is None else height.z_um
    pitch_um = np.float32(1.0 if height is None else height.pitch_um)
    place = np.array([viewpoint.column, viewpoint.row, 1.0 / viewpoint.height_px], np.float32)
    parallel_rows(_write_seen, p.shape, gradients.p, gradients.q, z_um, pitch_um, place, p, q)
    return replace(gradients, p=p, q=q)


def seen_elevation(height: HeightMap, viewpoint: Viewpoint, out: Float32Array | None = None) -> HeightMap:
    """Return heights over untouched skin, from those that slopes without the factor of elevation add up to.

    out : receives the heights; may be those given
    """
    z_um = np.empty_like(height.z_um) if out is None else out
    nearness = np.float32(1.0 / (viewpoint.height_px * height.pitch_um))
    parallel_rows(_write_elevation, z_um.shape, height.z_um, nearness, z_um)
    return HeightMap(z_um, height.pitch_um)


@njit(cache=True, nogil=True)
def _write_seen(
    p: Any, q: Any, z: Any, pitch: Any, place: Any, seen_p: Any, seen_q: Any, first: int, last: int
) -> None:
    column, row, nearness = place
    one, least = np.float32(1.0), np.float32(MIN_FACING)
    for r in range(first, last):
        y = (np.float32(r) - row) * nearness
        for c in range(p.shape[1]):
            x = (np.float32(c) - column) * nearness
            share = one / max(one + x * p[r, c] + y * q[r, c], least)
            if z.size:
                elevation = z[r, c] / pitch
                share *= one - (elevation if elevation == elevation else np.float32(0.0)) * nearness
            seen_p[r, c] = share * p[r, c]
            seen_q[r, c] = share * q[r, c]


@njit(cache=True, nogil=True)
def _write_elevation(z: Any, nearness: Any, out: Any, first: int, last: int) -> None:
    for r in range(first, last):
        for c in range(z.shape[1]):
            out[r, c] = -np.expm1(-z[r, c] * nearness) / nearness
