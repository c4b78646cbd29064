"""Heights of one frame after the other under one calibration, with work arrays that live as long as the sequence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numba import njit

from device.photometry import IntensityImage
from device.surface import Float32Array, GradientField, MaskArray, full_rectangle
from device.verdict import shaded_share
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration, Method
from host_sync.errors import SequenceError
from host_sync.frame_reading import light_of_values
from host_sync.frame_sequence import StoredFrame
from host_sync.frame_set_file import Encoding
from host_sync.reconstruction.colour_planes import in_planes
from host_sync.reconstruction.intensity_checks import check_intensity
from host_sync.reconstruction.intensity_kernel import empty_intensity, raw_intensity, stored_intensity
from host_sync.reconstruction.multigrid import Integrator
from host_sync.reconstruction.pipeline import estimate, refuse_doubtful
from host_sync.reconstruction.plausibility import SAMPLES_ALONG, frame_doubts, rest_doubts
from host_sync.reconstruction.rest_level import height_of_rest_um, untouched_skin
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.slope_kernel import SlopeKernel, empty_gradients

CHECK_COARSENESS: Final = 4
"""Before it is solved, a frame of a sequence is looked at with so many times fewer rows and columns than one alone."""

SAMPLED_COLUMNS: Final = 180
"""So many columns, and rows as far apart, tell how much of the field is pressed."""


@dataclass(frozen=True, slots=True)
class FrameFigures:
    """What one frame's height map shows; None where nothing was measured.

    contact_share : share of the field whose intensity says that the skin is not flat
    clipped_share : share of pixels with a saturated channel
    masked_share : share of pixels without a height
    peak_um : largest height above untouched skin, µm
    """

    contact_share: float
    clipped_share: float
    masked_share: float
    peak_um: float | None


class FrameSolver:
    """Turns frames of one size into height maps.

    Parameters
    ----------
    calibration : of every frame
    method : how slopes are estimated
    encoding : how stored values encode light; raw frames do not need it
    force : solve frames too that the calibration cannot explain
    weighted : False lets every pixel count alike and fills holes with flat skin: a faster kernel, less faithful
    """

    def __init__(
        self,
        calibration: Calibration,
        method: Method,
        encoding: Encoding | None,
        *,
        weighted: bool = True,
        force: bool = False,
    ) -> None:
        self._calibration = calibration
        self._method: Method = method
        self._encoding = encoding
        self._force = force
        self._light: dict[np.dtype[Any], Float32Array] = {}
        rows, columns, _ = calibration.divisor.shape
        self.shape = (rows, columns)
        self._divisor = in_planes(calibration.divisor)
        self._intensity = empty_intensity(self.shape)
        self._slopes = SlopeKernel(calibration.inverse.map, empty_gradients(self.shape)) if method == "direct" else None
        self._integrator = Integrator(self.shape)
        self._weighted = weighted
        # Written out, unlike that of a full rectangle: whoever looks for untouched skin reads every pixel's.
        self._everywhere = np.ones((0, 0) if weighted else self.shape, np.bool_)

    @property
    def facts(self) -> dict[str, Any]:
        """How frames are solved, for a record."""
        return {
            "method": self._method,
            "encoding": self._encoding,
            "weighted": self._weighted,
            "forced": self._force,
        }

    def another(self) -> FrameSolver:
        """A solver of the same frames with working arrays of its own, for another thread."""
        return FrameSolver(self._calibration, self._method, self._encoding, weighted=self._weighted, force=self._force)

    def solve(self, frame: StoredFrame, out: Float32Array) -> FrameFigures:
        """Write a frame's heights (µm, zero at untouched skin, NaN where invalid) to `out`; returns its figures.

        out : float32 array of shape (H, W)

        Raises
        ------
        CalibrationMismatch, FrameError
            The frame is of another size or channel order, black or saturated.
        IntegrationError
            It holds nothing that can be integrated.
        SequenceError
            Nobody said how its values encode light.
        """
        intensity = self._read(frame)
        check_intensity(intensity, self._divisor, frame.name, CHECK_COARSENESS)
        refuse_doubtful(self._doubts(intensity), frame.name, force=self._force)
        gradients = self._gradients(intensity)
        height, _ = self._integrator.integrate(gradients, self._calibration.pitch_um, out=out)
        at_rest = untouched_skin(gradients)
        refuse_doubtful(rest_doubts(intensity, at_rest), frame.name, force=self._force)
        zero_um = height_of_rest_um(height, at_rest)
        peak_um, known = _lower(height.z_um, np.float32(zero_um), out)
        return FrameFigures(
            contact_share=shaded_share(_sampled(intensity)),
            clipped_share=float(np.count_nonzero(intensity.clipped) / intensity.clipped.size),
            masked_share=float(1.0 - known / out.size),
            peak_um=float(peak_um) if known else None,
        )

    def _doubts(self, intensity: IntensityImage) -> list[str]:
        return frame_doubts(intensity, self._divisor, self._calibration.inverse.map, SAMPLES_ALONG // CHECK_COARSENESS)

    def _read(self, frame: StoredFrame) -> IntensityImage:
        if isinstance(frame.pixels, RawFrame):
            return raw_intensity(frame.pixels, self._divisor, self._intensity)
        if self._encoding is None:
            raise SequenceError(f"{frame.name}: its values may be linear light or sRGB: say which with --encoding")
        dtype = frame.pixels.dtype
        if dtype not in self._light:
            self._light[dtype] = light_of_values(dtype, self._encoding)
        return stored_intensity(frame.pixels, self._light[dtype], self._divisor, self._intensity)

    def _gradients(self, intensity: IntensityImage) -> GradientField:
        if self._slopes is not None:
            found = self._slopes.evaluate(intensity)
        else:
            found = estimate(intensity, self._calibration, self._method)
        if self._weighted:
            return found
        in_bands(_flatten, self.shape, found.p, found.q, found.valid)
        return replace(full_rectangle(found.p, found.q), valid=self._everywhere)


def _sampled(image: IntensityImage) -> IntensityImage:
    step = max(1, image.shape[1] // SAMPLED_COLUMNS)
    every = (slice(None, None, step), slice(None, None, step))
    return IntensityImage(np.ascontiguousarray(image.values[every]), image.valid[every], image.clipped[every])


@njit(cache=True, nogil=True)
def _flatten(p: Float32Array, q: Float32Array, valid: MaskArray, first: int, last: int) -> None:
    """Make slopes nought where they mean nothing."""
    for r in range(first, last):
        for c in range(valid.shape[1]):
            if not valid[r, c]:
                p[r, c] = np.float32(0.0)
                q[r, c] = np.float32(0.0)


def _lower(z_um: Float32Array, zero_um: Any, out: Float32Array) -> tuple[Any, int]:
    """Write heights above `zero_um`, also in place; returns the largest and how many are known."""
    highest, known = np.empty(len(out), np.float32), np.empty(len(out), np.int64)
    in_bands(_lower_rows, out.shape, z_um, zero_um, out, highest, known)
    return highest.max(), int(known.sum())


@njit(cache=True, nogil=True)
def _lower_rows(z_um: Any, zero_um: Any, out: Any, highest: Any, known: Any, first: int, last: int) -> None:
    for r in range(first, last):
        highest[r], known[r] = _lower_row(z_um[r], zero_um, out[r])


@njit(cache=True)
def _lower_row(z_um: Any, zero_um: Any, out: Any) -> tuple[Any, int]:
    highest, known = np.float32(-np.inf), 0
    for c in range(out.size):
        z = z_um[c] - zero_um
        out[c] = z
        known += np.isfinite(z)
        highest = z if z > highest else highest
    return highest, known
