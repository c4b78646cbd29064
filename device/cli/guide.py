"""`retroscan demo`, `guide`, `cover` and `focus`: the simulated handheld's screens, and help to place and focus."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter
from cyclopts.validators import Number

from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.instrument_lock import open_exclusive
from device.acquisition.scanner import Scanner
from device.cli.console import Count, Given, GivenSimulated, Text, open_store, print_line, print_note, store_folder
from device.cli.instrument_commands import Labels, annotations_of, cue_lift
from device.cli.screens import require_terminal, show_screens
from device.command_line import Folder, print_json
from device.errors import NoCalibration, RecordError
from device.guidance.cover_task import FIRST_PRESS, MAX_AREA_MM, CoverTask, InstrumentPose
from device.guidance.placement import Placement, Target, on_the_spot, placed, sentence, way_back
from device.imaging.frame_measures import FocusMeter
from device.instrument.calibration_run import BALL_RADIUS_MM
from device.instrument.demo_faults import DemoDisk, DemoFaults
from device.instrument.history import read_quick_look
from device.instrument.instrument import Instrument
from device.store.choices import with_active_gel
from device.store.registry_file import read_active
from device.store.store import BundleStore, default_store
from hal.board_profile import load_board_profile
from hal.clock import SystemClock
from hal.errors import BoardProfileError
from hal.factory import open_hardware
from hal.interfaces import LiftOff, PressObject

DEMO_BOARD: Final = "twin"
DEMO_FOLDER: Final = "retroscan-demo"


def demo(*, store: Folder | None = None, simulated: GivenSimulated) -> int:
    """Show the screens on a simulated handheld; key f switches faults on and off.

    Returns the exit code.

    Its first start calibrates it, which takes about half a minute.

    Parameters
    ----------
    store
        Folder of its scans and calibrations; by default next to that of the real handheld, one for each board.
    """
    profile = load_board_profile(simulated.board)
    if profile.driver != "twin":
        raise BoardProfileError(f"{simulated.board}: is no simulated handheld: name twin or twin-distant, or no board")
    require_terminal()
    folder = store or simulated.store_folder or default_store().with_name(demo_folder_name(simulated.board))
    prepare_demo(folder, simulated.board)
    hardware, disk = open_hardware(profile, SystemClock()), DemoDisk(folder)
    instrument = Instrument(hardware, BundleStore(folder, hardware.clock, statvfs=disk))
    return show_screens(instrument, hardware, folder, DemoFaults(instrument, disk))


def demo_folder_name(board: str) -> str:
    """Name of a board's folder: a calibration of one simulated handheld does not serve another."""
    return DEMO_FOLDER if board == DEMO_BOARD else f"{DEMO_FOLDER}-{Path(board).stem}"


def prepare_demo(folder: Path, board: str = DEMO_BOARD) -> None:
    """Calibrate the twin into a store unless that has a calibration; virtual time makes it faster than a person."""
    with open_hardware(load_board_profile(board)) as hardware:
        made = BundleStore(folder, hardware.clock)
        try:
            made.active_calibration()
        except NoCalibration:
            print_line(
                "Preparing the demonstration: the simulated operator calibrates, about half a minute, only once."
            )
            calibrate(hardware, made, BALL_RADIUS_MM, lambda _: None)


NOT_REACHED = 3
"""Exit code after the last touch allowed, away from the spot."""


def guide(
    *,
    to: Text,
    touches: Count | None = None,
    pressed: Annotated[str, Parameter(name="--object")] = "coin",
    json: bool = False,
    options: Given,
) -> int:
    """Guide back to the spot of an earlier scan, touch by touch.

    Parameters
    ----------
    to
        The earlier scan's id.
    touches
        End after that many touches.
    pressed
        What the twin's operator presses (ignored on a real board).
    json
        Print one JSON document per touch instead of sentences.
    """
    read_active(store_folder(options))  # a store without a calibration is refused before anything is created
    with open_exclusive(load_board_profile(options.board), store=store_folder(options)) as hardware:
        store = open_store(options, hardware.clock)
        height = read_quick_look(store, to)
        if height is None:
            raise RecordError(f"{to} has no quick look: choose a scan that has one")
        target = Target(height)
        scanner = Scanner(with_active_gel(hardware, store.root), store)
        say = print_note if json else print_line
        say("Touch the object lightly, then push the button. Ctrl-C ends.")
        way = None
        for number in count(1):
            hardware.operator.ask(PressObject(pressed, way))
            hardware.button.wait_for_push(None)
            found = placed(capture(hardware, scanner.plan), scanner.model, target)
            hardware.operator.ask(LiftOff())
            reached, way = on_the_spot(found), way_back(found)
            if json:
                known = found if isinstance(found, Placement) else None
                print_json({"to": to, "placement": known, "on_the_spot": reached, "sentence": sentence(found)})
            else:
                print_line(sentence(found))
            if reached:
                return 0
            if number == touches:
                return NOT_REACHED
    return NOT_REACHED


# `retroscan cover`: an area larger than the field, press by press; every press is a scan for `retrosync mosaic`.

NOT_COVERED = 3
"""Exit code after the last press allowed, with a part of the area missing."""

MAP_COLUMNS: Final = 60


def cover(
    *,
    width_mm: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_AREA_MM))],
    height_mm: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_AREA_MM))],
    presses: Count | None = None,
    pressed: Annotated[str, Parameter(name="--object")] = "pebbles",
    labels: Labels | None = None,
    json: bool = False,
    options: Given,
) -> int:
    """Scan an area larger than the field, press by press, with the way to the next press.

    The first press is the area's upper left corner.

    Parameters
    ----------
    width_mm
        Width of the area, as seen in the first press's live view.
    height_mm
        Height of the area, like its width at most 300 mm.
    presses
        End after that many presses.
    pressed
        What the twin's operator presses (ignored on a real board).
    json
        Print one JSON document per press instead of sentences.
    """
    read_active(store_folder(options))  # a store without a calibration is refused before anything is created
    task = CoverTask(width_mm, height_mm)
    with open_exclusive(load_board_profile(options.board), store=store_folder(options)) as hardware:
        store = open_store(options, hardware.clock)
        scanner = Scanner(with_active_gel(hardware, store.root), store)
        scanner.measure_lights()
        say = print_note if json else print_line
        say(f"{FIRST_PRESS} Ctrl-C ends; scans are kept.")
        for number in count(1):
            scanner.check_room("single")
            hardware.operator.ask(PressObject(pressed, task.hand_way))
            hardware.button.wait_for_push(None)
            outcome = scanner.scan(annotations_of(labels), lambda: cue_lift(hardware, say))
            hardware.operator.ask(LiftOff())
            verdict, scan_id = outcome.bundle.record.verdict, outcome.bundle.scan_id
            task.add(None if verdict.level == "retake" else read_quick_look(store, scan_id))
            words, drawn = task.sentence(), task.map()
            if json:
                placed = task.pose if isinstance(task.pose, InstrumentPose) else None
                said = {"scan": scan_id, "verdict": verdict, "stand": placed, "covered": task.share, "sentence": words}
                print_json(said)
            else:
                print_line(f"{verdict.level}: {verdict.reason} ({scan_id})")
                print_line("\n".join([*(drawn.lines(MAP_COLUMNS) if drawn else ()), words]))
            if task.is_done:
                return 0
            if number == presses:
                return NOT_COVERED
    return NOT_COVERED


# `retroscan focus`: how sharp the camera sees, frame by frame, while a person turns the lens.

BAR: Final = 40


def focus(*, frames: Count | None = None, options: Given) -> int:
    """Show how sharp the lens is focused, until Ctrl-C.

    Parameters
    ----------
    frames
        End after that many frames.
    """
    print_line("Lay a coin or print on the gel and turn the lens's focus ring. Ctrl-C ends.")
    meter = FocusMeter()
    with open_exclusive(load_board_profile(options.board)) as hardware:
        plan = CaptureSettings.of_board(hardware)
        for number in count(1):
            reading = meter.read(capture(hardware, plan))
            bar = "#" * round(BAR * reading.fraction)
            print_line(f"{reading.figure:8.2f}  best {reading.best:8.2f}  {bar:<{BAR}}  {reading.advice}")
            if number == frames:
                return 0
    return 0
