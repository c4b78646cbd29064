"""A small frame set of matt skin under three lamps, on disk: a reference, balls all over the field, one scan."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from near_lamps import RADIUS_PX, SHAPE, NearLamps, press_px

from device.balls.sphere import Ball

PITCH_UM = 20.0
APEX_PX = 14.0
PLACES = [(column, row) for row in (0.28, 0.72) for column in (0.2, 0.5, 0.8)]


def write_frame_set(folder: Path) -> Path:
    """The set's file; its balls are labelled and its scan is one more ball."""
    lamps = NearLamps(500.0)
    light = lamps.flat_field() * 6e3
    light *= 0.5 / light.max()
    folder.mkdir(parents=True)
    _write(folder / "flat.png", light, 0)
    lines = [f'name = "gel-3"\npixel_pitch_um = {PITCH_UM}\nencoding = "linear"\n[reference]\nimage = "flat.png"']
    for number, (column, row) in enumerate([*PLACES, (0.4, 0.45)]):
        ball = Ball(column * SHAPE[1], row * SHAPE[0], 0.6 * RADIUS_PX, RADIUS_PX)
        intensity = lamps.intensity(press_px(ball, APEX_PX))
        _write(folder / f"ball-{number}.png", light * intensity.values, 1 + number)
        label = f"balls = [{{ x = {ball.column:.1f}, y = {ball.row:.1f}, r = {ball.contact_radius_px:.1f} }}]"
        if number < len(PLACES):
            radius = f"ball_radius_mm = {RADIUS_PX * PITCH_UM * 1e-3:g}"
            lines.append(f'[[press]]\nimage = "ball-{number}.png"\n{radius}\n{label}')
    lines.append(f'[[scan]]\nname = "ball"\nimage = "ball-{len(PLACES)}.png"\n')
    (folder / "frameset.toml").write_text("\n".join(lines))
    return folder / "frameset.toml"


def _write(path: Path, light: np.ndarray, seed: int) -> None:
    noisy = light + 0.002 * np.random.default_rng(seed).standard_normal(light.shape)
    values = np.clip(np.rint(noisy * 65535.0), 0, 65535).astype(np.uint16)
    assert cv2.imwrite(str(path), values[..., ::-1])
