"""Peer: least squares on a full rectangle by scipy's discrete cosine transform, without weights or holes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from device.surface import Float32Array


class KeptDct:
    """Heights (px) of fields of shape (H, W) by `scipy.fft.dctn` on this many threads.

    Eigenvalues and working arrays are kept, as in our own solver.
    """

    def __init__(self, shape: tuple[int, int], workers: int) -> None:
        self._eigenvalue = eigenvalues(shape, np.float32)
        self._rhs, self._edges = np.empty(shape, np.float32), np.empty(shape, np.float32)
        self._workers = workers

    def integrate(self, p: Float32Array, q: Float32Array) -> Float32Array:
        """Heights of slopes p and q; the array is reused by the next call."""
        rhs = self._rhs
        across, down = self._edges[:, 1:], self._edges[1:]
        np.multiply(np.add(p[:, 1:], p[:, :-1], out=across), np.float32(0.5), out=across)
        rhs[:, 0] = 0.0
        rhs[:, 1:] = across
        rhs[:, :-1] -= across
        np.multiply(np.add(q[1:], q[:-1], out=down), np.float32(0.5), out=down)
        rhs[1:] += down
        rhs[:-1] -= down
        return self.transforms(rhs)

    def transforms(self, rhs: Float32Array) -> Float32Array:
        """Heights of a right-hand side, which is overwritten: only the transform and its inverse."""
        spectrum = dctn(rhs, type=2, norm="ortho", overwrite_x=True, workers=self._workers)
        spectrum /= self._eigenvalue
        spectrum[0, 0] = 0.0
        return np.asarray(idctn(spectrum, type=2, norm="ortho", overwrite_x=True, workers=self._workers))


def exact(p: Float32Array, q: Float32Array, *, fourth_order: bool) -> NDArray[np.float64]:
    """The converged solution in double precision, heights in px."""
    slopes = (slope.astype(np.float64) for slope in (p, q))
    return _solve(
        divergence(*slopes, fourth_order=fourth_order),
        lambda a: dctn(a, type=2, norm="ortho", overwrite_x=True),
        lambda a: idctn(a, type=2, norm="ortho", overwrite_x=True),
    )


def divergence(p: NDArray[Any], q: NDArray[Any], *, fourth_order: bool = False) -> NDArray[Any]:
    """Right-hand side of the least squares, of the slopes' shape and precision."""
    out = np.zeros_like(p)
    across, down = edge_slopes(p, fourth_order=fourth_order), edge_slopes(q.T, fourth_order=fourth_order).T
    out[:, :-1] -= across
    out[:, 1:] += across
    out[:-1] -= down
    out[1:] += down
    return out


def edge_slopes(slope: NDArray[Any], *, fourth_order: bool) -> NDArray[Any]:
    """Height differences of neighbours along rows: mean of both slopes, or fourth order where there are four."""
    both = slope[:, 1:] + slope[:, :-1]
    edges = slope.dtype.type(0.5) * both
    if fourth_order:
        edges[:, 1:-1] += (both[:, 1:-1] - slope[:, 3:] - slope[:, :-3]) / slope.dtype.type(24.0)
    return np.asarray(edges)


def divide_by_eigenvalues(spectrum: NDArray[Any]) -> None:
    """Turn the spectrum of the right-hand side into that of the heights, in place."""
    spectrum /= eigenvalues(spectrum.shape, spectrum.dtype)
    spectrum[0, 0] = 0.0


def eigenvalues(shape: tuple[int, ...], kind: Any) -> NDArray[Any]:
    """Divisor of a spectrum of this shape and type; 1 where it is zero."""
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    found = rows.astype(kind)[:, None] + columns.astype(kind)[None, :]
    found[0, 0] = 1.0
    return np.asarray(found)


def _solve(rhs: NDArray[Any], forward: Callable[[Any], Any], backward: Callable[[Any], Any]) -> NDArray[Any]:
    spectrum = forward(rhs)
    divide_by_eigenvalues(spectrum)
    return np.asarray(backward(spectrum))
