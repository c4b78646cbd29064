"""`retrosync`: the workstation's command line.

Exit codes: 0 done, 1 partly done (failures are named), 2 bad input, 3 no connection, 130 stopped.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Final

from cyclopts import CycloptsError

from device.command_line import (
    Command,
    NewWords,
    add_commands,
    discard_output,
    in_new_words,
    make_app,
    refused_by_system,
    sentence,
    write_any_sign,
)
from device.errors import DeviceError
from device.shutdown import signals_as_keyboard_interrupt
from host_sync.cli.console import BAD_INPUT, CONNECTION, DONE, PARTLY, print_error, report_compile_time
from host_sync.errors import HostError, SourceError

# Every command with where its function is: a module is imported when its command is called, and not before.

COMMANDS: Final = (
    Command(
        "demo",
        "host_sync.cli.view:demo_command",
        "Run the whole workflow with a simulated handheld: calibrate, scan, pull, reconstruct, view.",
        (
            "retrosync demo",
            "retrosync demo --out story --no-browser",
        ),
    ),
    Command(
        "pull",
        "host_sync.cli.devices:pull_command",
        "Copy what the library lacks from every paired device, or from those, cards and folders named.",
        (
            "retrosync pull",
            "retrosync pull /media/card",
            "retrosync pull rg-bench --library scans --rehash",
        ),
    ),
    Command(
        "push-calibration",
        "host_sync.cli.devices:push_command",
        "Put a calibration of the library into a device's inbox; the device verifies it on import.",
        ("retrosync push-calibration rg-bench rg60bb5d63-000001-cal",),
    ),
    Command(
        "pair",
        "host_sync.cli.devices:pair_command",
        "Pair with a device whose pairing window is open: compare two codes; or by files on its memory card.",
        (
            "retrosync pair rg-bench.local",
            "retrosync pair rg-bench.local --card /media/card",
        ),
    ),
    Command(
        "status",
        "host_sync.cli.devices:status_command",
        "List the paired devices and how the last pull from each went; with --network, the devices in reach.",
        (
            "retrosync status",
            "retrosync status --network --json",
        ),
    ),
    Command(
        "list",
        "host_sync.cli.library:list_command",
        "List scans of a library, find them by any field, or change their labels; texts may use * and ?.",
        (
            "retrosync list --library scans",
            "retrosync list --job 'J-17*' --verdict good --since 2026-01-31",
            "retrosync list valve --tag worn --save worn-valves",
            "retrosync list valve-3 --set-name 'valve 3, before' --add-tag worn reference",
            "retrosync list --like rg60bb5d63-000007 -n 10",
            "retrosync list --set-aside --json",
        ),
    ),
    Command(
        "verify",
        "host_sync.cli.verify:verify_command",
        "Compare a library with its intake record and hash its files; repair, mirror, forget or reproduce on request.",
        (
            "retrosync verify",
            "retrosync verify --library scans --partial 5% --json",
            "retrosync verify --repair /media/card rg-bench",
            "retrosync verify --library scans --mirror sftp://ada@nas/scans",
            "retrosync verify rg60bb5d63-000002 --forget",
            "retrosync verify --reproduce",
        ),
    ),
    Command(
        "export",
        "host_sync.cli.export:export_command",
        "Export a result's surface, or the raw frame of a scan, for other programs.",
        (
            "retrosync export results/coin --to gsf x3p glb --out exported",
            "retrosync export results/coin --to csv --line-um 0 9 400 9 --out lines",
        ),
    ),
    Command(
        "import",
        "host_sync.cli.export:import_command",
        "Describe another program's folder as a frame set, and show the balls that are found on a contact sheet.",
        (
            "retrosync import OEMData --out oem.toml",
            "retrosync import presses --pixel-pitch-um 63.4 --results heights",
        ),
    ),
    Command(
        "compare",
        "host_sync.cli.compare:compare_command",
        "Compare two presses of one spot, or a result with another program's map of the same pixels.",
        (
            "retrosync compare results/before results/after --out change",
            "retrosync compare rg60bb5d63-000007 rg60bb5d63-000031 --library scans --json",
            "retrosync compare results/groove scan/heightmap.tmd",
        ),
    ),
    Command(
        "measure",
        "host_sync.cli.measure:measure_command",
        "Measure results: form removal, S- and L-filter, ISO 25178 parameters, a recipe's quantities, each with its ±.",
        (
            "retrosync measure results/coin --form plane --parameters Sa Sz",
            "retrosync measure --library scans --recipe recipe.toml --json",
        ),
    ),
    Command(
        "mosaic",
        "host_sync.cli.compare:mosaic_command",
        "Stitch overlapping presses of one object into one height map, for measure, view, report and export.",
        (
            "retrosync mosaic results/ruler-1 results/ruler-2 results/ruler-3 --out ruler",
            "retrosync mosaic results --out whole --layout places.csv",
        ),
    ),
    Command(
        "calibrate",
        "host_sync.cli.calibrate:calibrate_command",
        "Calibrate once and keep the calibration in a file; with --check, judge the instrument by certified specimens.",
        (
            "retrosync calibrate FRAMESET.toml --out gel.calibration",
            "retrosync reconstruct SCANS.toml --calibration gel.calibration --out DIR",
            "retrosync calibrate FRAMESET.toml --check STEP.toml --out certificate",
        ),
    ),
    Command(
        "gage-rr",
        "host_sync.cli.measure:gage_command",
        "Gage R&R from repeated scans of the same parts (crossed ANOVA): repeatability, reproducibility, categories.",
        (
            "retrosync gage-rr --library scans --recipe recipe.toml --number surface/Sa",
            "retrosync gage-rr --table values.csv --tolerance 0.5 --json",
        ),
    ),
    Command(
        "report",
        "host_sync.cli.report:report_command",
        "Report on results: relief, frame, profiles, numbers with ±, calibration and provenance, as HTML and PDF.",
        (
            "retrosync report results/coin --out reports",
            "retrosync report --library scans --out reports --overwrite",
        ),
    ),
    Command(
        "view",
        "host_sync.cli.view:view_command",
        "Show scans in a browser: relight, turn, profiles, comparison. Ctrl-C ends it.",
        (
            "retrosync view",
            "retrosync view results --frames FRAMESET.toml --no-browser",
        ),
    ),
    Command(
        "render",
        "host_sync.cli.render:render_command",
        "Draw reliefs as in the paper's figures: from above or from another viewpoint, under a chosen light.",
        (
            "retrosync render results/coin --out coin.png",
            "retrosync render results/coin --elevation 35 --out aslant.png",
            "retrosync render scans --contact-sheet --out sheet.png",
        ),
    ),
    Command(
        "reconstruct",
        "host_sync.cli.reconstruct:reconstruct",
        "Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).",
        (
            "retrosync reconstruct FRAMESET.toml --out results",
            "retrosync reconstruct SCANS.toml --calibration gel.calibration --out DIR",
            "retrosync reconstruct --library scans --workers 2 --json",
            "retrosync reconstruct --library scans --watch --recipe recipe.toml",
        ),
    ),
    Command(
        "paper-figures",
        "host_sync.cli.reconstruct:paper_figures",
        "Draw the figures of the CVPR 2009 paper: reflectance maps, ambiguous colours, errors of a held-out ball.",
        ("retrosync paper-figures FRAMESET.toml --out pictures --format png pdf",),
        listed=False,
    ),
    Command(
        "video",
        "host_sync.cli.video:video",
        "Reconstruct every frame of a sequence, draw the moving relief, and follow the contact.",
        (
            "retrosync video frames --calibration gel.calibration --out moving",
            "retrosync video press.mp4 --calibration FRAMESET.toml --out moving --sigma",
        ),
    ),
    Command(
        "live",
        "host_sync.cli.video:live_command",
        "Show a sensor's heights live in a browser: relight, turn, follow the contact, record. Ctrl-C ends it.",
        (
            "retrosync live gelsight-mini --calibration gel.calibration",
            "retrosync live 0 --calibration gel.calibration --sigma",
            "retrosync live press.mp4 --calibration FRAMESET.toml --no-browser",
        ),
    ),
)

OLD_COMMANDS: Final = {
    "sync": NewWords(("pull",)),
    "discover": NewWords(("status", "--network")),
    "search": NewWords(("list",)),
    "label": NewWords(
        ("list",), {"--name": "--set-name", "--tag": "--add-tag", "--untag": "--remove-tag", "--note": "--set-note"}
    ),
    "alike": NewWords(("list", "--like")),
    "repair": NewWords(("verify", "--repair")),
    "forget": NewWords(("verify", "--forget")),
    "reprocess": NewWords(("verify", "--reproduce")),
    "mirror": NewWords(("verify", "--mirror"), form="verify --library LIBRARY --mirror DESTINATION"),
    "same-spot": NewWords(("compare",)),
    "gage": NewWords(("gage-rr",)),
    "figures": NewWords(("paper-figures",)),
    "watch": NewWords(("reconstruct", "--watch")),
}
"""Commands of the previous release, still accepted but not listed."""


SEARCH_EVERY: Final = 400_000
"""Objects between two searches: more than the libraries make while they are loaded.

By Python's own number, 700, a second `retrosync reconstruct` searches 380 times, 0.13 of its processor seconds; by half
this number once, 0.06.
"""


def raise_gc_threshold() -> None:
    """Search for unreachable cycles every `SEARCH_EVERY` objects from now on."""
    gc.set_threshold(SEARCH_EVERY)


app = make_app(
    "retrosync",
    "Fetch scans from a handheld, verify them, reconstruct, measure and show their surfaces.",
    "Exit codes: 0 done, 1 partly done (failures are named), 2 bad input, 3 no connection, 130 stopped.",
)
add_commands(app, COMMANDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name; returns the exit code."""
    write_any_sign()
    raise_gc_threshold()
    # Matrices are small: a library's own threads cost more than they gain, several times as much on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return run(lambda: _call(sys.argv[1:] if arguments is None else arguments))


def _call(arguments: Sequence[str]) -> int | None:
    """Call the command, by its words of this release."""
    words, notice = in_new_words(arguments, OLD_COMMANDS)
    if notice is not None:
        print_error(notice, DONE)
    result: int | None = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    return result


def run(command: Callable[[], int | None]) -> int:
    """Run a command; returns its exit code, or that of the error that ended it, which is printed as one sentence."""
    try:
        with signals_as_keyboard_interrupt(signal.SIGTERM):
            result = command()
        sys.stdout.flush()
        report_compile_time()
    except SourceError as error:
        return print_error(error, CONNECTION)
    except (DeviceError, HostError) as error:
        return print_error(error, BAD_INPUT)
    except CycloptsError as error:
        return print_error(sentence(error, app), BAD_INPUT)
    except KeyboardInterrupt:
        return print_error("stopped: unfinished results are not kept", 130)
    except BrokenPipeError:
        discard_output()
        return 141
    except OSError as error:
        return print_error(refused_by_system(error), PARTLY if error.filename is None else BAD_INPUT)
    return int(result or DONE)
