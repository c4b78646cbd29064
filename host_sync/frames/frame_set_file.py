"""The file `frameset.toml`: its tables and keys, before any image is read."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from hal.validation import accepted_at, decode_toml, split_validation
from host_sync.errors import FrameSetError

Encoding = Literal["linear", "srgb"]
SET_FILE: Final = "frameset.toml"
CALIBRATION_FOLDER: Final = "calibration"
"""Folder of the calibration report beside the scans; no scan may have this name."""

MAX_LIGHTS: Final = 8
"""No frame shows more."""

_SCAN_NAME: Final = re.compile(r"\w([\w .()+-]{0,98}[\w()+-])?")
_DEVICE: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)

NO_CONTROLS: Final = r"^[^\0-\x1f]*$"
"""A path with a control character was written with backslashes, which begin an escape in TOML."""

Length = Annotated[float, msgspec.Meta(gt=0, le=1e6)]
# msgspec reads memory that is not its own where a fixed tuple and a bounded number are alternatives.
PixelPitch = Length | Annotated[tuple[Length, ...], msgspec.Meta(min_length=2, max_length=2)]
Tolerance = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
Coordinate = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
Height = Annotated[float, msgspec.Meta(gt=0, le=1e4)]
ImagePath = Annotated[str, msgspec.Meta(pattern=NO_CONTROLS)]
ImageNames = ImagePath | Annotated[tuple[ImagePath, ...], msgspec.Meta(min_length=1, max_length=MAX_LIGHTS)]
"""An RGB image, or one grey image a light; three are read as R, G, B."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file; unknown keys are refused."""


class BallTable(_Table, frozen=True):
    """A labelled ball: centre and radius of its trusted contact, pixels."""

    x: float
    y: float
    r: Length


class ReferenceTable(_Table, frozen=True):
    """The frame of untouched skin."""

    image: ImageNames


class PressTable(_Table, frozen=True):
    """A calibration press and its balls.

    ball_radius_mm, ball_diameter_mm : of the ball; one of them is stated
    ball_radius_tolerance_mm : tolerance of the radius
    grid_pitch_mm : distance of neighbouring balls when they form a square grid
    grid_pitch_tolerance_mm : its tolerance
    """

    image: ImageNames
    ball_radius_mm: Length | None = None
    ball_diameter_mm: Length | None = None
    ball_radius_tolerance_mm: Tolerance | None = None
    balls: Annotated[tuple[BallTable, ...], msgspec.Meta(min_length=1)] | None = None
    grid_pitch_mm: Length | None = None
    grid_pitch_tolerance_mm: Tolerance | None = None

    @property
    def radius_mm(self) -> float:
        """The ball's radius, by whichever of the two lengths is stated."""
        return self.ball_radius_mm or (self.ball_diameter_mm or math.nan) / 2.0


class LightTable(_Table, frozen=True):
    """A light, in the order of the images; what is said of it appears in messages."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=40)]
    colour: Annotated[str, msgspec.Meta(max_length=40)] = ""
    position_mm: tuple[Coordinate, Coordinate, Height] | None = None


class ScanTable(_Table, frozen=True):
    """A frame to reconstruct."""

    name: str
    image: ImageNames


class FileTable(_Table, frozen=True):
    """The whole file.

    pixel_pitch_um : of pixels that are not square, along a row and down a column
    pixel_pitch_tolerance_um : the pitch lies within ± this
    full_scale : count at which a pixel of 16 bit is saturated
    pupil_height_mm : height of the camera's entrance pupil over the untouched skin, as rays inside the gel see it
    """

    name: str
    pixel_pitch_um: PixelPitch
    encoding: Encoding
    pixel_pitch_tolerance_um: Tolerance | None = None
    full_scale: Annotated[int, msgspec.Meta(ge=255, le=65535)] | None = None
    pupil_height_mm: Length | None = None
    light: Annotated[tuple[LightTable, ...], msgspec.Meta(max_length=MAX_LIGHTS)] = ()
    reference: ReferenceTable | None = None
    press: tuple[PressTable, ...] = ()
    scan: tuple[ScanTable, ...] = ()


def names_a_folder(name: str) -> bool:
    """Return whether a folder may have this name on every system; Windows keeps some names for devices."""
    return _SCAN_NAME.fullmatch(name) is not None and _DEVICE.fullmatch(name) is None


def set_file(path: Path) -> Path:
    """Return the file of a frame set; of a folder, the one that it holds under the usual name."""
    inside = path / SET_FILE
    return inside if path.is_dir() and inside.is_file() else path


def read_frame_set_file(path: Path, *, calibrates: bool = True) -> FileTable:
    """Return tables of a frame set, each key checked; no image is read.

    calibrates : refuse a set without a calibration press

    Raises
    ------
    FrameSetError
        Names the file, the key and what is wrong with it.
    """
    file = _decode(path)
    _check_lists(file, path, calibrates=calibrates)
    return file


def _decode(path: Path) -> FileTable:
    try:
        return decode_toml(path.read_bytes(), FileTable)
    except IsADirectoryError as error:
        raise FrameSetError(f"{path}: holds no {SET_FILE}: `retrosync import` describes its images") from error
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): name a {SET_FILE}") from error
    except msgspec.ValidationError as error:
        key, problem = split_validation(error)
        if key == "encoding":
            problem = f"{problem}; accepted: 'linear', 'srgb'"
        elif key and problem.partition(" is not a key")[0] in FileTable.__struct_fields__[1:]:
            problem = f"{problem} of this table: write it above the first line that begins with ["
        elif problem.endswith(" is not a key"):
            problem = f"{problem}; accepted: {accepted_at(FileTable, key)}"
        elif key in ("press", "scan", "light") and problem.startswith("is a table"):
            problem = f"{problem}: write [[{key}]]"
        elif key == "reference" and problem.startswith("is a "):
            problem = f'{problem}: write [reference] once, and below it image = "flat.png"'
        elif key == "pixel_pitch_um" and problem.startswith("is too long"):
            problem = f"{problem}: write decimal points, such as [20.5, 21.0]"
        raise FrameSetError(": ".join([str(path), key, problem] if key else [str(path), problem])) from error
    except msgspec.DecodeError as error:
        raise FrameSetError(f"{path}: {error}") from error


def image_path(folder: Path, name: str) -> Path:
    """Return the path of an image of a frame set; backslashes separate folders where no file has one in its name."""
    path = folder / name
    return folder / name.replace("\\", "/") if "\\" in name and not path.exists() else path


def _check_lists(file: FileTable, path: Path, *, calibrates: bool) -> None:
    if calibrates and not file.press:
        raise FrameSetError(f"{path}: press: missing: add a [[press]] table for each calibration press")
    for i, press in enumerate(file.press):
        if (press.ball_radius_mm is None) == (press.ball_diameter_mm is None):
            found = "missing" if press.ball_radius_mm is None else "stated beside ball_diameter_mm"
            raise FrameSetError(f"{path}: press[{i}].ball_radius_mm: {found}: state it, or ball_diameter_mm")
    if not file.scan:
        raise FrameSetError(f"{path}: scan: missing: add a [[scan]] table for each frame to reconstruct")
    seen: set[str] = set()
    for i, scan in enumerate(file.scan):
        if not names_a_folder(scan.name) or scan.name.casefold() == CALIBRATION_FOLDER:
            raise FrameSetError(
                f"{path}: scan[{i}].name: {scan.name!r} cannot name a result folder: "
                f"use letters, digits, spaces and . ( ) + - _ between them, and not {CALIBRATION_FOLDER!r}"
            )
        if scan.name.casefold() in seen:
            raise FrameSetError(f"{path}: scan[{i}].name: {scan.name!r} is used twice: give each scan its own name")
        seen.add(scan.name.casefold())
