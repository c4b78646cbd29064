"""Every command with where its function is: a module is imported when its command is called, and not before."""

from __future__ import annotations

from typing import Final, NamedTuple


class Command(NamedTuple):
    """A command of `retrosync`.

    function : "module:function"
    summary : the first sentence of the function's docstring; empty for a name that is not listed
    """

    name: str
    function: str
    summary: str = ""


COMMANDS: Final = (
    Command(
        "demo",
        "host_sync.cli.demo:demo_command",
        "Play the whole way with a simulated handheld: calibrate, scan, pull, reconstruct, look.",
    ),
    Command(
        "pull",
        "host_sync.cli.offload:pull_command",
        "Copy every scan and calibration that the library lacks, read each one back, and leave receipts.",
    ),
    Command(
        "sync",
        "host_sync.cli.offload:sync_command",
        "Pull from every paired device, or from those named, side by side.",
    ),
    Command(
        "push-calibration",
        "host_sync.cli.offload:push_command",
        "Put a calibration of the library into a device's inbox; the device verifies it on import.",
    ),
    Command(
        "discover",
        "host_sync.cli.devices:discover_command",
        "List the devices that announce themselves on the local network.",
    ),
    Command(
        "pair",
        "host_sync.cli.devices:pair_command",
        "Pair with a device whose pairing window is open, by the code on its screen; or by files on its memory card.",
    ),
    Command(
        "status",
        "host_sync.cli.devices:status_command",
        "List the paired devices and how the last sync with each went.",
    ),
    Command(
        "search",
        "host_sync.cli.library:search_command",
        "List scans of a library; texts may use * and ?.",
    ),
    Command(
        "list",
        "host_sync.cli.library:list_command",
        "List the scans of a library, or what was refused and set aside.",
    ),
    Command(
        "verify",
        "host_sync.cli.library:verify_command",
        "Compare a library with its intake record and hash its files: names what is lost, changed or unknown.",
    ),
    Command(
        "repair",
        "host_sync.cli.library:repair_command",
        "Fetch lost and damaged bundles again; damaged copies move to set-aside/.",
    ),
    Command(
        "mirror",
        "host_sync.cli.library:mirror_command",
        "Copy what another disk or an SFTP server lacks, and read back every file there.",
    ),
    Command(
        "forget",
        "host_sync.cli.library:forget_command",
        "Take bundles that you removed yourself out of the intake record, so that `verify` no longer misses them.",
    ),
    Command(
        "reprocess",
        "host_sync.cli.library:reprocess_command",
        "Reconstruct scans with results again: the same version must give the same bits; others list changes.",
    ),
    Command(
        "export",
        "host_sync.cli.export:export_command",
        "Export a result's surface, or the raw frame of a scan, for other programs.",
    ),
    Command(
        "measure",
        "host_sync.cli.measure:measure_command",
        "Measure results: form removal, S- and L-filter, ISO 25178 parameters, a recipe's quantities, each with its ±.",
    ),
    Command(
        "calibrate",
        "host_sync.cli.calibrate:calibrate_command",
        "Calibrate once and keep the calibration in a file; with --check, judge the instrument by certified specimens.",
    ),
    Command(
        "gage-rr",
        "host_sync.cli.gage:gage_command",
        "Gage R&R from repeated scans of the same parts (crossed ANOVA): repeatability, reproducibility, categories.",
    ),
    Command("gage", "host_sync.cli.gage:gage_by_old_name"),
    Command(
        "report",
        "host_sync.cli.report:report_command",
        "Report on results: relief, frame, profiles, numbers with ±, calibration and provenance, as HTML and PDF.",
    ),
    Command(
        "view",
        "host_sync.cli.view:view_command",
        "Show scans in a browser: relight, turn, profiles, comparison. Ctrl-C ends it.",
    ),
    Command(
        "render",
        "host_sync.cli.render:render_command",
        "Draw reliefs as in the paper's figures: from above or from another viewpoint, under a chosen light.",
    ),
    Command(
        "reconstruct",
        "host_sync.cli.reconstruct:reconstruct",
        "Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).",
    ),
    Command(
        "paper-figures",
        "host_sync.cli.reconstruct:paper_figures",
        "Draw the figures of the CVPR 2009 paper: reflectance maps, ambiguous colours, errors of a held-out ball.",
    ),
    Command("figures", "host_sync.cli.reconstruct:figures_by_old_name"),
    Command(
        "video",
        "host_sync.cli.video:video",
        "Reconstruct every frame of a sequence and draw the moving relief.",
    ),
)
