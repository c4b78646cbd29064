"""Synthetic surfaces for comparing parameters: each an array in µm with its pitch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PITCH_UM: Final = 2.0
SHAPE: Final = (320, 400)


def surfaces() -> Mapping[str, FloatArray]:
    """Surfaces by name, float64 arrays of shape (H, W), µm."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    random = np.random.default_rng(25178)
    noise = random.standard_normal(SHAPE)
    sine = 3.0 * np.sin(2.0 * np.pi * column / 40.0 + 0.1)
    grooves = np.where((column + 7.0) % 50.0 < 12.0, -4.0, 0.0) + 0.05 * noise
    spheres = np.sqrt(np.maximum(30.0**2 - ((column % 80.0) - 40.0) ** 2 - ((row % 80.0) - 40.0) ** 2, 0.0)) * 0.2
    return {
        "sine": sine,
        "tilt and noise": 0.02 * column - 0.035 * row + 0.4 * noise,
        "grooves": grooves,
        "spheres": spheres,
        "fractal": fractal(random),
    }


def fractal(random: np.random.Generator) -> FloatArray:
    """Isotropic noise whose amplitude falls with the 1.8th power of frequency."""
    down, across = (np.fft.fftfreq(side) for side in SHAPE)
    frequency = np.hypot(down[:, None], across)
    frequency[0, 0] = np.inf
    spectrum = np.fft.fft2(random.standard_normal(SHAPE)) * frequency**-1.8
    heights = np.fft.ifft2(spectrum).real
    return np.asarray(2.0 * heights / heights.std())


def torn(z_um: FloatArray) -> FloatArray:
    """The surface with a tenth of its pixels missing: a disc, a strip and scattered ones."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    holes = np.hypot(row - 150.0, column - 220.0) < 45.0
    holes |= column < 6
    holes |= np.random.default_rng(1).random(SHAPE) < 0.04
    return np.where(holes, np.nan, z_um)
