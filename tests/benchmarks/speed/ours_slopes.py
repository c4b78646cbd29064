"""Our slopes per pixel, as the workstation evaluates the position-aware inverse map."""

from __future__ import annotations

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import GradientField
from host_sync.gradients.inverse_map_kernel import evaluate


def estimate_slopes(inverse_map: InverseMap, image: NormalizedImage) -> GradientField:
    """Slope, validity and confidence of every pixel; the only place that defines which kernel is measured as ours."""
    return evaluate(inverse_map, image)
