"""Result folders as reconstruct writes them, made of closed-form surfaces and drawn errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import tifffile

PITCH_UM = 5.0
SHAPE = (180, 240)


def _smooth_error(random: np.random.Generator, size_um: float) -> np.ndarray:
    """Height errors that are alike over about twenty pixels: float32 array of SHAPE."""
    noise = cv2.GaussianBlur(random.standard_normal(SHAPE).astype(np.float32), (0, 0), 10.0)
    return size_um * noise / noise.std()


@pytest.fixture
def smooth_error() -> Callable[[np.random.Generator, float], np.ndarray]:
    return _smooth_error


@pytest.fixture
def write_result(tmp_path: Path) -> Callable[..., Path]:
    def write(
        z_um: np.ndarray, name: str = "wave", error_um: float = 0.1, seed: int = 0, samples: int = 16, **facts: object
    ) -> Path:
        folder = tmp_path / name.replace("/", "_")[:40]
        folder.mkdir(exist_ok=True)
        random = np.random.default_rng(seed)
        tifffile.imwrite(folder / "height_um.tif", z_um.astype(np.float32))
        if samples:
            errors = [_smooth_error(random, error_um) for _ in range(samples)]
            tifffile.imwrite(folder / "height_draws_um.tif", np.stack(errors).astype(np.float32))
        record = {
            "schema": "retrograph.result/1",
            "name": name,
            "program": "retrograph 0.1.0",
            "rows": z_um.shape[0],
            "columns": z_um.shape[1],
            "pixel_pitch_um": PITCH_UM,
            "calibration_id": "abc",
            "warnings": [],
            "height_scale": {"pixel_pitch_share": None, "ball_radius_share": None},
        }
        (folder / "result.json").write_bytes(msgspec.json.encode(record | facts))
        return folder

    return write


@pytest.fixture
def wave() -> np.ndarray:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return 2.0 * np.sin(2.0 * np.pi * column / 30.0 + 0.2) + 0.01 * row
