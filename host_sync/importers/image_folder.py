"""Recordings that are a folder of RGB images, such as DIGIT's, GelSlim's, Taxim's raw frames, or numbered images.

Names decide first: background, blank, flat, ref or bg is untouched skin; cal or calib with a number, or else ball,
press, sphere, bead, sample or Im, is a calibration press. Where they do not, the largest group of numbered images are
presses if a ball shows in them, and one called frame0 or 0 is untouched skin if it looks like the others where nothing
touches.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.balls.detector import BallSearch
from device.errors import DeviceError
from device.imaging.flat_field import LinearFrame, NormalizedImage, flat_field_correct
from device.surface import Float32Array
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.located_presses import (
    ONE_LIGHT,
    ONE_LIGHT_WORDS,
    colour_over_brightness,
    flat_field_of,
    locate_usable,
)
from host_sync.calibration.radii import FittingRadius, fitting_radius
from host_sync.calibration_file.inputs import press_frame, stand_ins
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, FrameSpec
from host_sync.frames.image_file import read_info
from host_sync.frames.linear_light import read_frame
from host_sync.frames.sequence import SUFFIXES, natural_order
from host_sync.importers.draft import SHOWN_EVERY, Draft, DraftPress, DraftScan, Said

AT_REST: Final = re.compile(r"(background|blank|flat|ref|reference|bg|untouched)([-_ ]?\w+)?", re.IGNORECASE)
FIRST: Final = re.compile(r"(frame|ball|im|image|img)?[-_ ]?0+", re.IGNORECASE)
"""Names that many programs give to the image of untouched skin, and as many to the first press."""

CALIBRATES: Final = re.compile(r"^cal(i|ib|ibration)?[-_ ]?\d", re.IGNORECASE)
PRESSED: Final = re.compile(r"ball|press|sphere|bead|^sample|^im[-_ ]?\d", re.IGNORECASE)
MOVIES: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm")
CONTACT_SHEET: Final = "frameset-balls.png"
MIN_GROUP: Final = 3
COMPARED: Final = 12
"""So many images of a group are looked at."""

ALIKE: Final = 0.1
"""Median difference of brightness up to which two frames are of one exposure, share."""


def import_images(source: Path, said: Said) -> Draft:
    """Return a folder of RGB images.

    Raises
    ------
    FrameSetError
        It holds no images.
    """
    images = (one for one in source.iterdir() if one.suffix.lower() in SUFFIXES and one.name[0] != ".")
    found = sorted((one for one in images if one.name != CONTACT_SHEET), key=natural_order)
    if not found:
        _check_movies(source)
        raise FrameSetError(f"{source}: holds no PNG, TIFF or JPEG images: name the folder of the frames")
    files, notes = _of_one_size(found)
    rest = said.reference or next((one for one in files if AT_REST.fullmatch(one.stem)), None)
    frames = [one for one in files if rest is None or one.resolve() != rest.resolve()]
    pressed = [one for one in frames if CALIBRATES.search(one.stem)]
    pressed = pressed or [one for one in frames if PRESSED.search(one.stem)]
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
    """Return the images of the commonest size, and a note on others."""
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
    """Return the largest group of images whose names differ in numbers only; empty where all are small."""
    groups: dict[str, list[Path]] = {}
    for one in files:
        if re.search(r"\d", one.stem):
            groups.setdefault(re.sub(r"\d+", "#", one.stem).casefold(), []).append(one)
    largest = max(groups.values(), key=len, default=[])
    return largest if len(largest) >= MIN_GROUP else []


def _spread(files: Sequence[Path]) -> list[Path]:
    """Return at most `COMPARED` of the files, spread evenly."""
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
    """Return linear light of an image reduced to some 100 pixels."""
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


# A first look at the presses of a folder: where balls show, and of which radius, before anything is calibrated.

ENOUGH: Final = 0.34
"""Share of the images that show a ball from which they are presses."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPress:
    """Balls of a press, or the reason why none is visible."""

    frame: LinearFrame | None
    search: BallSearch
    fault: str


def look_at(frame_set: FrameSet, at_most: int) -> Iterator[SeenPress]:
    """Yield the first presses of a frame set with the balls that calibration uses; frames are read one at a time.

    Raises
    ------
    FrameSetError
        The reference cannot be read.
    """
    specs = [*(press.frame for press in frame_set.presses), *stand_ins(frame_set)]
    flat_field = _flat_field(specs, frame_set.reference)
    for spec in frame_set.presses[:at_most]:
        try:
            press = press_frame(spec, frame_set)
        except FrameSetError as error:
            yield SeenPress(None, BallSearch((), ()), str(error))
            continue
        yield _seen(replace(press, frame=_three_lights(press.frame)), flat_field)


def survey_radius(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> FittingRadius | None:
    """Return the ball radius that fits what frames of the reference's size show; None where none fits."""
    flat_field = _flat_field(frames, reference)
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if flat_field is not None and frame.rgb.shape == flat_field.shape]
    return fitting_radius([flat_field_correct(frame, flat_field) for frame in same if flat_field is not None])


def shows_balls(images: Sequence[Path], reference: Path | None) -> bool:
    """Return whether enough of these images show a ball, of whatever radius, that they are calibration presses."""
    at_rest = FrameSpec((reference,), "srgb") if reference else None
    best = survey_radius([FrameSpec((image,), "srgb", at_rest=at_rest) for image in images], at_rest)
    return best is not None and best.presses >= ENOUGH * best.looked_at


def _flat_field(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> Float32Array | None:
    """Return what frames are divided by; None where no frame can be read."""
    if reference is not None:
        return flat_field_of((), _three_lights(read_frame(reference)))
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if frame.shape == readable[0].shape]
    return flat_field_of(same, None) if same else None


def _readable(spec: FrameSpec) -> LinearFrame | None:
    try:
        return _three_lights(read_frame(spec))
    except FrameSetError:
        return None


def _three_lights(frame: LinearFrame) -> LinearFrame:
    """Return the frame; of more than three lights, three that are spread over them: balls show in any three."""
    lights = frame.rgb.shape[-1]
    if lights <= 3:
        return frame
    spread = np.ascontiguousarray(frame.rgb[..., [0, lights // 3, 2 * lights // 3]])
    return LinearFrame(spread, frame.clipped)


def _seen(press: PressFrame, flat_field: Float32Array | None) -> SeenPress:
    """Return the balls of a frame; what keeps any from being found is its fault."""
    frame, nothing = press.frame, BallSearch((), ())
    if frame.rgb.shape[-1] < 3:
        return SeenPress(frame, nothing, "fewer than three lights do not distinguish a ball from a shadow")
    if flat_field is None or flat_field.shape != frame.rgb.shape:
        return SeenPress(frame, nothing, "its size is not that of the reference")
    try:
        used = locate_usable(press, flat_field)
    except DeviceError as error:
        return SeenPress(frame, nothing, str(error).removeprefix(f"{press.label}: "))
    seen = used.seen or nothing
    return SeenPress(frame, seen if press.balls else BallSearch(used.balls, used.rejected), used.error)
