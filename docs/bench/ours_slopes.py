"""Our slopes per pixel, as the workstation evaluates the position-aware inverse map."""

from __future__ import annotations

from device.inverse_map import InverseMap
from device.photometry import IntensityImage
from device.surface import GradientField
from host_sync.reconstruction.slope_kernel import evaluate


def estimate_slopes(inverse_map: InverseMap, image: IntensityImage) -> GradientField:
    """Slope, validity and confidence of every pixel: the one place that says which kernel is measured as ours."""
    return evaluate(inverse_map, image)
