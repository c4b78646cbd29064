"""Frames at reduced size, on which what changes slowly over the field is found: elevation, hidden lights, skin at rest.

All of these are long waves, so that their cost need not grow with the pixels of a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from device.imaging.flat_field import LinearFrame, NormalizedImage
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface.fields import Float32Array, GradientField
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.gradients.inverse_map_kernel import SlopeKernel
from host_sync.kernels.cell_rows import WIDEST_CELLS
from host_sync.light.cell_correction import CellCorrection
from host_sync.light.fit import FittedLight
from host_sync.light.reading import correct_slopes
from host_sync.reconstruction.perspective import seen_slopes
from host_sync.reconstruction.rest_prior import RestPrior
from host_sync.reconstruction.slope_reading import uncorrected

WIDEST_PX: Final = 384
"""Columns of a coarse frame, at most."""

CELLS_ACROSS: Final = 64
"""Cells along a frame's columns on which the light model is solved, at most: its changes are long waves. Shadows of
sources have edges: under them a frame that is not reduced has as many cells as one alone."""


def at_size(calibration: Calibration, reference: LinearFrame, flat_field: Float32Array) -> Calibration:
    """Return the calibration of the same field at the reference's size: positions are fractions of the field.

    reference, flat_field : untouched skin at that size, and what frames are divided by
    """
    finer = reference.shape[1] / calibration.flat_field.shape[1]
    error = calibration.slope_error
    return replace(
        calibration,
        flat_field=flat_field,
        frame_model=FrameModel.of(reference, flat_field, []),
        pitch_um=calibration.pitch_um / finer,
        inverse=replace(calibration.inverse, map=replace(calibration.inverse.map, shape=reference.shape)),
        slope_error=msgspec.structs.replace(
            error, patch_px=error.patch_px * finer, elevation=error.elevation.enlarged(finer)
        ),
        elevation=calibration.elevation.enlarged(finer),
        viewpoint=None if calibration.viewpoint is None else calibration.viewpoint.enlarged(finer),
        light=calibration.light.for_shape(reference.shape),
    )


def corrects_coarsely(columns: int, light: FittedLight, method: Method) -> bool:
    """Return whether sources correct slopes of frames so wide on fewer cells than those of a single frame."""
    return columns > WIDEST_PX and method == "direct" and light.has_sources and light.confirmed > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CoarseReading:
    """Slopes of a coarse frame and what they gained: arrays of shape (h, w).

    gradients : corrected slopes and their weights, skin at rest included
    gain_p, gain_q, weight : what slopes gained, and by which factor their weight changed; None where nothing did
    prior : of skin at rest; None without
    correction : of hidden or known lights, or a quadric; None without
    """

    gradients: GradientField
    gain_p: Float32Array
    gain_q: Float32Array
    weight: Float32Array
    prior: RestPrior | None
    correction: CellCorrection | None

    @property
    def has_rest(self) -> bool:
        """True unless the light shows that no skin is untouched."""
        return self.correction is None or self.correction.has_rest


def read_coarse(
    image: NormalizedImage,
    evidence: RestEvidence | None,
    calibration: Calibration,
    method: Method,
    kernel: SlopeKernel,
    *,
    is_whole: bool,
) -> CoarseReading:
    """Return the slopes of a coarse image, corrected as those of a single frame are.

    evidence : of skin at rest; None without a reference
    kernel : the compiled inverse map of the calibration
    is_whole : the image is not reduced, and its slopes are those of a frame reconstructed alone
    """
    gradients = uncorrected(image, calibration, method, kernel=kernel)
    read_p, read_q, sure = gradients.p.copy(), gradients.q.copy(), gradients.weight.copy()
    correction, light = None, calibration.light
    if method == "direct" and light.confirmed:
        correction = correct_slopes(
            gradients, image, light, calibration.prior_sigma, calibration.elevation,
            rest=evidence, cells_across=WIDEST_CELLS if is_whole and light.has_sources else CELLS_ACROSS,
        )  # fmt: skip
        correction.apply(gradients)
    gain_p, gain_q = gradients.p - read_p, gradients.q - read_q
    weight = np.asarray(gradients.weight / np.maximum(sure, np.float32(1e-12)), np.float32)
    prior = None
    if evidence is not None and method == "direct" and (correction is None or correction.has_rest):
        viewpoint = calibration.viewpoint
        prior = RestPrior.of(gradients if viewpoint is None else seen_slopes(gradients, viewpoint), [evidence])
        if prior is not None:
            prior.apply(gradients)
    return CoarseReading(gradients, gain_p, gain_q, weight, prior, correction)
