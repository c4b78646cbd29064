"""A frame set as an importer finds it: what is known, what the user said, and what is still missing."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from device.balls.detector import MAX_CONTACT
from device.errors import OutputError
from device.io.atomic import write_output
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set_file import CALIBRATION_FOLDER, Encoding, names_a_folder
from host_sync.frames.image_file import read_info

LONGEST_NAME: Final = 90
SHOWN_EVERY: Final = 5
"""Every so many presses are listed as scans too: a calibration without a scan shows nothing."""

WIDEST_CIRCLE: Final = 1.25
"""Skin around a ball returns to rest within this multiple of the ball's radius: nobody draws a wider circle."""

Circle = tuple[float, float, float]
"""Centre (column, row) and radius of the trusted contact, pixels."""


@dataclass(frozen=True, slots=True)
class Said:
    """Values that the user gave, None where nothing: they precede those of files.

    pitch_down_um : the pixel pitch down a column, where it is not that along a row
    full_scale : count at which a pixel of 16 bit is saturated
    states_diameter : the ball was given by its diameter
    """

    pixel_pitch_um: float | None = None
    ball_radius_mm: float | None = None
    encoding: Encoding | None = None
    reference: Path | None = None
    pitch_down_um: float | None = None
    full_scale: int | None = None
    states_diameter: bool = False


@dataclass(frozen=True, slots=True)
class DraftPress:
    """A calibration press; its balls are found where there are no circles."""

    images: tuple[Path, ...]
    ball_radius_mm: float | None
    circles: tuple[Circle, ...] = ()
    grid_pitch_mm: float | None = None


@dataclass(frozen=True, slots=True)
class DraftScan:
    """A frame, and the maker's own height map of it where there is one."""

    name: str
    images: tuple[Path, ...]
    height_map: Path | None = None


@dataclass(frozen=True, slots=True)
class Draft:
    """A frame set.

    encoding : None where it is not known
    lights : of each grey image of a frame; empty for RGB images
    notes : what the user should know of the folder, one sentence each
    pitch_tolerance_um : the pixel pitch lies within ± this; None where that is not known
    pitch_down_um : the pixel pitch down a column, where it is not that along a row
    full_scale : count at which a pixel of 16 bit is saturated; None where it is not known
    states_diameters : balls are given by their diameters
    """

    name: str
    pixel_pitch_um: float | None
    encoding: Encoding | None
    reference: tuple[Path, ...]
    presses: tuple[DraftPress, ...]
    scans: tuple[DraftScan, ...]
    lights: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    pitch_tolerance_um: float | None = None
    pitch_down_um: float | None = None
    full_scale: int | None = None
    states_diameters: bool = False

    def pitch_of_field_um(self, field_mm: float) -> float:
        """Return the pixel pitch of images that show a field of this width.

        Raises
        ------
        FrameSetError
            There is no image, or the first one cannot be read.
        """
        images = [press.images[0] for press in self.presses] + [scan.images[0] for scan in self.scans]
        if not images:
            raise FrameSetError(f"{self.name}: holds no frames: name another folder")
        return 1e3 * field_mm / read_info(images[0]).shape[1]

    def without_copies(self) -> Draft:
        """Return the draft without presses that repeat an earlier one, and with a note that names them.

        Files are compared byte for byte.

        Raises
        ------
        FrameSetError
            A file cannot be read.
        """
        first: dict[tuple[object, ...], DraftPress] = {}
        kept: list[DraftPress] = []
        copies: list[tuple[Path, Path]] = []
        for press in self.presses:
            original = first.setdefault((*map(_digest, press.images), press.circles), press)
            if original is press:
                kept.append(press)
            else:
                copies.append((press.images[0], original.images[0]))
        if not copies:
            return self
        names = short_names([press.images[0] for press in self.presses])
        pairs = "; ".join(
            f"{names[copy]} is the same file as {names[original]}" if copy != original else f"{copy} is listed twice"
            for copy, original in copies[:3]
        )
        note = f"{pairs}{f' and {len(copies) - 3} more' if len(copies) > 3 else ''}: left out of the presses"
        return replace(self, presses=tuple(kept), notes=(*self.notes, note))

    def missing(self) -> list[str]:
        """Return the options that must be given, for what neither the files nor the user stated."""
        needs = []
        if self.pixel_pitch_um is None:
            needs.append(
                "--pixel-pitch-um (distance of neighbouring pixels on the skin) or --field-mm (the field's width)"
            )
        if any(press.ball_radius_mm is None for press in self.presses):
            needs.append("--ball-diameter-mm or --ball-radius-mm (of the calibration ball)")
        if self.encoding is None:
            needs.append("--encoding (linear or srgb: how pixel values encode light)")
        return needs

    def write(self, path: Path) -> None:
        """Write the frame set's file, which names images relative to its folder.

        Raises
        ------
        FrameSetError
            Something is missing, there is no frame, or the file exists.
        OutputError
            The file cannot be written.
        """
        if needs := self.missing():
            raise FrameSetError(f"{self.name}: not said by its files: give {', '.join(needs)}")
        if not self.presses and not self.scans:
            raise FrameSetError(f"{self.name}: holds no frames: name another folder")
        if path.exists() or path.is_symlink():
            raise FrameSetError(f"{path}: exists already: name another file with --out")
        try:
            text = "\n".join(self._lines(path.resolve().parent)).encode()
        except UnicodeEncodeError as error:
            raise FrameSetError(f"{self.name}: a file's name is not UTF-8: rename it") from error
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path} cannot be written ({error.strerror}): choose another place") from error
        write_output(path, text + b"\n")

    def _lines(self, folder: Path) -> list[str]:
        pitch = f"{self.pixel_pitch_um:.6g}"
        pitch = pitch if self.pitch_down_um is None else f"[{pitch}, {self.pitch_down_um:.6g}]"
        lines = [f"name = {_text(self.name)}", f"pixel_pitch_um = {pitch}"]
        if self.pitch_tolerance_um is not None:
            lines.append(f"pixel_pitch_tolerance_um = {self.pitch_tolerance_um:.3g}")
        lines.append(f"encoding = {_text(self.encoding or '')}")
        if self.full_scale is not None:
            lines.append(f"full_scale = {self.full_scale}")
        for light in self.lights:
            lines += ["", "[[light]]", f"name = {_text(light)}"]
        if self.reference:
            lines += ["", "[reference]", _image(self.reference, folder)]
        for press in self.presses:
            radius_mm = press.ball_radius_mm or 0.0
            ball = (
                f"ball_diameter_mm = {2.0 * radius_mm:.6g}"
                if self.states_diameters
                else f"ball_radius_mm = {radius_mm:.6g}"
            )
            lines += ["", "[[press]]", _image(press.images, folder), ball]
            if press.grid_pitch_mm:
                lines.append(f"grid_pitch_mm = {press.grid_pitch_mm:.6g}")
            if press.circles:
                balls = ", ".join(f"{{ x = {x:.2f}, y = {y:.2f}, r = {r:.2f} }}" for x, y, r in press.circles)
                lines.append(f"balls = [{balls}]")
        for scan, name in zip(self.scans, result_names([scan.name for scan in self.scans]), strict=True):
            lines += ["", "[[scan]]", f"name = {_text(name)}", _image(scan.images, folder)]
            if scan.height_map is not None:
                lines.append(f"# the maker's height map: {_text(_relative(scan.height_map, folder))}")
        return lines


def result_names(names: Sequence[str]) -> list[str]:
    """Return names of scans as `reconstruct` takes them for folders: other signs become hyphens, none comes twice."""
    taken = {CALIBRATION_FOLDER}
    found = []
    for name in names:
        plain = (
            re.sub(r"^[^\w]+|[^\w()+-]+$", "", re.sub(r"[^\w .()+-]", "-", name))[:LONGEST_NAME].rstrip(" .") or "scan"
        )
        plain = plain if names_a_folder(plain) else f"scan-{plain}"
        one, number = plain, 2
        while one.casefold() in taken:
            one, number = f"{plain}-{number}", number + 1
        taken.add(one.casefold())
        found.append(one)
    return found


def short_names(images: Sequence[Path]) -> dict[Path, str]:
    """Return each image's file name, or its path below the folder of all if a name occurs twice."""
    if len({image.name for image in images}) == len(set(images)):
        return {image: image.name for image in images}
    folder = os.path.commonpath([image.parent for image in images])
    return {image: Path(os.path.relpath(image, folder)).as_posix() for image in images}


def largest_contact_px(
    source: Path, drawn_px: Sequence[float], radius_mm: float | None, pitch_um: float | None
) -> float | None:
    """Return the largest radius of a contact of a ball that is trusted; None where ball or pitch is not known.

    drawn_px : radii of the circles that are drawn around balls

    Raises
    ------
    FrameSetError
        The middle circle is clearly wider than the ball; gives both radii.
    """
    if not radius_mm or not pitch_um:
        return None
    ball_px = radius_mm * 1e3 / pitch_um
    middle = sorted(drawn_px)[len(drawn_px) // 2] if drawn_px else 0.0
    if middle > WIDEST_CIRCLE * ball_px:
        raise FrameSetError(
            f"{source}: circles are drawn with a radius of {middle:.3g} px, and the ball has {ball_px:.3g} px: check "
            "the ball's radius and the pixel pitch"
        )
    return MAX_CONTACT * ball_px


def left_out(missing: Sequence[str]) -> tuple[str, ...]:
    """Return a note on images that a table lists and the folder does not hold."""
    if not missing:
        return ()
    count = "1 listed image is" if len(missing) == 1 else f"{len(missing)} listed images are"
    return (f"{count} not there and left out, such as {missing[0]}: fetch the whole folder",)


def inside(source: Path, name: str) -> Path:
    """Return the file of this name in a folder; of tables from Windows, with backslashes and letters of any case.

    Of a path on the computer that wrote the table, its end that is there.

    Raises
    ------
    FrameSetError
        The name leads out of the folder.
    """
    path = source / name
    if not path.exists():
        name = name.replace("\\", "/")
        path = source / _as_spelled(source, name)
        if re.match(r"[A-Za-z]:|/", name):
            ends = ("/".join(name.split("/")[start:]) for start in range(1, name.count("/") + 1))
            there = (place for end in ends if end and (place := source / _as_spelled(source, end)).exists())
            path = next(there, source / name.rpartition("/")[2])
    if not path.resolve().is_relative_to(source.resolve()):
        raise FrameSetError(f"{source}: {name!r} is outside of the folder: fetch the whole folder")
    return path


def _as_spelled(folder: Path, name: str) -> str:
    """Return the name with the case of the folders and files that are there; what is not there stays as it is."""
    at, parts = folder, []
    for part in name.split("/"):
        if part not in ("", ".", "..") and not (at / part).exists() and at.is_dir():
            part = next((one.name for one in at.iterdir() if one.name.casefold() == part.casefold()), part)
        parts.append(part)
        at = at / part
    return "/".join(parts)


def _digest(image: Path) -> bytes:
    try:
        with image.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise FrameSetError(f"{image}: cannot be read ({error.strerror}): fetch the whole folder") from error


def _image(images: Sequence[Path], folder: Path) -> str:
    names = [_text(_relative(image, folder)) for image in images]
    return f"image = {names[0]}" if len(names) == 1 else f"image = [{', '.join(names)}]"


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder)).as_posix()


def _text(value: str) -> str:
    """Return a basic string of TOML; JSON's escapes are the same for what file names hold."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
