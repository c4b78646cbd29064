"""Compiled ahead is everything that the solver needs: a frame's field compiles nothing more."""

from __future__ import annotations

import numpy as np

from device.surface import GradientField
from host_sync.integration.integrate import compile_integration, integrate
from host_sync.kernels.jit import CompileTime


def test_a_field_compiles_nothing_that_was_not_compiled_ahead() -> None:
    compile_integration()
    rng, compiling = np.random.default_rng(0), CompileTime()
    for holed in (False, True):
        p, q, weight = (rng.random((380, 507), dtype=np.float32) for _ in range(3))
        valid = np.ones(p.shape, bool)
        if holed:
            weight[100:120, 30:90] = 0.0
            valid[100:120, 30:90] = False
        else:
            weight[:] = 1.0
        integrate(GradientField(p, q, valid, weight), 5.0)
    assert compiling.total_s == 0.0
