"""Recognition of the program that wrote a folder by its contents, and the contact sheet of what was imported.

The sheet shows every press, with the balls that are found in it or given for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from matplotlib.figure import Figure

from device.balls.sphere import Ball
from device.io.atomic import write_output
from host_sync.calibration.assessment import diameter_note
from host_sync.calibration.located_presses import mend_of_radius
from host_sync.calibration.preparation import pictures_across
from host_sync.calibration_report.overview import ShownPress, draw_sheet, reduced_picture, sheet_height_in
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, PressSpec
from host_sync.frames.sequence import SUFFIXES
from host_sync.importers.ball_tables import (
    ANNOTATIONS,
    CATALOGUE,
    PACK,
    find_circle_table,
    import_annotated,
    import_gs_sdk,
    import_py3dcal,
    import_taxim,
)
from host_sync.importers.draft import Draft, Said, short_names
from host_sync.importers.gelsight_scan import SCAN_FILE, import_gelsight
from host_sync.importers.image_folder import MOVIES, SeenPress, import_images, look_at, survey_radius
from host_sync.light_groups import CHANNELS
from host_sync.render.picture_file import figure_png

Kind = Literal["gelsight", "gs_sdk", "py3dcal", "taxim", "fots", "digit", "images"]

IMPORTERS: Final[dict[Kind, Callable[[Path, Said], Draft]]] = {
    "gelsight": import_gelsight,
    "gs_sdk": import_gs_sdk,
    "py3dcal": import_py3dcal,
    "taxim": import_taxim,
    "fots": import_annotated,
    "digit": import_images,
    "images": import_images,
}

WRITTEN_BY: Final[dict[Kind, str]] = {
    "gelsight": "scans of GelSight's programs",
    "gs_sdk": "a calibration of gs_sdk",
    "py3dcal": "a calibration of py3DCal",
    "taxim": "a data pack of Taxim",
    "fots": "annotated circles of FOTS or digit-depth",
    "digit": "a folder of images",
    "images": "a folder of images",
}

OTHER_IMAGES: Final = (".bmp", ".webp", ".gif", ".heic", ".jp2", ".ppm", ".jls")


def recognize(source: Path) -> Kind:
    """Return the kind of a folder, by the files that it holds.

    Raises
    ------
    FrameSetError
        Nothing in it is known; says what is.
    """
    if (source / SCAN_FILE).is_file() or any(source.glob(f"*/{SCAN_FILE}")):
        return "gelsight"
    if (source / CATALOGUE).is_file():
        return "gs_sdk"
    if (source / ANNOTATIONS).is_file():
        return "py3dcal"
    if (source / PACK).is_file():
        return "taxim"
    if find_circle_table(source) is not None:
        return "fots"
    if any(one.suffix.lower() in (*SUFFIXES, *MOVIES) for one in source.iterdir()):
        return "images"
    if any(one.suffix.lower() in OTHER_IMAGES for one in source.iterdir()):
        raise FrameSetError(f"{source}: holds images of a kind that is not read: save them as PNG, TIFF or JPEG")
    inner = next((one for one in sorted(source.iterdir()) if one.is_dir() and _is_known(one)), None)
    hint = f"; {inner} is one" if inner else ""
    raise FrameSetError(
        f"{source}: holds no images, and no {SCAN_FILE}, {CATALOGUE}, {ANNOTATIONS}, {PACK} or table of circles: name "
        f"the folder that holds them{hint}"
    )


def read_folder(source: Path, kind: Kind, said: Said) -> Draft:
    """Return the draft of a folder of this kind, without copies of presses, and with what the user stated.

    Raises
    ------
    FrameSetError
        As for the kind's importer, or a file cannot be read.
    """
    draft = IMPORTERS[kind](source, said).without_copies()
    return replace(
        draft,
        pitch_down_um=said.pitch_down_um,
        full_scale=said.full_scale,
        states_diameters=said.states_diameter or draft.states_diameters,
    )


def _is_known(folder: Path) -> bool:
    try:
        return recognize(folder) is not None
    except (FrameSetError, OSError):
        return False


# Contact sheet of what was imported.

WIDTH_IN: Final = 14.0

HEAD_IN: Final = 0.45

DPI: Final = 120

MAX_SHEET_PRESSES: Final = 100
"""A sheet of more would show nothing of each."""

SAME_RADIUS_FACTOR: Final = 1.25
"""Up to this factor another radius is the same one: contacts do not distinguish them."""


def write_contact_sheet(frame_set: FrameSet, path: Path) -> tuple[str, ...]:
    """Find the balls of a frame set's presses and draw them; returns what the user should know, a sentence each.

    Raises
    ------
    FrameSetError
        The reference cannot be read, or frames show too few lights.
    OutputError
        The picture cannot be written.
    """
    presses = frame_set.presses[:MAX_SHEET_PRESSES]
    width_px = int(WIDTH_IN * DPI / pictures_across(len(presses)))
    shown = []
    names = short_names([press.frame.images[0] for press in presses])
    for press, found in zip(presses, look_at(frame_set, MAX_SHEET_PRESSES), strict=True):
        if found.frame is not None and found.frame.rgb.shape[2] < CHANNELS:
            raise FrameSetError(f"{press.frame.images[0]}: is grey: give frames of three lights or more, as RGB images")
        shown.append(_shown(names[press.frame.images[0]], press, found, frame_set.shape, width_px))
    figure = Figure(figsize=(WIDTH_IN, HEAD_IN + sheet_height_in(shown, WIDTH_IN)))
    draw_sheet(figure, shown, WIDTH_IN, HEAD_IN)
    used = sum(one.is_used for one in shown)
    of = f"{used} of {len(shown)} presses show a ball"
    title = f"{of} (white: found, blue: given; circle: contact; x: refused, the title says why)"
    figure.suptitle(title, y=1.0 - 0.1 / figure.get_figheight(), va="top", fontsize=11)
    write_output(path, figure_png(figure, DPI))
    return (f"{of}: {path}", *_reasons(shown), *_other_radius(frame_set, presses, used), *_diameter(frame_set, shown))


def _shown(name: str, press: PressSpec, seen: SeenPress, shape: tuple[int, int], width_px: int) -> ShownPress:
    picture = None if seen.frame is None else reduced_picture(seen.frame.rgb, width_px)
    given: tuple[Ball, ...] = press.balls or ()
    if given:
        apart = [_nearest(ball, seen.search.found) for ball in given]
        words = "given; none is found there" if None in apart else "given, and found there"
        return ShownPress(name, shape, picture, (), (), words, given)
    if seen.search.found:
        return ShownPress(name, shape, picture, seen.search.found, seen.search.rejected, "found")
    return ShownPress(name, shape, picture, (), seen.search.rejected, seen.fault)


def _nearest(ball: Ball, found: Sequence[Ball]) -> Ball | None:
    reach = 0.5 * ball.contact_radius_px
    near = [one for one in found if abs(one.column - ball.column) < reach and abs(one.row - ball.row) < reach]
    return near[0] if near else None


def _reasons(shown: Sequence[ShownPress]) -> tuple[str, ...]:
    """Return why presses show no ball, the commonest reason first, each with the images."""
    refused = [one for one in shown if not one.is_used]
    counts = Counter(one.words for one in refused)
    lines = []
    for words, count in counts.most_common(3):
        names = [one.name for one in refused if one.words == words]
        lines.append(f"{', '.join(names[:3])}{f' and {count - 3} more' if count > 3 else ''}: {words}")
    return tuple(lines)


def _diameter(frame_set: FrameSet, shown: Sequence[ShownPress]) -> list[str]:
    """Return the question whether the diameter was given as the radius, where every contact is narrow."""
    balls = [ball for one in shown for ball in (*one.balls, *one.given)]
    if frame_set.states_diameters or not balls:
        return []
    return diameter_note(max(ball.contact_radius_px / ball.radius_px for ball in balls))


def _other_radius(frame_set: FrameSet, presses: Sequence[PressSpec], used: int) -> tuple[str, ...]:
    """Return a hint where another radius than the one stated shows in more presses."""
    if 2 * used >= len(presses):
        return ()
    best = survey_radius([press.frame for press in presses[:: max(1, len(presses) // 12)]], frame_set.reference)
    stated = presses[0].radius_px
    if best is None or best.presses < 2 or best.presses * len(presses) <= used * best.looked_at:
        return ()
    ratio = best.radius_px / stated
    if 1.0 / SAME_RADIUS_FACTOR < ratio < SAME_RADIUS_FACTOR:
        return ()
    words = best.sentence(frame_set.pixel_pitch_um, stated).capitalize()
    return (f"{words}: {mend_of_radius(ratio, '--ball-radius-mm', '--pixel-pitch-um')}",)
