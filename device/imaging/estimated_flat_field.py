"""A flat field estimated from the frames themselves, for sets without a reference frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import DARK_FLOOR, LinearFrame
from device.surface.fields import Float32Array


def estimate_flat_field(frames: list[LinearFrame], degree: int = 6) -> Float32Array:
    """Robust polynomial of log colour over position, fitted to all frames.

    Most of every frame shows untouched skin, so an iteratively reweighted fit finds it.
    Returns a float32 array of shape (H, W, N), fraction of full scale; N is the frames' number of channels.
    """
    step = max(1, int(np.sqrt(frames[0].rgb[..., 0].size * len(frames) / 60_000)))
    rows, columns = frames[0].shape
    basis_small = _position_polynomials(rows, columns, degree, step)
    channels = frames[0].rgb.shape[2]
    flat_field = np.empty((rows, columns, channels), np.float32)
    basis_row, basis_column = _chebyshev(rows, degree, 1), _chebyshev(columns, degree, 1)
    for channel in range(channels):
        samples = np.concatenate([f.rgb[::step, ::step, channel].ravel() for f in frames])
        seen = np.concatenate([~f.clipped[::step, ::step].ravel() for f in frames]) & (samples > DARK_FLOOR)
        design = np.tile(basis_small, (len(frames), 1))[seen]
        coefficients = _robust_fit(design, np.log(samples[seen]).astype(np.float64))
        surface = np.zeros((rows, columns))
        for value, (i, j) in zip(coefficients, _degrees(degree), strict=True):
            surface += value * np.outer(basis_row[:, i], basis_column[:, j])
        flat_field[..., channel] = np.exp(np.clip(surface, np.log(DARK_FLOOR / 10), 0.0))
    return flat_field


def _degrees(degree: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]


def _chebyshev(size: int, degree: int, step: int) -> NDArray[np.float64]:
    at = np.arange(0, size, step) * (2.0 / max(size - 1, 1)) - 1.0
    return np.polynomial.chebyshev.chebvander(at, degree)


def _position_polynomials(rows: int, columns: int, degree: int, step: int) -> NDArray[np.float64]:
    along_row, along_column = _chebyshev(rows, degree, step), _chebyshev(columns, degree, step)
    terms = [np.outer(along_row[:, i], along_column[:, j]).ravel() for i, j in _degrees(degree)]
    return np.stack(terms, axis=-1)


def _robust_fit(design: NDArray[np.float64], target: NDArray[np.float64], rounds: int = 12) -> NDArray[np.float64]:
    """Return coefficients of a Tukey-weighted least-squares fit."""
    weight = np.ones_like(target)
    coefficients: NDArray[np.float64] = np.zeros(design.shape[1])
    for _ in range(rounds):
        weighted = design * weight[:, None]
        gram = weighted.T @ design + 1e-6 * len(target) * np.eye(design.shape[1])
        coefficients = np.asarray(np.linalg.solve(gram, weighted.T @ target), np.float64)
        residual = target - design @ coefficients
        scale = 4.7 * 1.4826 * max(float(np.median(np.abs(residual))), 1e-6)
        weight[:] = np.maximum(1.0 - (residual / scale) ** 2, 0.0) ** 2
    return coefficients
