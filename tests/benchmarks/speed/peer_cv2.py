"""Peer: the same least squares by OpenCV's discrete cosine transform, which needs even sizes."""

from __future__ import annotations

import cv2
import numpy as np

from device.surface import Float32Array
from tests.benchmarks.speed.peer_dct import divergence, divide_by_eigenvalues


def integrate_cv2(p: Float32Array, q: Float32Array) -> Float32Array:
    """Heights (px) of shape (H, W), both even."""
    spectrum = cv2.dct(divergence(p, q))
    divide_by_eigenvalues(spectrum)
    return np.asarray(cv2.idct(spectrum), np.float32)
