"""Every command with where its function is: a module is imported when its command is called, and not before."""

from __future__ import annotations

from typing import Final

from device.command_line import Command

COMMANDS: Final = (
    Command(
        "demo",
        "host_sync.cli.demo:demo_command",
        "Play the whole way with a simulated handheld: calibrate, scan, pull, reconstruct, look.",
        (
            "retrosync demo",
            "retrosync demo --out story --no-open",
        ),
    ),
    Command(
        "pull",
        "host_sync.cli.offload:pull_command",
        "Copy every scan and calibration that the library lacks, read each one back, and leave receipts.",
        (
            "retrosync pull /media/card",
            "retrosync pull rg-bench --library scans --verify",
        ),
    ),
    Command(
        "sync",
        "host_sync.cli.offload:sync_command",
        "Pull from every paired device, or from those named, side by side.",
        (
            "retrosync sync",
            "retrosync sync rg-bench --library scans",
        ),
    ),
    Command(
        "push-calibration",
        "host_sync.cli.offload:push_command",
        "Put a calibration of the library into a device's inbox; the device verifies it on import.",
        ("retrosync push-calibration rg-bench rg60bb5d63-000001-cal",),
    ),
    Command(
        "discover",
        "host_sync.cli.devices:discover_command",
        "List the devices that announce themselves on the local network.",
        ("retrosync discover --seconds 5",),
    ),
    Command(
        "pair",
        "host_sync.cli.devices:pair_command",
        "Pair with a device whose pairing window is open, by the code on its screen; or by files on its memory card.",
        (
            "retrosync pair rg-bench.local",
            "retrosync pair rg-bench.local --card /media/card",
        ),
    ),
    Command(
        "status",
        "host_sync.cli.devices:status_command",
        "List the paired devices and how the last sync with each went.",
        (
            "retrosync status",
            "retrosync status --json",
        ),
    ),
    Command(
        "search",
        "host_sync.cli.library:search_command",
        "List scans of a library; texts may use * and ?.",
        (
            "retrosync search --job 'J-17*' --verdict good --since 2026-01-31",
            "retrosync search --part housing-3 --json",
            "retrosync search valve --tag worn --save worn-valves",
        ),
    ),
    Command(
        "label",
        "host_sync.cli.library:label_command",
        "Give scans a name, tags or a note; without any, print what they have.",
        (
            "retrosync label valve-3 --name 'valve 3, before' --tag worn reference",
            "retrosync label valve-3 --note 'edge chipped at six o clock'",
        ),
    ),
    Command(
        "list",
        "host_sync.cli.library:list_command",
        "List the scans of a library, or what was refused and set aside.",
        (
            "retrosync list --library scans",
            "retrosync list --set-aside --json",
        ),
    ),
    Command(
        "verify",
        "host_sync.cli.library:verify_command",
        "Compare a library with its intake record and hash its files: names what is lost, changed or unknown.",
        (
            "retrosync verify",
            "retrosync verify --library scans --partial 5% --json",
        ),
    ),
    Command(
        "repair",
        "host_sync.cli.library:repair_command",
        "Fetch lost and damaged bundles again; damaged copies move to set-aside/.",
        ("retrosync repair /media/card --library scans",),
    ),
    Command(
        "mirror",
        "host_sync.cli.library:mirror_command",
        "Copy what another disk or an SFTP server lacks, and read back every file there.",
        (
            "retrosync mirror scans /mnt/disk/scans",
            "retrosync mirror scans sftp://ada@nas/scans --verify",
        ),
    ),
    Command(
        "forget",
        "host_sync.cli.library:forget_command",
        "Take bundles that you removed yourself out of the intake record, so that `verify` no longer misses them.",
        ("retrosync forget rg60bb5d63-000002 --library scans",),
    ),
    Command(
        "reprocess",
        "host_sync.cli.library:reprocess_command",
        "Reconstruct scans with results again: the same version must give the same bits; others list changes.",
        ("retrosync reprocess --library scans",),
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
        "host_sync.cli.import_set:import_command",
        "Describe another program's folder as a frame set, and show the balls that are found on a contact sheet.",
        (
            "retrosync import OEMData --out oem.toml",
            "retrosync import presses --pixel-pitch-um 63.4 --results heights",
        ),
    ),
    Command(
        "compare",
        "host_sync.cli.compare:compare_command",
        "Compare a result with another height map of the same pixels, such as the maker's TMD file of the scan.",
        ("retrosync compare results/groove scan/heightmap.tmd",),
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
        "alike",
        "host_sync.cli.alike:alike_command",
        "Find the surfaces of a library that look most like one; shifted and turned presses of it too.",
        (
            "retrosync alike rg60bb5d63-000007",
            "retrosync alike results/coin --library scans -n 10 --json",
        ),
    ),
    Command(
        "same-spot",
        "host_sync.cli.same_spot:same_spot_command",
        "Compare two presses of one spot: the second minus the first, significant changes, what is too small to see.",
        (
            "retrosync same-spot results/before results/after --out change",
            "retrosync same-spot rg60bb5d63-000007 rg60bb5d63-000031 --library scans --json",
        ),
    ),
    Command(
        "mosaic",
        "host_sync.cli.mosaic:mosaic_command",
        "Stitch overlapping presses of one object into one height map, which measure, view, report and export take.",
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
        "host_sync.cli.gage:gage_command",
        "Gage R&R from repeated scans of the same parts (crossed ANOVA): repeatability, reproducibility, categories.",
        (
            "retrosync gage-rr --library scans --recipe recipe.toml --number surface/Sa",
            "retrosync gage-rr --table values.csv --tolerance 0.5 --json",
        ),
    ),
    Command("gage", "host_sync.cli.gage:gage_by_old_name"),
    Command(
        "report",
        "host_sync.cli.report:report_command",
        "Report on results: relief, frame, profiles, numbers with ±, calibration and provenance, as HTML and PDF.",
        (
            "retrosync report results/coin --out reports",
            "retrosync report --library scans --recipe recipe.toml --out reports --force",
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
        ),
    ),
    Command(
        "watch",
        "host_sync.cli.watch:watch_command",
        "Reconstruct and measure whatever comes into a library, until it is stopped.",
        (
            "retrosync watch scans --recipe recipe.toml",
            "retrosync watch scans --once --workers 2",
        ),
    ),
    Command(
        "paper-figures",
        "host_sync.cli.reconstruct:paper_figures",
        "Draw the figures of the CVPR 2009 paper: reflectance maps, ambiguous colours, errors of a held-out ball.",
        ("retrosync paper-figures FRAMESET.toml --out pictures --format png pdf",),
    ),
    Command("figures", "host_sync.cli.reconstruct:figures_by_old_name"),
    Command(
        "video",
        "host_sync.cli.video:video",
        "Reconstruct every frame of a sequence and draw the moving relief.",
        (
            "retrosync video frames --calibration gel.calibration --out moving",
            "retrosync video press.mp4 --calibration FRAMESET.toml --out moving",
        ),
    ),
)
