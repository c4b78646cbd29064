"""The light model of `NearLamps`, stated instead of fitted, and which of its lamps reach a surface, ray by ray."""

from __future__ import annotations

import numpy as np
from near_lamps import LAMPS_OUT_PX, SHAPE, NearLamps

from host_sync.light.fit import FittedLight
from host_sync.light.model import PLACES, TERMS, LightModel

ANGLE = np.radians([10.0, 130.0, 250.0])
ROW, COLUMN = (axis.astype(np.float64) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])


def lamp_places(height_px: float) -> np.ndarray:
    """Return right, down and up of each lamp from the middle of the field, in widths of it: shape (3, 3)."""
    # The renderer counts from half the width, pixels from their centres.
    right, down = (LAMPS_OUT_PX * turned + 0.5 for turned in (np.cos(ANGLE), np.sin(ANGLE)))
    return np.stack([right, down, np.full(3, height_px)], axis=-1) / SHAPE[1]


def matt_model(height_px: float, sigma: float = 0.004) -> LightModel:
    """Return the model of lamps at one height over a matt skin: points without haze, gloss or light from skin around.

    sigma : error that the model states of its intensity
    """
    return LightModel(
        shape=SHAPE,
        sources=np.column_stack([lamp_places(height_px), np.zeros((3, 2))]),
        strengths=np.eye(3),
        haze=np.zeros(3),
        albedo=0.0,
        fall_off=2.0,
        roughness=0.0,
        gloss=0.0,
        gloss_width=0.3,
        tail=2.0,
        tilt_gain=0.0,
        scattering=0.0,
        beam=0.0,
        camera=0.0,
        residual=np.zeros((3, TERMS, PLACES)),
        sigma=np.full(3, sigma),
        source_sigma=np.full(3, sigma),
        steepest=1.0,
    )


def stated(*models: LightModel) -> FittedLight:
    """Return a calibration's light: of the first model, and folds of all models."""
    return FittedLight(models[0], models, np.zeros((len(models), 2)))


def lamps_reach(z_px: np.ndarray, lamps: NearLamps) -> np.ndarray:
    """Return whether each lamp reaches the skin over this elevation (pixels, shape (H, W)): shape (H, W, 3)."""
    lit = np.ones((*SHAPE, 3), bool)
    for lamp, (right, down, up) in enumerate(SHAPE[1] * lamp_places(lamps.height_px)):
        to_x, to_y = right + 0.5 * (SHAPE[1] - 1) - COLUMN, down + 0.5 * (SHAPE[0] - 1) - ROW
        for part in np.linspace(0.004, 0.4, 120):
            at_x = np.clip(np.rint(COLUMN + part * to_x).astype(int), 0, SHAPE[1] - 1)
            at_y = np.clip(np.rint(ROW + part * to_y).astype(int), 0, SHAPE[0] - 1)
            lit[..., lamp] &= z_px[at_y, at_x] <= z_px + part * (up - z_px) + 0.3
    return lit
