"""Presses of one large object as a hand sets them side by side: shifted, turned, each with its own level and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from device.align import Pose
from device.surface import Float32Array, Float64Array
from host_sync.mosaic.presses import Fields, Press
from host_sync.registration.fit import between_pixels
from host_sync.results.field_file import write_field
from host_sync.results.files import HEIGHT_FILE, HEIGHT_SIGMA_FILE, RECORD_FILE
from host_sync.results.record import ResultRecord, encode_record

PITCH_UM = 48.0


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A large surface.

    z_um : float32 array of shape (H, W)
    """

    z_um: Float32Array

    def seen(self, place: Pose, shape: tuple[int, int]) -> Float32Array:
        """What a press sees whose middle lies at a place (px from the middle of the target)."""
        row, column = np.meshgrid(*(np.arange(size) - 0.5 * (size - 1) for size in shape), indexing="ij")
        at = place.of(np.stack([row, column], axis=-1)) + 0.5 * (np.array(self.z_um.shape) - 1)
        return between_pixels(self.z_um, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32))


def rough_target(shape: tuple[int, int], seed: int = 3) -> Target:
    """Hills and texture that nowhere repeat."""
    random = np.random.default_rng(seed)
    z_um = np.zeros(shape, np.float32)
    for size_px, depth_um in ((40.0, 60.0), (12.0, 15.0), (4.0, 3.0)):
        field = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), size_px)
        z_um += np.float32(depth_um / field.std()) * field
    return Target(z_um)


def grid_places(rows: int, columns: int, step_px: tuple[float, float], random: np.random.Generator) -> list[Pose]:
    """Places of a grid as a hand finds them: half a millimetre and two degrees off."""
    return [
        Pose(
            (row - 0.5 * (rows - 1)) * step_px[0] + random.normal(0.0, 10.0),
            (column - 0.5 * (columns - 1)) * step_px[1] + random.normal(0.0, 10.0),
            float(np.radians(random.normal(0.0, 2.0))),
        )
        for row in range(rows)
        for column in range(columns)
    ]


def pressed(
    target: Target, place: Pose, shape: tuple[int, int], random: np.random.Generator, sigma_um: float = 1.0
) -> Float32Array:
    """One press: its own height and tilt, errors of long waves and noise."""
    z_um = target.seen(place, shape)
    row, column = np.meshgrid(*(np.linspace(-0.5, 0.5, size) for size in shape), indexing="ij")
    level = random.normal(0.0, 30.0) + random.normal(0.0, 40.0) * row + random.normal(0.0, 40.0) * column
    wave = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), 15.0)
    error = sigma_um * (0.8 * wave / wave.std() + 0.6 * random.standard_normal(shape))
    return np.asarray(z_um + level + error, np.float32)


def press_of_map(name: str, z_um: Float32Array, sigma_um: float = 1.0, pitch_um: float = PITCH_UM) -> Press:
    """A press that holds a map in memory."""
    return lazy_press(name, z_um.shape[0], z_um.shape[1], lambda: z_um, sigma_um, pitch_um)


def lazy_press(
    name: str,
    rows: int,
    columns: int,
    made: Callable[[], Float32Array],
    sigma_um: float = 1.0,
    pitch_um: float = PITCH_UM,
) -> Press:
    """A press whose map is made when it is read."""
    record = ResultRecord(
        name=name, rows=rows, columns=columns, pixel_pitch_um=pitch_um, height_zero="none: heights are relative"
    )

    def read() -> Fields:
        z_um = made()
        return Fields(z_um, np.where(np.isfinite(z_um), np.float32(sigma_um), np.float32(np.nan)))

    return Press(name, record, read)


def errors_px(found: list[Pose | None], truth: list[Pose], reach_px: float) -> Float64Array:
    """How far each place is off, px, once both are laid onto each other by the first that is known."""
    root = next(number for number, place in enumerate(found) if place is not None)
    base = found[root]
    assert base is not None
    return np.array(
        [
            np.nan if place is None else place.then(base.back()).distance(true.then(truth[root].back()), reach_px)
            for place, true in zip(found, truth, strict=True)
        ]
    )


def write_press(press: Press, folder: Path) -> Path:
    """The press as a result in a folder of its name."""
    place, fields = folder / press.name, press.read()
    place.mkdir(parents=True)
    write_field(place / HEIGHT_FILE, fields.z_um, press.record.pixel_pitch_um, "height, um")
    if fields.sigma_um is not None:
        write_field(place / HEIGHT_SIGMA_FILE, fields.sigma_um, press.record.pixel_pitch_um, "uncertainty, um")
    (place / RECORD_FILE).write_bytes(encode_record(press.record))
    return place
