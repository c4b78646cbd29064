"""Heights of successive frames under one calibration: a frame costs its slopes and one weighted integration.

Gains and offsets, elevation, hidden lights and skin at rest are found on a coarse frame (`fine_pass`). Working arrays
are reused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import LinearFrame, NormalizedImage, demosaic, flat_field_correct
from device.imaging.frame_measures import shaded_fraction
from device.surface import Float32Array, GradientField, HeightMap, MaskArray, full_rectangle
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.errors import SequenceError
from host_sync.frame_checks.colour_check import SAMPLES_ALONG, check_datum, check_frame
from host_sync.frames.frame_set_file import Encoding
from host_sync.frames.linear_light import frame_of_values, light_of_values
from host_sync.frames.sequence import StoredFrame
from host_sync.gradients.confidence import even_confidence
from host_sync.gradients.flat_field_kernel import (
    check_exposure,
    empty_intensity,
    raw_intensity,
    stored_intensity,
    take_out_light,
)
from host_sync.gradients.inverse_map_kernel import SlopeKernel, empty_gradients
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import Datum, find_datum, no_datum
from host_sync.johnson2009.model import estimate_gradients
from host_sync.kernels.cell_rows import in_planes
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.reconstruction.slope_reading import raise_on_warnings, seen_slopes
from host_sync.results.record import refusals
from host_sync.video.fine_pass import (
    WIDEST_PX,
    CoarseReading,
    FineCorrection,
    FrameSigma,
    at_size,
    block_moments,
    corrects_coarsely,
    level,
    read_coarse,
)

CHECK_STRIDE_FACTOR: Final = 8
"""Checks of video frames sample this many times more coarsely than those of a single frame."""

SAMPLED_COLUMNS: Final = 180
"""Columns sampled for the contact fraction, at most; rows are sampled at the same distance."""

DATUM_PX: Final = 192
"""Columns of a coarse frame that show untouched skin and its height, at most."""

TOLERANCE_PX: Final = 0.01
"""Estimated algebraic error of heights at which integration ends, pixels: far below the uncertainty of any frame."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Statistics of one height map; None where nothing was measured.

    contact_fraction : fraction of the field where intensity shows that the skin is not flat
    clipped_fraction : fraction of pixels with a saturated channel
    masked_fraction : fraction of pixels without a height
    peak_um : largest height above untouched skin, µm
    is_relative : True where no untouched skin gives heights a zero
    """

    contact_fraction: float
    clipped_fraction: float
    masked_fraction: float
    peak_um: float | None
    is_relative: bool = False


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
        self.force, self.weighted = force, weighted
        self._tables: dict[np.dtype[Any], Float32Array] = {}
        rows, columns, _ = calibration.flat_field.shape
        self.shape = (rows, columns)
        self.pitch_um = calibration.pitch_um
        self._cell = -(-columns // WIDEST_PX)
        self._flat_field = in_planes(calibration.flat_field)
        self._coarse, self._coarse_rest = calibration, self._flat_field
        if self._cell > 1:
            self._coarse = _coarse_calibration(calibration, self._cell)
            self._coarse_rest = self._coarse.flat_field
        self._intensity = empty_intensity(self.shape)
        self._slopes: SlopeKernel | None = None
        if method == "direct" and self._cell > 1:
            self._slopes = SlopeKernel(calibration.inverse.map, empty_gradients(self.shape))
        self._coarse_slopes = SlopeKernel(self._coarse.inverse.map)
        at_rest = calibration.skin_at_rest
        self._rest = at_rest
        self._gain_sigma = 0.0 if at_rest is None else at_rest.gain_sigma
        self._apart = -(-self._coarse.flat_field.shape[1] // DATUM_PX)
        self._integrator = Integrator(self.shape)
        self._sigma: FrameSigma | None = None
        # A full array, not a broadcast scalar: the search for untouched skin reads every pixel.
        self._all_valid = np.ones((0, 0) if weighted else self.shape, np.bool_)

    @classmethod
    def of(
        cls,
        kept: KeptCalibration,
        method: Method | None = None,
        encoding: Encoding | None = None,
        *,
        full_scale: int | None = None,
        weighted: bool = True,
        force: bool = False,
    ) -> FrameSolver:
        """Return a solver of frames like those of a calibration; what is not given is taken from it."""
        known, facts = kept.calibration, kept.facts
        return cls(
            known,
            method or known.preferred,
            encoding or facts.encoding,
            full_scale=facts.full_scale if full_scale is None else full_scale,
            pixel_shape=facts.pixel_shape,
            weighted=weighted,
            force=force,
        )

    @property
    def is_coarse(self) -> bool:
        """True where sources correct slopes on fewer cells than in a frame that is reconstructed alone."""
        return corrects_coarsely(self.shape[1], self._calibration.light, self.method)

    def clone(self) -> FrameSolver:
        """Return a solver of the same frames with its own working arrays, for another thread."""
        return FrameSolver(
            self._calibration,
            self.method,
            self.encoding,
            full_scale=self._full_scale,
            pixel_shape=self._pixel_shape,
            weighted=self.weighted,
            force=self.force,
        )

    def check(self, frame: StoredFrame) -> None:
        """Refuse a frame whose pattern, layout or levels are not the calibration's; errors as for `solve`.

        They change slowly, so that few frames of a sequence need be checked.
        """
        intensity = self._read(frame)
        check_exposure(intensity, self._flat_field, frame.name, CHECK_STRIDE_FACTOR)
        found = self._calibration.frame_model.check(intensity, self._flat_field)
        raise_on_warnings(refusals(found), frame.name, force=self.force)

    def solve(self, frame: StoredFrame, out: Float32Array, sigma: Float32Array | None = None) -> FrameStatistics:
        """Write a frame's heights (µm, zero at untouched skin, NaN where invalid) to `out`; returns its statistics.

        Pattern, layout and levels are not checked: see `check`.

        out : float32 array of shape (H, W)
        sigma : receives the standard uncertainty of the heights, µm, float32 array of shape (H, W); None for none

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
        image, squares = self._reduced(intensity)
        evidence = None if self._rest is None else self._rest.evidence(image, squares)
        drifted: list[str] = []
        if evidence is not None and evidence.has_rest:
            drifted = refusals(self._calibration.frame_model.levels.check_light(evidence.light))
            take_out_light(evidence.light, intensity.values, self._flat_field)
            if image is not intensity:
                take_out_light(evidence.light, image.values, self._coarse_rest)
        samples = SAMPLES_ALONG // CHECK_STRIDE_FACTOR
        foreign = check_frame(image, self._coarse_rest, self._coarse.inverse.map, samples)
        raise_on_warnings([*foreign, *drifted], frame.name, force=self.force)
        if self._cell == 1 and self._calibration.shrinkage is not None:
            image = self._calibration.shrinkage.shrunk(image)
        reading = read_coarse(image, evidence, self._coarse, self.method, self._coarse_slopes, is_whole=self._cell == 1)
        viewpoint = self._calibration.viewpoint
        if self._cell > 1:
            gradients = self._fine_slopes(intensity, reading)
        elif viewpoint is not None:
            gradients = seen_slopes(reading.gradients, viewpoint, out=reading.gradients)
        else:
            gradients = reading.gradients
        if not self.weighted:
            parallel_rows(_zero_invalid, self.shape, gradients.p, gradients.q, gradients.valid)
            gradients = replace(full_rectangle(gradients.p, gradients.q), valid=self._all_valid)
        self._integrator.integrate(gradients, self.pitch_um, out=out, tolerance_px=TOLERANCE_PX)
        if reading.prior is not None:
            reading.prior.level(HeightMap(out, self.pitch_um))
        coarse = self._coarse_heights(out)
        datum = self._datum(coarse, reading)
        unlit = [] if datum.is_relative else check_datum(_subsample(image, self._apart), datum.skin, self._gain_sigma)
        raise_on_warnings(unlit, frame.name, force=self.force)
        peak_um, known = level(HeightMap(out, self.pitch_um), datum.zero_um, viewpoint)
        if sigma is not None:
            self._sigma = self._sigma or FrameSigma(self._coarse, self.method)
            self._sigma.write(datum.level(coarse), image, reading, datum, out, sigma)
        return FrameStatistics(
            contact_fraction=shaded_fraction(_subsample(image, -(-image.shape[1] // SAMPLED_COLUMNS))),
            clipped_fraction=float(np.count_nonzero(intensity.clipped) / intensity.clipped.size),
            masked_fraction=float(1.0 - known / out.size),
            peak_um=peak_um if known else None,
            is_relative=datum.is_relative,
        )

    def _read(self, frame: StoredFrame) -> NormalizedImage:
        """Return the intensity of a frame."""
        pixels = frame.pixels
        if isinstance(pixels, RawFrame):
            if pixels.shape != self.shape:
                return flat_field_correct(_shrunk_to(pixels, self.shape), self._flat_field)
            return raw_intensity(pixels, self._flat_field, self._intensity)
        if self.encoding is None:
            raise SequenceError(f"{frame.name}: values may be linear light or sRGB: choose with --encoding")
        if self._pixel_shape != 1.0:
            whole = frame_of_values(pixels, self.encoding, self._full_scale, self._pixel_shape)
            return flat_field_correct(whole, self._calibration.flat_field)
        dtype = pixels.dtype
        if dtype not in self._tables:
            self._tables[dtype] = light_of_values(dtype, self.encoding, self._full_scale)
        return stored_intensity(pixels, self._tables[dtype], self._flat_field, self._intensity)

    def _reduced(self, intensity: NormalizedImage) -> tuple[NormalizedImage, Float32Array | None]:
        """Return the coarse image, and means of squared intensity behind its pixels; None where nothing is reduced."""
        if self._cell == 1:
            return intensity, None
        rows, columns = self._coarse_rest.shape[:2]
        mean, square = block_moments(np.moveaxis(intensity.values, -1, 0), self._cell, (rows, columns))
        valid, clipped = (
            cv2.resize(mask.view(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST).view(np.bool_)
            for mask in (intensity.valid, intensity.clipped)
        )
        return NormalizedImage(np.moveaxis(mean, 0, -1), valid, clipped), np.moveaxis(square, 0, -1)

    def _fine_slopes(self, intensity: NormalizedImage, reading: CoarseReading) -> GradientField:
        """Return the slopes of every pixel with what the coarse frame corrects, as the camera sees them."""
        if self._slopes is None:
            found, viewpoint = estimate_gradients(self._calibration.paper_model, intensity), self._calibration.viewpoint
            return found if viewpoint is None else seen_slopes(found, viewpoint, out=found)
        found = self._slopes.evaluate(intensity)
        if self.weighted:
            even_confidence(found, intensity.clipped)
        FineCorrection(reading, self._cell, self._calibration.viewpoint).apply(found)
        return found

    def _coarse_heights(self, z_um: Float32Array) -> HeightMap:
        """Return heights at the middles of coarse pixels."""
        if self._cell == 1:
            return HeightMap(z_um, self.pitch_um)
        middle = self._cell // 2
        rows, columns = self._coarse_rest.shape[:2]
        some = z_um[middle :: self._cell, middle :: self._cell]
        whole = np.pad(some, ((0, rows - some.shape[0]), (0, columns - some.shape[1])), mode="edge")
        return HeightMap(np.ascontiguousarray(whole), self._coarse.pitch_um)

    def _datum(self, coarse: HeightMap, reading: CoarseReading) -> Datum:
        """Return the zero of coarse heights and its skin, at every `_apart`-th of their rows and columns."""
        every = (slice(None, None, self._apart),) * 2
        field = reading.gradients
        p, q, weight = (np.ascontiguousarray(part[every]) for part in (field.p, field.q, field.weight))
        gradients = GradientField(p, q, np.ascontiguousarray(field.valid[every]), weight)
        height = HeightMap(np.ascontiguousarray(coarse.z_um[every]), coarse.pitch_um * self._apart)
        if not reading.has_rest:
            return no_datum(height, gradients)
        at_rest = None if reading.prior is None else reading.prior.at_rest(height.z_um.shape)
        return find_datum(height, gradients, at_rest=at_rest).at_rest(height, gradients)


def _coarse_calibration(calibration: Calibration, cell: int) -> Calibration:
    """Return the calibration for frames of which a pixel is `cell` x `cell` pixels: their noise needs no shrinking."""
    rows, columns = (-(-side // cell) for side in calibration.flat_field.shape[:2])
    rest = in_planes(np.asarray(cv2.resize(calibration.flat_field, (columns, rows), interpolation=cv2.INTER_AREA)))
    reference = LinearFrame(rest, np.zeros((rows, columns), np.bool_))
    return replace(at_size(calibration, reference, rest), denoising=None)


def _shrunk_to(frame: RawFrame, shape: tuple[int, int]) -> LinearFrame:
    """Return a raw frame of another size as a calibration's frames are, where its field has the same shape."""
    (rows, columns), (high, wide) = frame.shape, shape
    if rows < 2 * high or abs(rows * wide - columns * high) > columns:
        return demosaic(frame)  # of a size that is refused
    whole = demosaic(frame)
    rgb = cv2.resize(whole.rgb, (wide, high), interpolation=cv2.INTER_AREA)
    clipped = cv2.resize(whole.clipped.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA) > 0.0
    return LinearFrame(np.asarray(rgb, np.float32), np.asarray(clipped, np.bool_), whole.demosaiced)


def _subsample(image: NormalizedImage, step: int) -> NormalizedImage:
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
