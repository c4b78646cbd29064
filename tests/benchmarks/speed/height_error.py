"""How far a height map is from the true relief."""

from __future__ import annotations

from device.surface import Float32Array, Float64Array


def error_share(z_px: Float32Array, truth_px: Float32Array | Float64Array) -> float:
    """Root mean square error of a height map relative to that of the true relief, each with mean zero."""
    return float((z_px - truth_px).std() / truth_px.std())
