"""Heights of successive frames under one calibration, with working arrays kept for the whole sequence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from device.imaging.flat_field import NormalizedImage, flat_field_correct
from device.imaging.frame_measures import shaded_fraction
from device.surface.fields import Float32Array, GradientField, MaskArray, full_rectangle
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.errors import SequenceError
from host_sync.frame_checks.colour_check import SAMPLES_ALONG, check_datum, check_frame
from host_sync.frames.frame_set_file import Encoding
from host_sync.frames.linear_light import frame_of_values, light_of_values
from host_sync.frames.sequence import StoredFrame
from host_sync.gradients.even_confidence import even_confidence
from host_sync.gradients.flat_field_kernel import empty_intensity, raw_intensity, stored_intensity
from host_sync.gradients.intensity_checks import check_exposure
from host_sync.gradients.inverse_map_kernel import SlopeKernel, empty_gradients
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.kernels.planes import in_planes
from host_sync.reconstruction.elevation_correction import correct_elevation
from host_sync.reconstruction.perspective import seen_elevation, seen_slopes
from host_sync.reconstruction.slope_reading import estimate, raise_on_warnings
from host_sync.results.record import refusals

CHECK_STRIDE_FACTOR: Final = 4
"""Checks of video frames sample this many times more coarsely than those of a single frame."""

CHECKED_EVERY: Final = 30
"""Pattern, layout and levels are checked of every so many frames: they come from one camera."""

SAMPLED_COLUMNS: Final = 180
"""Number of columns sampled for the contact fraction; rows are sampled at the same distance."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Statistics of one height map; None where nothing was measured.

    contact_fraction : fraction of the field where intensity shows that the skin is not flat
    clipped_fraction : fraction of pixels with a saturated channel
    masked_fraction : fraction of pixels without a height
    peak_um : largest height above untouched skin, µm
    """

    contact_fraction: float
    clipped_fraction: float
    masked_fraction: float
    peak_um: float | None


class FrameSolver:
    """Reconstructs frames of one size.

    Parameters
    ----------
    calibration : of every frame
    method : how slopes are estimated
    encoding : how stored values encode light; not needed for raw frames
    full_scale, pixel_shape : of stored frames, as of `FrameSpec`
    force : also solve frames that the calibration cannot explain
    weighted : False gives every pixel the same weight and fills holes with flat skin: faster, less accurate
    """

    def __init__(
        self,
        calibration: Calibration,
        method: Method,
        encoding: Encoding | None,
        *,
        full_scale: int | None = None,
        pixel_shape: float = 1.0,
        weighted: bool = True,
        force: bool = False,
    ) -> None:
        if calibration.lights is not None:
            raise SequenceError(
                f"the calibration is of {calibration.lights.count} lights: a movie shows three channels"
            )
        self._calibration = calibration
        self.method: Method = method
        self.encoding = encoding
        self._full_scale, self._pixel_shape = full_scale, pixel_shape
        self.force = force
        self._light: dict[np.dtype[Any], Float32Array] = {}
        rows, columns, _ = calibration.flat_field.shape
        self.shape = (rows, columns)
        self._flat_field = in_planes(calibration.flat_field)
        self._intensity = empty_intensity(self.shape)
        self._slopes = SlopeKernel(calibration.inverse.map, empty_gradients(self.shape)) if method == "direct" else None
        self._integrator = Integrator(self.shape)
        self._begun = 0
        self.weighted = weighted
        # A full array, not a broadcast scalar: the search for untouched skin reads every pixel.
        self._all_valid = np.ones((0, 0) if weighted else self.shape, np.bool_)

    def clone(self) -> FrameSolver:
        """A solver of the same frames with its own working arrays, for another thread."""
        return FrameSolver(
            self._calibration,
            self.method,
            self.encoding,
            full_scale=self._full_scale,
            pixel_shape=self._pixel_shape,
            weighted=self.weighted,
            force=self.force,
        )

    def solve(self, frame: StoredFrame, out: Float32Array) -> FrameStatistics:
        """Write a frame's heights (µm, zero at untouched skin, NaN where invalid) to `out`; returns its statistics.

        out : float32 array of shape (H, W)

        Raises
        ------
        CalibrationMismatch, FrameError
            The frame has another size or channel order, or is black or saturated.
        IntegrationError
            It holds nothing that can be integrated.
        SequenceError
            The encoding of its values is unknown.
        """
        intensity = self._read(frame)
        check_exposure(intensity, self._flat_field, frame.name, CHECK_STRIDE_FACTOR)
        raise_on_warnings(self._frame_warnings(intensity), frame.name, force=self.force)
        gradients = self._gradients(intensity)
        height, _ = self._integrator.integrate(gradients, self._calibration.pitch_um, out=out)
        datum = find_datum(height, gradients)
        unlit = [] if datum.is_relative else check_datum(intensity, datum.skin)
        raise_on_warnings(unlit, frame.name, force=self.force)
        peak_um, known = _shift_to_zero(height.z_um, np.float32(datum.zero_um), out)
        if self._calibration.viewpoint is not None:
            seen = seen_elevation(replace(height, z_um=out), self._calibration.viewpoint, out)
            peak_um = np.nanmax(seen.z_um) if known else peak_um
        return FrameStatistics(
            contact_fraction=shaded_fraction(_subsample(intensity)),
            clipped_fraction=float(np.count_nonzero(intensity.clipped) / intensity.clipped.size),
            masked_fraction=float(1.0 - known / out.size),
            peak_um=float(peak_um) if known else None,
        )

    def _frame_warnings(self, intensity: NormalizedImage) -> list[str]:
        model, first = self._calibration.frame_model, self._begun % CHECKED_EVERY == 0
        self._begun += 1
        refused = refusals(model.check(intensity, self._flat_field)) if first else []
        return refused or check_frame(
            intensity, self._flat_field, self._calibration.inverse.map, SAMPLES_ALONG // CHECK_STRIDE_FACTOR
        )

    def _read(self, frame: StoredFrame) -> NormalizedImage:
        if isinstance(frame.pixels, RawFrame):
            return raw_intensity(frame.pixels, self._flat_field, self._intensity)
        if self.encoding is None:
            raise SequenceError(f"{frame.name}: values may be linear light or sRGB: choose with --encoding")
        if self._pixel_shape != 1.0:
            whole = frame_of_values(frame.pixels, self.encoding, self._full_scale, self._pixel_shape)
            return flat_field_correct(whole, self._calibration.flat_field)
        dtype = frame.pixels.dtype
        if dtype not in self._light:
            self._light[dtype] = light_of_values(dtype, self.encoding, self._full_scale)
        return stored_intensity(frame.pixels, self._light[dtype], self._flat_field, self._intensity)

    def _gradients(self, intensity: NormalizedImage) -> GradientField:
        if self._slopes is not None:
            found = self._slopes.evaluate(intensity)
            if self.weighted:
                even_confidence(found, intensity.clipped)
            if self._calibration.elevation is not None:
                correct_elevation(found, self._calibration.elevation)
        else:
            found = estimate(intensity, self._calibration, self.method)
        if self._calibration.viewpoint is not None:
            found = seen_slopes(found, self._calibration.viewpoint, out=found)
        if self.weighted:
            return found
        parallel_rows(_zero_invalid, self.shape, found.p, found.q, found.valid)
        return replace(full_rectangle(found.p, found.q), valid=self._all_valid)


def _subsample(image: NormalizedImage) -> NormalizedImage:
    step = max(1, image.shape[1] // SAMPLED_COLUMNS)
    every = (slice(None, None, step), slice(None, None, step))
    return NormalizedImage(np.ascontiguousarray(image.values[every]), image.valid[every], image.clipped[every])


@njit(cache=True, nogil=True)
def _zero_invalid(p: Float32Array, q: Float32Array, valid: MaskArray, first: int, last: int) -> None:
    """Set slopes of invalid pixels to zero."""
    for r in range(first, last):
        for c in range(valid.shape[1]):
            if not valid[r, c]:
                p[r, c] = np.float32(0.0)
                q[r, c] = np.float32(0.0)


def _shift_to_zero(z_um: Float32Array, zero_um: Any, out: Float32Array) -> tuple[Any, int]:
    """Write heights minus `zero_um`, possibly in place; returns the largest and the number of finite ones."""
    highest, known = np.empty(len(out), np.float32), np.empty(len(out), np.int64)
    parallel_rows(_shift_rows, out.shape, z_um, zero_um, out, highest, known)
    return highest.max(), int(known.sum())


@njit(cache=True, nogil=True)
def _shift_rows(z_um: Any, zero_um: Any, out: Any, highest: Any, known: Any, first: int, last: int) -> None:
    for r in range(first, last):
        highest[r], known[r] = _shift_row(z_um[r], zero_um, out[r])


@njit(cache=True)
def _shift_row(z_um: Any, zero_um: Any, out: Any) -> tuple[Any, int]:
    highest, known = np.float32(-np.inf), 0
    for c in range(out.size):
        z = z_um[c] - zero_um
        out[c] = z
        known += np.isfinite(z)
        highest = z if z > highest else highest
    return highest, known
