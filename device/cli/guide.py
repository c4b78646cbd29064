"""`retroscan guide`: back to the spot of an earlier scan, touch by touch; nothing is stored."""

from __future__ import annotations

from itertools import count
from typing import Annotated

from cyclopts import Parameter

from device.acquisition.capture import capture
from device.acquisition.gel_profile import with_active_gel
from device.acquisition.instrument_lock import open_exclusive
from device.acquisition.scanner import Scanner
from device.cli.console import Count, Given, Text, open_store, print_line, print_note, store_folder
from device.command_line import print_json
from device.errors import RecordError
from device.guidance.placement import Placement, Target, on_the_spot, placed, sentence, way_back
from device.instrument.history import read_quick_look
from device.store.active import read_active
from hal.board_profile import load_board_profile
from hal.interfaces import LiftOff, PressObject

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
