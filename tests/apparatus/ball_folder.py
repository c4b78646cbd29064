"""Folders of small frames in which a ball presses a matt skin under three low lamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

SHAPE = (180, 240)
RADIUS_PX, CONTACT_PX = 40.0, 28.0
OPTIONS = ("--pixel-pitch-um", "50", "--ball-radius-mm", "2", "--encoding", "linear")
PLACES = ((70.0, 60.0), (160.0, 90.0), (110.0, 120.0), (60.0, 110.0), (180.0, 60.0), (120.0, 70.0), (90.0, 90.0))


def frame(balls: Sequence[tuple[float, float]], gain: float = 1.0) -> NDArray[np.uint8]:
    """A matt skin under three low lamps, in which spheres leave caps; BGR as OpenCV stores it."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    p, q = np.zeros(SHAPE), np.zeros(SHAPE)
    for x, y in balls:
        distance = np.hypot(column - x, row - y)
        inside = distance < CONTACT_PX
        height = np.sqrt(np.maximum(RADIUS_PX**2 - distance**2, 1.0))
        fall = np.where(inside, 1.0, np.exp(-((distance - CONTACT_PX) / 6.0)))
        slope = np.where(inside, 1.0 / height, 1.0 / np.sqrt(RADIUS_PX**2 - CONTACT_PX**2)) * fall
        p, q = p - (column - x) * slope, q - (row - y) * slope
    length = np.sqrt(1.0 + p * p + q * q)
    lamps = [(np.cos(a), np.sin(a)) for a in np.radians([90.0, 210.0, 330.0])]
    light = [0.35 * np.maximum(0.5 - 0.8 * (p * x + q * y), 0.0) / length / 0.5 for x, y in lamps]
    uneven = 1.0 + 0.2 * (column / SHAPE[1] - 0.5)
    noise = np.random.default_rng(int(sum(x for x, _ in balls))).normal(0.0, 0.3, (*SHAPE, 3))
    values = 255.0 * gain * np.stack(light, axis=-1) * uneven[..., None] + noise
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def put(path: Path, balls: Sequence[tuple[float, float]] = (), gain: float = 1.0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), frame(balls, gain))


def presses(folder: Path, names: str, first: int = 1) -> None:
    for number, place in enumerate(PLACES, start=first):
        put(folder / names.format(number), [place])
