"""Integration as the paper prints it: one-sided differences and no weights (eqs. 9 and 10).

E(z) = Σ (∂f/∂x - p)² + (∂f/∂y - q)² with ∂f/∂x = f(x + 1, y) - f(x, y): a pixel's slope is taken for the height
difference to its next neighbour, half a pixel off, and every pixel counts alike. The default averages slopes onto the
edges and weighs them (see `edge_slopes`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from device.surface import GradientField, HeightMap
from host_sync.reconstruction.multigrid import IntegrationReport, integrate


def integrate_as_printed(gradients: GradientField, pitch_um: float) -> tuple[HeightMap, IntegrationReport]:
    """The height map that minimises the paper's E, and how it was reached; pixels without a slope are holes."""
    alike = replace(gradients, weight=gradients.valid.astype(np.float32))
    return integrate(alike, pitch_um, edges="printed")
