"""The raw frame of a scan for other programs: DNG for raw converters, deflated TIFF for ImageJ and similar.

Counts are those of the sensor, unchanged; the description holds the scan's record as JSON.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
import tifffile

from device.bundles.record import encode_record
from device.bundles.scan import ScanBundle
from hal.frame import BayerOrder, RawFrame
from host_sync.export.surface_export import check_free, publish

RawFormat = Literal["dng", "tiff"]

_PLANE: Final = {"R": 0, "G": 1, "B": 2}
_BYTE, _ASCII, _SHORT, _RATIONAL, _SIGNED_RATIONAL = 1, 2, 3, 5, 10
_CFA: Final = 32803
_XYZ_TO_CAMERA: Final = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
"""Identity matrix: colours are those of the lights; no conversion to human vision is stated."""


def export_raw(scan: ScanBundle, form: RawFormat, folder: Path, *, overwrite: bool = False) -> Path:
    """Write the raw frame into `folder`; returns the file, `<scan id>.dng` or `<scan id>.tif`.

    Raises
    ------
    RecordError
        The scan is damaged; nothing is written.
    ExportError
        The folder cannot be written, or the file exists already.
    """
    scan.verify()
    frame = scan.raw_frame()
    write, suffix = _WRITERS[form]
    path = folder / f"{scan.scan_id}{suffix}"
    if not overwrite:
        check_free([path])
    publish(path, lambda file: write(file, frame, scan))
    return path


def write_dng(file: BinaryIO, frame: RawFrame, scan: ScanBundle) -> None:
    """Write a DNG 1.4: the Bayer mosaic, 16 bit, not compressed, with black and white levels and exposure."""
    black, white = round(frame.black_level_dn), round(frame.white_level_dn)
    exposure_us = round(frame.granted.exposure_us * 1000)
    tifffile.imwrite(
        file,
        frame.mosaic,
        photometric=_CFA,
        planarconfig=1,
        metadata=None,
        software="retrograph",
        description=encode_record(scan.record),
        extratags=[
            (271, _ASCII, 0, "Retrograph", True),
            (272, _ASCII, 0, scan.record.board, True),
            (274, _SHORT, 1, 1, True),
            (33421, _SHORT, 2, (2, 2), True),
            (33422, _BYTE, 4, _cfa_pattern(frame.bayer_order), True),
            (33434, _RATIONAL, 1, (exposure_us, 1_000_000_000), True),
            (50706, _BYTE, 4, bytes((1, 4, 0, 0)), True),
            (50707, _BYTE, 4, bytes((1, 1, 0, 0)), True),
            (50708, _ASCII, 0, f"Retrograph {scan.record.board}", True),
            (50710, _BYTE, 3, bytes((0, 1, 2)), True),
            (50711, _SHORT, 1, 1, True),
            (50713, _SHORT, 2, (2, 2), True),
            (50714, _SHORT, 4, (black,) * 4, True),
            (50717, _SHORT, 1, white, True),
            (50721, _SIGNED_RATIONAL, 9, _XYZ_TO_CAMERA, True),
            (50728, _RATIONAL, 3, (1, 1) * 3, True),
            (50778, _SHORT, 1, 0, True),
        ],
    )


def write_imagej_tiff(file: BinaryIO, frame: RawFrame, scan: ScanBundle) -> None:
    """Write the mosaic as one page of uint16, deflated, with the pixel pitch as its resolution."""
    per_cm = 1e4 / scan.record.pixel_pitch_um
    tifffile.imwrite(
        file,
        frame.mosaic,
        photometric="minisblack",
        compression="adobe_deflate",
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        metadata=None,
        software="retrograph",
        description=encode_record(scan.record),
    )


def _cfa_pattern(order: BayerOrder) -> bytes:
    return bytes(np.array([_PLANE[colour] for colour in order], np.uint8))


_WRITERS: Final[dict[RawFormat, tuple[Callable[[BinaryIO, RawFrame, ScanBundle], Any], str]]] = {
    "dng": (write_dng, ".dng"),
    "tiff": (write_imagej_tiff, ".tif"),
}
