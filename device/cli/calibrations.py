"""`retroscan gel` and `retroscan calibrations`: the mounted gel, and the calibrations made for each gel."""

from __future__ import annotations

import argparse
from typing import Final

from device.acquisition.gel_profile import profile_with_mounted_gel
from device.cli.console import Commands, folder_argument, open_store, print_line
from device.errors import NoCalibration
from device.store.gels import known_gel, known_gels, make_gel, mount_gel, mounted_gel
from device.store.registry import CalibrationRegistry
from device.store.registry_file import SHORT
from device.store.store import BundleStore
from hal.board_profile import load_board_profile

_SLOTS: Final = ("user", "factory")


def add_calibrations_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `gel` and `calibrations` to `retroscan`."""
    gel = commands.add_parser("gel", help="show or change the mounted gel; its calibration becomes active")
    gel.add_argument("gel_id", nargs="?", help="name of the gel that is mounted now")
    gel.add_argument("--slab-mm", type=float, help="slab thickness of a new gel, mm; default: from the board profile")
    gel.set_defaults(command=_gel)

    calibrations = commands.add_parser(
        "calibrations", help="calibrations by instrument, gel and lights: list, use, rollback, import, export"
    )
    actions = calibrations.add_subparsers(title="actions", metavar="ACTION")
    calibrations.set_defaults(command=_list)
    use = actions.add_parser("use", help="activate a calibration")
    use.add_argument("calibration_id", help="its id, as `retroscan calibrations` lists it")
    use.set_defaults(command=_use)
    rollback = actions.add_parser("rollback", help="activate the previous version")
    rollback.set_defaults(command=_roll_back)
    imported = actions.add_parser("import", help="copy a calibration folder into the store")
    imported.add_argument("folder", type=folder_argument, help="the calibration folder")
    imported.add_argument("--slot", choices=_SLOTS, default="user", help="rollbacks end at the factory calibration")
    imported.add_argument("--adopt", action="store_true", help="accept one made by this instrument under an earlier id")
    imported.add_argument("--use", action="store_true", help="activate it too")
    imported.set_defaults(command=_import)
    export = actions.add_parser("export", help="copy a calibration into a folder")
    export.add_argument("calibration_id", help="its id, as `retroscan calibrations` lists it")
    export.add_argument("folder", type=folder_argument, help="destination; the calibration folder is created in it")
    export.set_defaults(command=_export)


def _gel(options: argparse.Namespace) -> int:
    store, default = open_store(options), load_board_profile(options.board).gel
    if options.gel_id is None:
        mounted = mounted_gel(store.root, default)
        known = {gel.gel_id: gel for gel in (*known_gels(store.root), mounted)}
        for gel in known.values():
            mark = "  (mounted)" if gel.gel_id == mounted.gel_id else ""
            print_line(f"{gel.gel_id}: slab {gel.slab_thickness_mm:g} mm, {gel.presses} presses{mark}")
        return 0
    _registry(options, store).list()  # records the active calibration for the gel that is taken off
    known_one = known_gel(store.root, options.gel_id) if options.slab_mm is None else None
    slab_mm = default.slab_thickness_mm if options.slab_mm is None else options.slab_mm
    mount_gel(store.root, known_one or make_gel(options.gel_id, slab_mm))
    print_line(f"Gel {options.gel_id} is mounted.")
    try:
        entry = _registry(options, store).switch()
    except NoCalibration as error:
        print_line(f"Scanning is not possible yet: {error}")
        return 0
    print_line(f"Calibration {entry.calibration_id} (version {entry.version}) is active.")
    return 0


def _list(options: argparse.Namespace) -> int:
    store = open_store(options)
    found = _registry(options, store).list()
    if not found:
        print_line(
            f"no calibrations in {store.root}: run `retroscan calibrate` or `retroscan calibrations import FOLDER`"
        )
    for registered in found:
        record, entry = registered.bundle.record, registered.entry
        mark = "  (active)" if registered.active else ""
        error_deg = record.figures.get("held_out_error_deg")
        error = "" if error_deg is None else f", held-out error {error_deg:.2f} degrees"
        print_line(
            f"{record.gel_id} on {record.board}, version {entry.version} ({entry.slot}), {record.created:%Y-%m-%d}"
            f"{error}, content {entry.content[:SHORT]}: {entry.calibration_id}{mark}"
        )
    for damaged in store.calibrations().damaged:
        print_line(f"damaged: {damaged.reason}")
    return 0


def _use(options: argparse.Namespace) -> int:
    entry = _registry(options, open_store(options)).activate(options.calibration_id)
    print_line(f"Calibration {entry.calibration_id} (version {entry.version}) is active.")
    return 0


def _roll_back(options: argparse.Namespace) -> int:
    entry = _registry(options, open_store(options)).roll_back()
    print_line(f"Rolled back to version {entry.version} ({entry.slot}): calibration {entry.calibration_id} is active.")
    return 0


def _import(options: argparse.Namespace) -> int:
    registry = _registry(options, open_store(options))
    entry = registry.import_(options.folder, options.slot, adopt=options.adopt)
    print_line(f"Calibration {entry.calibration_id} is imported as version {entry.version} ({entry.slot}).")
    if options.use:
        registry.activate(entry.calibration_id)
        print_line("It is active.")
    return 0


def _export(options: argparse.Namespace) -> int:
    copied_to = _registry(options, open_store(options)).export(options.calibration_id, options.folder)
    print_line(f"Copied to {copied_to}.")
    return 0


def _registry(options: argparse.Namespace, store: BundleStore) -> CalibrationRegistry:
    profile = load_board_profile(options.board)
    return CalibrationRegistry(store, profile_with_mounted_gel(profile, store.root))
