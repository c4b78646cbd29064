"""`retroscan gel` and `retroscan shelf`: which gel is mounted, and the calibrations that fit it."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from device.bundle_store import BundleStore
from device.calibration_address import SHORT
from device.calibration_shelf import CalibrationShelf
from device.errors import NoCalibration
from device.gel_log import known_gel, known_gels, make_gel, mount_gel, mounted_gel
from device.scanning.mounting import profile_with_mounted_gel
from device.store_location import default_store
from hal.board_profile import load_board_profile
from hal.clock import SystemClock

Say = Callable[[str], None]
_SLOTS: Final = ("user", "factory")


def add_shelf_commands(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], folder: Callable[[str], Path], say: Say
) -> None:
    """Add the two commands to `retroscan`.

    folder : turns an argument into a path
    say : shows one line
    """
    gel = commands.add_parser("gel", help="say which gel is mounted, or that another one is: its calibration follows")
    gel.add_argument("gel_id", nargs="?", help="name of the gel that is mounted now")
    gel.add_argument("--slab-mm", type=float, help="thickness of a new gel's slab, mm; the board's own when not given")
    gel.set_defaults(command=partial(_gel, say))

    shelf = commands.add_parser("shelf", help="calibrations by instrument, gel and lights: list, use, import, export")
    actions = shelf.add_subparsers(title="actions", metavar="ACTION")
    shelf.set_defaults(command=partial(_list, say))
    use = actions.add_parser("use", help="put a calibration in force")
    use.add_argument("calibration_id", help="its id, as `retroscan shelf` lists it")
    use.set_defaults(command=partial(_use, say))
    back = actions.add_parser("rollback", help="put the version before this one in force")
    back.set_defaults(command=partial(_roll_back, say))
    take = actions.add_parser("import", help="copy a calibration's folder into the store")
    take.add_argument("folder", type=folder, help="the calibration's own folder")
    take.add_argument("--slot", choices=_SLOTS, default="user", help="the factory's is what a rollback ends at")
    take.add_argument("--adopt", action="store_true", help="it is this very instrument's, made under an earlier id")
    take.add_argument("--use", action="store_true", help="put it in force too")
    take.set_defaults(command=partial(_import, say))
    give = actions.add_parser("export", help="copy a calibration into a folder")
    give.add_argument("calibration_id", help="its id, as `retroscan shelf` lists it")
    give.add_argument("folder", type=folder, help="where its folder is put")
    give.set_defaults(command=partial(_export, say))


def _gel(say: Say, options: argparse.Namespace) -> int:
    store, usual = _store(options), load_board_profile(options.board).gel
    if options.gel_id is None:
        mounted = mounted_gel(store.root, usual)
        known = {gel.gel_id: gel for gel in (*known_gels(store.root), mounted)}
        for gel in known.values():
            here = "  (mounted)" if gel.gel_id == mounted.gel_id else ""
            say(f"{gel.gel_id}: slab {gel.slab_thickness_mm:g} mm, {gel.presses} presses{here}")
        return 0
    _shelf(options, store).shelved()  # what is in force now is remembered for the gel that goes
    known_one = known_gel(store.root, options.gel_id) if options.slab_mm is None else None
    slab_mm = usual.slab_thickness_mm if options.slab_mm is None else options.slab_mm
    mount_gel(store.root, known_one or make_gel(options.gel_id, slab_mm))
    say(f"Gel {options.gel_id} is mounted.")
    try:
        entry = _shelf(options, store).switch()
    except NoCalibration as error:
        say(f"No scans yet: {error}")
        return 0
    say(f"Calibration {entry.calibration_id} (version {entry.version}) is in force.")
    return 0


def _list(say: Say, options: argparse.Namespace) -> int:
    store = _store(options)
    found = _shelf(options, store).shelved()
    if not found:
        say(f"no calibrations in {store.root}: run `retroscan calibrate`, or `retroscan shelf import FOLDER`")
    for shelved in found:
        record, entry = shelved.bundle.record, shelved.entry
        here = "  (in force)" if shelved.in_force else ""
        error = record.figures.get("held_out_error_deg")
        told = "" if error is None else f", held-out error {error:.2f} degrees"
        say(
            f"{record.gel_id} on {record.board}, version {entry.version} ({entry.slot}), {record.created:%Y-%m-%d}"
            f"{told}, content {entry.content[:SHORT]}: {entry.calibration_id}{here}"
        )
    for damaged in store.calibrations().damaged:
        say(f"damaged: {damaged.reason}")
    return 0


def _use(say: Say, options: argparse.Namespace) -> int:
    entry = _shelf(options, _store(options)).put_in_force(options.calibration_id)
    say(f"Calibration {entry.calibration_id} (version {entry.version}) is in force.")
    return 0


def _roll_back(say: Say, options: argparse.Namespace) -> int:
    entry = _shelf(options, _store(options)).roll_back()
    say(f"Back to version {entry.version} ({entry.slot}): calibration {entry.calibration_id} is in force.")
    return 0


def _import(say: Say, options: argparse.Namespace) -> int:
    shelf = _shelf(options, _store(options))
    entry = shelf.take_in(options.folder, options.slot, adopt=options.adopt)
    say(f"Calibration {entry.calibration_id} is shelved as version {entry.version} ({entry.slot}).")
    if options.use:
        shelf.put_in_force(entry.calibration_id)
        say("It is in force.")
    return 0


def _export(say: Say, options: argparse.Namespace) -> int:
    say(f"Copied to {_shelf(options, _store(options)).give_out(options.calibration_id, options.folder)}.")
    return 0


def _store(options: argparse.Namespace) -> BundleStore:
    return BundleStore(options.store or default_store(os.environ), SystemClock())


def _shelf(options: argparse.Namespace, store: BundleStore) -> CalibrationShelf:
    profile = load_board_profile(options.board)
    return CalibrationShelf(store, profile_with_mounted_gel(profile, store.root))
