"""Cosines of colour: terms of an inverse map that bend in one place without bending everywhere.

A skin whose metal flakes shine in a narrow lobe answers a small tilt with a large change of colour near flat and with a
small one farther off. A polynomial that follows it there runs away elsewhere. A sum of cosines of random direction and
phase is the smooth function of a Gaussian process: it bends over a stated length and nowhere runs away
(Rahimi & Recht, "Random features for large-scale kernel machines", 2007).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array

WAVES: Final = 64
"""Cosines of a curve that has any."""

BEND_LENGTH: Final = 0.5
"""Over which a sum of them bends, in a colour space's variables: one standard deviation of the balls' colours."""

AMPLITUDE: Final = 1.5
"""Root mean square of a sum of all waves with coefficients of one: how cheap they are beside monomials."""

MAX_WAVES: Final = 1000
"""No curve has more; a file that asks for more is not read."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomFourierFeatures:
    """Cosines a cos(k·v + φ) of a colour's variables v.

    direction : float32 array of shape (3, W), k in radians per variable
    phase : float32 array of shape (W,), φ in radians
    """

    direction: Float32Array
    phase: Float32Array

    @classmethod
    def sample(cls, seed: int = 1) -> RandomFourierFeatures:
        """`WAVES` waves whose sums bend over `BEND_LENGTH`; the same ones each time."""
        random = np.random.default_rng(seed)
        direction = random.standard_normal((3, WAVES)) / BEND_LENGTH
        return cls(direction.astype(np.float32), random.uniform(0.0, 2.0 * np.pi, WAVES).astype(np.float32))

    @classmethod
    def none(cls) -> RandomFourierFeatures:
        """No wave: the curve is a polynomial."""
        return cls(np.zeros((3, 0), np.float32), np.zeros(0, np.float32))

    @property
    def count(self) -> int:
        """Number of features."""
        return self.phase.size

    @property
    def amplitude(self) -> float:
        """Of each wave; 0 without waves."""
        return AMPLITUDE * float(np.sqrt(2.0 / self.count)) if self.count else 0.0

    def values(self, variables: NDArray[Any]) -> NDArray[Any]:
        """Return the waves at colours' variables of shape (N, 3): array of shape (N, W) of the same type."""
        kind = variables.dtype
        angle = variables @ self.direction.astype(kind) + self.phase.astype(kind)
        return np.asarray(kind.type(self.amplitude) * np.cos(angle))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays, nothing where there is no wave; `from_arrays` is its inverse."""
        return {"direction": self.direction, "phase": self.phase} if self.count else {}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> RandomFourierFeatures:
        """Return the waves that `arrays` wrote; KeyError or ValueError when malformed."""
        if not arrays:
            return cls.none()
        direction, phase = (np.asarray(arrays[name], np.float32) for name in ("direction", "phase"))
        fits = phase.ndim == 1 and direction.shape == (3, phase.size) and 0 < phase.size <= MAX_WAVES
        if not fits or not (np.isfinite(direction).all() and np.isfinite(phase).all()):
            raise ValueError(f"waves of shape {direction.shape} and {phase.shape}")
        return cls(direction, phase)
