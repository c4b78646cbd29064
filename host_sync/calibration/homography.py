"""Homographies: how one plane is seen in perspective."""

from __future__ import annotations

import numpy as np

from device.surface.fields import Float64Array


def project(homography: Float64Array, points: Float64Array) -> Float64Array:
    """Return points of shape (K, 2) mapped by a homography of shape (3, 3)."""
    mapped = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    depth = np.where(mapped[:, 2:] == 0.0, np.finfo(np.float64).tiny, mapped[:, 2:])
    return np.asarray(mapped[:, :2] / depth)


def fit_homography(places: Float64Array, points: Float64Array) -> Float64Array:
    """Return the homography of shape (3, 3) from places to points, at least four of each; direct linear fit."""
    (a, from_places), (b, from_points) = _normalised(places), _normalised(points)
    zero, one = np.zeros((len(a), 3)), np.concatenate([a, np.ones((len(a), 1))], axis=1)
    rows = np.concatenate(
        [np.concatenate([one, zero, -b[:, :1] * one], axis=1), np.concatenate([zero, one, -b[:, 1:] * one], axis=1)]
    )
    solution = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    homography = np.linalg.inv(from_points) @ solution @ from_places
    return np.asarray(homography / np.linalg.norm(homography))


def _normalised(points: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return points about their middle in units of their spread, and the matrix that makes them so."""
    middle = points.mean(axis=0)
    scale = 1.0 / max(float(np.abs(points - middle).mean()), 1e-9)
    matrix = np.array([[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]])
    return (points - middle) * scale, matrix
