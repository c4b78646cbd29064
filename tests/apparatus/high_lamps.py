"""Lamps under which slopes of skin that stands high are read too steep."""

from __future__ import annotations

import numpy as np

from host_sync.calibration.elevation_response import NODES, ElevationResponse


def lamps_at(height_px: float) -> ElevationResponse:
    """Three lamps at one height, seen from every place under the same angle: b = 0.5 / h, c = a (b + 1 / h)."""
    angle = np.radians([90.0, 210.0, 330.0])
    a = np.broadcast_to(np.stack([np.cos(angle), np.sin(angle)]), (NODES, NODES, 2, 3)).astype(np.float32)
    b = np.full((NODES, NODES, 3), 0.5 / height_px, np.float32)
    return ElevationResponse(a, b, a * np.float32(1.5 / height_px), 1.0, 0.05)
