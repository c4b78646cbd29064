"""The raw stream that a camera granted: unpacked and as the profile states, or refused with the reason."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import LibcameraConfig, SensorConfig
from hal.errors import CameraError
from hal.frame import AS_GRANTED, BayerOrder

_UNPACKED: Final = re.compile(r"S(RGGB|BGGR|GRBG|GBRG)(8|10|12|14|16)")
_ANY_ORDER: Final[BayerOrder] = "RGGB"
"""libcamera adjusts a raw format of another order than the sensor's to the sensor's."""

_METADATA_BITS: Final = 16
"""libcamera states black levels at this number of bits for every sensor."""


NO_RAW: Final = "no raw stream, as a USB or virtual camera: use a sensor on the board's own connector"


def requested_format(sensor: SensorConfig, config: LibcameraConfig) -> str:
    """libcamera's name of the unpacked format in the profile, such as "SRGGB12"; any order if as granted."""
    order = _ANY_ORDER if sensor.bayer_order == AS_GRANTED else sensor.bayer_order
    return f"S{order}{config.raw_bits}"


@dataclass(frozen=True, slots=True)
class RawStream:
    """The granted raw stream: size in pixels, stride in bytes, and how to read its counts."""

    rows: int
    columns: int
    stride: int
    bits: int
    bayer_order: BayerOrder

    @classmethod
    def granted(cls, stream: Mapping[str, Any], sensor: SensorConfig, config: LibcameraConfig) -> RawStream:
        """The stream of a camera configuration, checked against the profile.

        Raises
        ------
        CameraError
            It is compressed or packed, or differs from the profile in size, bits or a stated Bayer order.
        """
        if not stream:
            raise CameraError(f"the camera grants {NO_RAW}")
        name = str(stream["format"])
        if "PISP_COMP" in name:
            raise CameraError(
                f"the camera grants {name}, which loses counts: ask for an unpacked format (libcamera.raw_bits = 16)"
            )
        if name.endswith("_CSI2P"):
            raise CameraError(f"the camera grants the packed format {name}: set libcamera.raw_bits to an unpacked one")
        match = _UNPACKED.fullmatch(name)
        if match is None:
            raise CameraError(
                f"the camera grants {name}, which is not a raw colour format: check libcamera.camera_id and its cable"
            )
        columns, rows = stream["size"]
        order, bits = cast(BayerOrder, match[1]), int(match[2])
        for key, found, stated in (
            ("sensor.bayer_order", order, order if sensor.bayer_order == AS_GRANTED else sensor.bayer_order),
            ("libcamera.raw_bits", bits, config.raw_bits),
            ("sensor.columns, sensor.rows", (columns, rows), (sensor.columns, sensor.rows)),
        ):
            if found != stated:
                also = ', or say "as granted"' if key == "sensor.bayer_order" else ""
                raise CameraError(f"the camera grants {found} but the board profile says {stated}: correct {key}{also}")
        return cls(rows, columns, int(stream["stride"]), bits, order)

    def mosaic(self, buffer: NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Counts without the padding of the stride, uint16 array of shape (H, W), from bytes of shape (H, stride).

        Raises
        ------
        CameraError
            The frame has another size than was granted.
        """
        if buffer.shape != (self.rows, self.stride):
            raise CameraError(
                f"the camera delivers {buffer.shape[0]} rows of {buffer.shape[-1]} bytes where it granted "
                f"{self.rows} of {self.stride}: restart it"
            )
        if self.bits == 8:
            return buffer[:, : self.columns].astype(np.uint16)
        return np.ascontiguousarray(buffer.view(np.uint16)[:, : self.columns])

    def black_level_dn(self, metadata: Mapping[str, Any]) -> float:
        """Mean black level from a frame's metadata, in counts of this stream.

        Raises
        ------
        CameraError
            The metadata has none.
        """
        levels = metadata.get("SensorBlackLevels")
        if not levels:
            raise CameraError("the frame's metadata has no SensorBlackLevels: the camera's tuning file is missing")
        return float(np.mean(levels)) / 2.0 ** (_METADATA_BITS - self.bits)
