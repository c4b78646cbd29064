"""`retroscan cover`: an area larger than the field, press by press; every press is a scan for `retrosync mosaic`."""

from __future__ import annotations

from itertools import count
from typing import Annotated, Any, Final

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from device.acquisition.gel_profile import with_active_gel
from device.acquisition.instrument_lock import open_exclusive
from device.acquisition.scanner import Scanner
from device.cli.console import Count, Given, open_store, print_json, print_line, print_note, store_folder
from device.cli.instrument_commands import Labels, annotations_of, cue_lift
from device.guidance.covering import Covering, Stand
from device.guidance.placement import Unplaced
from device.guidance.way_back import way_words
from device.instrument.history import read_quick_look
from device.store.active import read_active
from device.surface.fields import HeightMap
from hal.board_profile import load_board_profile
from hal.interfaces import LiftOff, PressObject

NOT_COVERED = 3
"""Exit code after the last press allowed, with a part of the area missing."""

MAX_AREA_MM: Final = 300.0
"""Each way: some hundreds of presses."""

MAP_COLUMNS: Final = 60
LEAST_MM: Final = 0.5
"""A way is told to about as much as a hand can follow."""


def cover(
    *,
    width_mm: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_AREA_MM))],
    height_mm: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_AREA_MM))],
    presses: Count | None = None,
    pressed: Annotated[str, Parameter(name="--object")] = "coin",
    labels: Labels | None = None,
    json: bool = False,
    options: Given,
) -> int:
    """Scan an area larger than the field, press by press, with the way to the next press.

    The first press is the area's upper left corner.

    Parameters
    ----------
    width_mm
        Width of the area, in the directions of the first press's live view.
    height_mm
        Height of the area, 300 mm at most as its width.
    presses
        End after that many presses.
    pressed
        What the twin's operator presses (ignored on a real board).
    json
        Print one JSON document per press instead of sentences.
    """
    read_active(store_folder(options))  # a store without a calibration is refused before anything is created
    covering: Covering | None = None
    with open_exclusive(load_board_profile(options.board)) as hardware:
        store = open_store(options, hardware.clock)
        scanner = Scanner(with_active_gel(hardware, store.root), store)
        scanner.measure_lights()
        say = print_note if json else print_line
        say("Press the area's upper left corner, then push the button. Ctrl-C ends; scans are kept.")
        for number in count(1):
            scanner.check_room("single")
            hardware.operator.ask(PressObject(pressed))
            hardware.button.wait_for_push(None)
            outcome = scanner.scan(annotations_of(labels), lambda: cue_lift(hardware, say))
            hardware.operator.ask(LiftOff())
            verdict, scan_id = outcome.bundle.record.verdict, outcome.bundle.scan_id
            height = None if verdict.level == "retake" else read_quick_look(store, scan_id)
            covering, stand = _placed(covering, height, (width_mm, height_mm))
            way = _way(covering)
            words = _sentence(covering, stand, way)
            if json:
                share = covering.share if covering else 0.0
                placed = stand if isinstance(stand, Stand) else None
                print_json({"scan": scan_id, "verdict": verdict, "stand": placed, "covered": share, "sentence": words})
            else:
                print_line(f"{verdict.level}: {verdict.reason} ({scan_id})")
                print_line("\n".join([*(covered_map(covering) if covering else ()), words]))
            if covering is not None and way is None:
                return 0
            if number == presses:
                return NOT_COVERED
    return NOT_COVERED


def _placed(
    covering: Covering | None, height: HeightMap | None, area_mm: tuple[float, float]
) -> tuple[Covering | None, Stand | Unplaced]:
    """The covering with a press in it, and where that stood."""
    if height is None:
        return covering, Unplaced("this press shows no relief")
    if covering is None:
        covering = Covering(*area_mm, height)
        return covering, covering.stands[0]
    return covering, covering.add(height)


def _way(covering: Covering | None) -> tuple[float, float] | None:
    """From the last press that was placed to the next, mm to the right and down; None where nothing is missing."""
    place = covering.next_place() if covering else None
    return covering.stands[-1].way_to(place) if covering and place else None


def _sentence(covering: Covering | None, stand: Stand | Unplaced, way: tuple[float, float] | None) -> str:
    if covering is None:
        return "Press the upper left corner again."
    area = f"{covering.share:.0%} of {covering.area_mm[0]:.0f} x {covering.area_mm[1]:.0f} mm"
    if way is None:
        return f"Covered: {area}."
    next_press = way_words(*way, LEAST_MM) or "nothing"
    if isinstance(stand, Unplaced):
        return f"Covered {area}. Place unknown: {stand.reason}. From the last known press move {next_press}."
    turn = f", turn {abs(stand.clockwise_deg):.0f}° {'anti' if stand.clockwise_deg > 0.0 else ''}clockwise"
    straight = turn if abs(stand.clockwise_deg) > 1.5 else ""
    return f"Covered {area}, overlap {stand.overlap:.0%}. Move {next_press}{straight}."


def covered_map(covering: Covering) -> list[str]:
    """The area in characters twice as high as wide: # covered, · missing, o the middle of the last press."""
    step = -(-covering.covered.shape[1] // MAP_COLUMNS)
    last = covering.stands[-1]
    middle = [
        (at + 0.5 * field) / area
        for at, field, area in zip((last.right_mm, last.down_mm), covering.field_mm, covering.area_mm, strict=True)
    ]
    cells: Any = np.where(covering.covered[step // 2 :: step, step // 2 :: step][::2], "#", "·")
    column, row = (min(max(int(share * n), 0), n - 1) for share, n in zip(middle, cells.shape[::-1], strict=True))
    cells[row, column] = "o"
    return ["".join(line) for line in cells]
