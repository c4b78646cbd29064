"""How often the truth lies within the stated standard uncertainty, by tilt of the true surface."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from hal.simulator.bench import TwinTruth
from host_sync.reconstruction.pipeline import Reconstruction
from tests.benchmarks.accuracy.ball_error import inner_contact
from tests.benchmarks.accuracy.marks import BANDS_DEG


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Pixels of one scan by slope band.

    pixels : int array of shape (bands,)
    covered : int array of shape (bands,), those whose error is at most the stated standard uncertainty
    """

    pixels: NDArray[np.int64]
    covered: NDArray[np.int64]

    def __add__(self, other: Coverage) -> Coverage:
        return Coverage(self.pixels + other.pixels, self.covered + other.covered)

    def shares(self) -> list[float | None]:
        """Fraction of covered pixels per band; None where there are no pixels."""
        return [int(c) / int(n) if n else None for c, n in zip(self.covered, self.pixels, strict=True)]


NOTHING = Coverage(np.zeros(len(BANDS_DEG), np.int64), np.zeros(len(BANDS_DEG), np.int64))


def height_coverage(found: Reconstruction, truth: TwinTruth) -> Coverage:
    """Coverage of the height above untouched skin, over the inner contact."""
    return count_within(found.height.z_um - truth.z_um, found.sigma_um, truth)


def slope_coverage(found: Reconstruction, truth: TwinTruth) -> Coverage:
    """Coverage of the surface's slopes, both components, over the inner contact."""
    return count_within(found.p - truth.p, found.slope_sigma, truth) + count_within(
        found.q - truth.q, found.slope_sigma, truth
    )


def total(parts: Iterable[Coverage]) -> Coverage:
    """All pixels of several scans."""
    return sum(parts, NOTHING)


def count_within(error: Float32Array, sigma: Float32Array, truth: TwinTruth) -> Coverage:
    """Pixels of the inner contact with a stated σ, and those whose error is at most that."""
    steepness_deg = np.degrees(np.arctan(np.hypot(truth.p, truth.q)))
    counted = inner_contact(truth.contact) & np.isfinite(error) & np.isfinite(sigma)
    within = np.abs(error) <= sigma
    bands = [counted & (steepness_deg >= low) & (steepness_deg < high) for low, high in BANDS_DEG]
    return Coverage(
        np.array([band.sum() for band in bands], np.int64),
        np.array([(band & within).sum() for band in bands], np.int64),
    )
