"""Standard uncertainty of a video frame's heights, by the samples of a single frame's on a field reduced once more."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import msgspec
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array, GradientField, HeightMap, MaskArray, surface_slopes
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.integration.zero_level import Datum
from host_sync.reconstruction.reading_uncertainty import known_scale_share, slope_error_of
from host_sync.uncertainty.calibration_uncertainty import CalibrationUncertainty, calibration_uncertainty
from host_sync.uncertainty.height_error import height_uncertainty, nonintegrable_residual
from host_sync.video.fine_pass import CoarseReading

WIDEST_PX: Final = 160
"""Columns of the field on which errors are drawn, at most: they are long waves."""


class FrameSigma:
    """Uncertainty of the heights of coarse frames.

    calibration : of coarse frames
    """

    def __init__(self, calibration: Calibration, method: Method) -> None:
        rows, columns, _ = calibration.flat_field.shape
        self._step = -(-columns // WIDEST_PX)
        self._size = (-(-columns // self._step), -(-rows // self._step))
        error, step = slope_error_of(calibration, method), float(self._step)
        self._error = msgspec.structs.replace(
            error,
            patch_px=error.patch_px / step,
            pixel_deg=tuple(part / step for part in error.pixel_deg),
            elevation=error.elevation.enlarged(1.0 / step),
        )
        self._replicas = calibration.inverse.replicas if method == "direct" else ()
        self._scale = known_scale_share(calibration)

    def write(
        self,
        height: HeightMap,
        image: NormalizedImage,
        reading: CoarseReading,
        datum: Datum,
        z_um: Float32Array,
        out: Float32Array,
    ) -> None:
        """Write the uncertainty (µm, NaN where there is no height) of a frame of full size to `out`.

        height : of the coarse frame, over its zero
        z_um : heights of full size, float32 array of shape (H, W), as `out`
        """
        gradients, correction = reading.gradients, reading.correction
        nonintegrable = nonintegrable_residual(gradients, *surface_slopes(height))
        if correction is None or correction.unsure is None:
            unknown = calibration_uncertainty(image, self._replicas, self._size)
        else:
            unknown = CalibrationUncertainty.of(correction.unsure(), self._size)
        found = height_uncertainty(
            HeightMap(self._less(height.z_um), height.pitch_um * self._step),
            GradientField(
                self._less(gradients.p, gradients.valid),
                self._less(gradients.q, gradients.valid),
                self._less(gradients.valid.astype(np.float32)) > 0.0,
                self._less(gradients.weight),
            ),
            self._less(nonintegrable),
            self._error,
            replace(datum, skin=self._less(datum.skin.astype(np.float32)) > np.float32(0.5)),
            self._scale,
            calibration=unknown,
            shadow=None if correction is None else correction.sigma(self._size),
        )
        size = (out.shape[1], out.shape[0])
        cv2.resize(np.nan_to_num(found.sigma_um, nan=float(np.nanmax(found.sigma_um))), size, dst=out)
        np.copyto(out, np.nan, where=~np.isfinite(z_um))

    def _less(self, field: Float32Array, known: MaskArray | None = None) -> Float32Array:
        """Return means over cells of a field of coarse pixels, 0 where it is not known."""
        here = np.isfinite(field) if known is None else known
        whole = field if here.all() else np.where(here, field, np.float32(0.0))
        return np.asarray(cv2.resize(whole, self._size, interpolation=cv2.INTER_AREA), np.float32)
