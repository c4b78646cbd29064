"""Every command of `retroscan` with where its function is and examples; nothing of the instrument is imported here."""

from __future__ import annotations

from typing import Final

from device.command_line import Command, NewWords

OLD_COMMANDS: Final = {
    "watch": NewWords(("run",)),
    "shelf": NewWords(("calibrations",)),
    "receive": NewWords(("calibrations", "import-inbox")),
    "import-inbox": NewWords(("calibrations", "import-inbox")),
}
"""Commands of the previous release, still accepted but not listed."""

COMMANDS: Final = (
    Command(
        "tui",
        "device.cli.screens:run_screens",
        "Show the screens on this terminal (the default command).",
        ("retroscan --board twin", "retroscan --board twin tui"),
        listed=False,
    ),
    Command(
        "demo",
        "device.cli.demo:demo",
        "Show the screens over a simulated handheld; key f switches its faults.",
        ("retroscan demo",),
    ),
    Command(
        "calibrate",
        "device.cli.instrument_commands:calibrate_guided",
        "Calibrate, guided: a reference, then ball presses all over the field.",
        ("retroscan calibrate", "retroscan calibrate --auto-exposure --ball-radius-mm 2.5"),
    ),
    Command(
        "scan",
        "device.cli.instrument_commands:scan_once",
        "Wait for one press of the button and scan.",
        (
            "retroscan scan --job J-17 --part housing-3",
            "retroscan scan --capture average",
            "retroscan --board twin scan --object coin --json",
        ),
    ),
    Command(
        "run",
        "device.cli.instrument_commands:run",
        "Scan at every press of the button, without a screen; held for six seconds it powers off.",
        ("retroscan run", "retroscan run --operator Ada --ball-radius-mm 3"),
    ),
    Command(
        "focus",
        "device.cli.focus:focus",
        "Show how sharp the lens is set, until Ctrl-C.",
        ("retroscan focus", "retroscan focus --frames 100"),
    ),
    Command(
        "guide",
        "device.cli.guide:guide",
        "Guide back to the spot of an earlier scan, touch by touch.",
        ("retroscan guide --to rg60bb5d63-000007-scan", "retroscan guide --to rg60bb5d63-000007-scan --json"),
    ),
    Command(
        "cover",
        "device.cli.cover:cover",
        "Scan an area larger than the field, press by press, with the way to the next press.",
        ("retroscan cover --width-mm 40 --height-mm 30", "retroscan cover --width-mm 40 --height-mm 30 --part lid"),
    ),
    Command(
        "pair",
        "device.cli.pairing:pair",
        "Let a workstation pair within two minutes; it shows the same code as this device.",
        ("retroscan pair", "retroscan pair --card /media/card"),
    ),
    Command(
        "gel",
        "device.cli.calibrations:show_or_mount_gel",
        "Show or change the mounted gel; its calibration becomes active.",
        ("retroscan gel", "retroscan gel gel-4 --slab-mm 2.5"),
    ),
    Command(
        "identity",
        "device.cli.service:identity",
        "Print this device's id, created on first use.",
        ("retroscan identity",),
        listed=False,
    ),
    Command(
        "guard-battery",
        "device.cli.service:guard_battery",
        "Power the device off once the battery is nearly empty.",
        ("retroscan guard-battery", "retroscan guard-battery --check"),
        listed=False,
    ),
    Command(
        "status",
        "device.cli.listing:show_status",
        "Show calibration, gel and room for scans; opens no hardware.",
        ("retroscan status", "retroscan status --json"),
    ),
    Command(
        "list",
        "device.cli.listing:list_scans",
        "List the scans on this device, newest first.",
        ("retroscan list", "retroscan list --json"),
    ),
    Command(
        "selftest",
        "device.cli.instrument_commands:check_parts",
        "Test every part and name the faulty one.",
        ("retroscan selftest --push", "retroscan --board twin selftest --json"),
    ),
    Command(
        "lights-off",
        "device.cli.instrument_commands:lights_off",
        "Switch all lights off.",
        ("retroscan lights-off",),
    ),
)

CALIBRATIONS: Final = (
    Command(
        "use",
        "device.cli.calibrations:use_calibration",
        "Activate a calibration.",
        ("retroscan calibrations use rg60bb5d63-000001-cal",),
    ),
    Command(
        "rollback",
        "device.cli.calibrations:roll_back",
        "Activate the previous version.",
        ("retroscan calibrations rollback",),
    ),
    Command(
        "import",
        "device.cli.calibrations:import_calibration",
        "Copy a calibration folder into the store.",
        ("retroscan calibrations import /media/card/rg60bb5d63-000001-cal --use",),
    ),
    Command(
        "export",
        "device.cli.calibrations:export_calibration",
        "Copy a calibration into a folder.",
        ("retroscan calibrations export rg60bb5d63-000001-cal /media/card",),
    ),
    Command(
        "import-inbox",
        "device.cli.pairing:import_pushed",
        "Import the calibrations that a workstation pushed.",
        ("retroscan calibrations import-inbox", "retroscan calibrations import-inbox --activate"),
    ),
)
"""Actions of `retroscan calibrations`."""
