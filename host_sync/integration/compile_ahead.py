"""Compiles the solver's kernels before they are needed, beside other work of a first run."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface.fields import Float32Array, GradientField
from host_sync.integration.integrate import integrate

EVEN: Final = (96, 128)
ODD: Final = (95, 127)
"""Sizes of fields with levels enough for every kernel of a frame; a side that cannot be halved takes other steps."""


def compile_integration() -> None:
    """Solve small fields with equal weights, and one with weights and a hole; what is compiled stays in the cache."""
    for shape in (EVEN, ODD):
        integrate(_flat(np.ones(shape, np.float32)), 1.0)
    weight = np.full(EVEN, 0.5, np.float32)
    weight[:, :20] = 1.0
    weight[40:50, 60:70] = 0.0
    integrate(_flat(weight), 1.0)


def _flat(weight: Float32Array) -> GradientField:
    """Slopes of zero with these weights."""
    return GradientField(np.zeros_like(weight), np.zeros_like(weight), weight > 0.0, weight)
