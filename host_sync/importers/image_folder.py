"""Recordings that are a folder of RGB images, such as DIGIT's, GelSlim's, Taxim's raw frames, or numbered images.

Names tell first: background, blank, flat, ref or bg is untouched skin; ball, press, sphere, bead, sample, cal or Im is
a calibration press. Where they do not, the largest group of numbered images are presses if a ball shows in them, and
one called frame0 or 0 is untouched skin if it looks like the others do where nothing touches.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array
from host_sync.calibration.located_presses import ONE_LIGHT, ONE_LIGHT_WORDS, colour_over_brightness
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.image_file import read_info
from host_sync.frames.linear_light import read_frame
from host_sync.frames.sequence import SUFFIXES, natural_order
from host_sync.importers.ball_survey import shows_balls
from host_sync.importers.draft import SHOWN_EVERY, Draft, DraftPress, DraftScan, Said

AT_REST: Final = re.compile(r"(background|blank|flat|ref|reference|bg|untouched)([-_ ]?\w+)?", re.IGNORECASE)
FIRST: Final = re.compile(r"(frame|ball|im|image|img)?[-_ ]?0+", re.IGNORECASE)
"""Names that many programs give to the image of untouched skin, and as many to the first press."""

PRESSED: Final = re.compile(r"ball|press|sphere|bead|^sample|^cal[-_ ]?\d|^im[-_ ]?\d", re.IGNORECASE)
MOVIES: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm")
MIN_GROUP: Final = 3
COMPARED: Final = 12
"""So many images of a group are looked at."""

ALIKE: Final = 0.1
"""Median difference of brightness up to which two frames are of one exposure, share."""


def import_images(source: Path, said: Said) -> Draft:
    """A folder of RGB images.

    Raises
    ------
    FrameSetError
        It holds no images.
    """
    found = sorted(
        (one for one in source.iterdir() if one.suffix.lower() in SUFFIXES and one.name[0] != "."), key=natural_order
    )
    if not found:
        _check_movies(source)
        raise FrameSetError(f"{source}: holds no PNG, TIFF or JPEG images: name the folder of the frames")
    files, notes = _of_one_size(found)
    rest = said.reference or next((one for one in files if AT_REST.fullmatch(one.stem)), None)
    frames = [one for one in files if rest is None or one.resolve() != rest.resolve()]
    pressed = [one for one in frames if PRESSED.search(one.stem)]
    group = pressed or _largest_group(frames)
    first = next((one for one in frames if FIRST.fullmatch(one.stem)), None) if rest is None else None
    if first is not None and len(group) >= MIN_GROUP:
        others = [one for one in group if one != first]
        alike = _compared(first, others)
        if alike != "a press":
            rest = first if alike == "untouched" else None
            group, frames = others, [one for one in frames if one != first]
        if rest is None:
            notes = (*notes, f"{first.name} is not taken as untouched skin: it looks like {alike}")
    if not pressed and rest != first and not shows_balls(_spread(group), rest):
        group = []
    if not group and _show_one_light(frames if rest is None else [rest, *frames]):
        notes = (*notes, f"no frame is a press: {ONE_LIGHT_WORDS}")
    others = [one for one in frames if one not in group]
    shown = [*group[::SHOWN_EVERY], *others] if not pressed else frames
    return Draft(
        name=source.resolve().name,
        pixel_pitch_um=said.pixel_pitch_um,
        encoding=said.encoding,
        reference=(rest,) if rest else (),
        presses=tuple(DraftPress((one,), said.ball_radius_mm) for one in group),
        scans=tuple(DraftScan(one.stem, (one,)) for one in shown),
        notes=notes,
    )


def _of_one_size(files: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """The images of the commonest size, and a note on others."""
    sizes: dict[Path, tuple[int, int] | None] = {}
    for one in files:
        try:
            sizes[one] = read_info(one).shape
        except FrameSetError:
            sizes[one] = None
    counts = Counter(size for size in sizes.values() if size is not None)
    if not counts:
        return list(files), ()
    size = counts.most_common(1)[0][0]
    other = [one.name for one in files if sizes[one] != size]
    note = f"{len(other)} of {len(files)} images are not {size[1]}x{size[0]} pixels, or not whole, and left out"
    return [one for one in files if sizes[one] == size], (f"{note}, such as {other[0]}",) if other else ()


def _largest_group(files: Sequence[Path]) -> list[Path]:
    """The images whose names differ in numbers only, of the largest such group; none where all groups are small."""
    groups: dict[str, list[Path]] = {}
    for one in files:
        if re.search(r"\d", one.stem):
            groups.setdefault(re.sub(r"\d+", "#", one.stem).casefold(), []).append(one)
    largest = max(groups.values(), key=len, default=[])
    return largest if len(largest) >= MIN_GROUP else []


def _spread(files: Sequence[Path]) -> list[Path]:
    """At most `COMPARED` of them, spread evenly."""
    count = min(len(files), COMPARED)
    return [files[number * len(files) // count] for number in range(count)]


def _compared(image: Path, presses: Sequence[Path]) -> str:
    """Return whether an image looks "untouched", like "a press", or like a frame of "another exposure", beside presses.

    The median of many presses shows mostly untouched skin: what differs from it in one place is a press.
    """
    try:
        middle = np.median([_small(one) for one in _spread(presses)], axis=0)
        ratio = np.log(_small(image) / middle)
        usual = np.median([_marked_change(np.log(_small(one) / middle)) for one in _spread(presses)], axis=0)
    except (FrameSetError, ValueError):
        return "another exposure"
    change, over_rest = _marked_change(ratio)
    if change > 0.5 * usual[0] and over_rest > 0.35 * usual[1]:
        return "a press"
    return "another exposure" if float(np.median(np.abs(ratio))) > ALIKE else "untouched"


def _small(image: Path) -> Float32Array:
    """Linear light of an image reduced to some 100 pixels."""
    frame = read_frame(FrameSpec((image,), "srgb")).rgb
    step = max(1, min(frame.shape[:2]) // 100)
    rows, columns = (size // step * step for size in frame.shape[:2])
    blocks = frame[:rows, :columns].reshape(rows // step, step, columns // step, step, -1)
    return np.asarray(np.maximum(blocks.mean(axis=(1, 3)), 1e-3), np.float32)


def _show_one_light(images: Sequence[Path]) -> bool:
    """Return whether what changes from frame to frame changes alike in all channels, as under white lights."""
    try:
        small = [_small(one) for one in _spread(images)]
        middle = np.median(small, axis=0)
    except (FrameSetError, ValueError):
        return False
    seen = np.ones(middle.shape[:2], np.bool_)
    ratios = [NormalizedImage(np.asarray(one / middle, np.float32), seen, ~seen) for one in small]
    return len(small) > 1 and float(np.median([colour_over_brightness(ratio) for ratio in ratios])) < ONE_LIGHT


def _marked_change(ratio: Float32Array) -> tuple[float, float]:
    """Return how far colour differs from its surroundings where it does so most, and that over what is usual."""
    colour = ratio - ratio.mean(axis=-1, keepdims=True)
    near = cv2.GaussianBlur(colour, (0, 0), 2.0) - cv2.GaussianBlur(colour, (0, 0), 12.0)
    size = np.linalg.norm(near, axis=-1)
    most = float(np.percentile(size, 98.0))
    return most, most / max(float(np.median(size)), 1e-9)


def _check_movies(source: Path) -> None:
    """Say that movies are not read where a folder holds nothing else.

    Raises
    ------
    FrameSetError
        Names the first one, and how its frames become images.
    """
    movie = next((one for one in sorted(source.iterdir()) if one.suffix.lower() in MOVIES), None)
    if movie is not None:
        raise FrameSetError(
            f"{movie}: a movie does not say which frames are presses: save its frames as images, for example with "
            f"ffmpeg -i {movie.name} frame-%04d.png, and call those of the ball ball-…"
        )
