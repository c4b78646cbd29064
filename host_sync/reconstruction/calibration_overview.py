"""The overview picture of a calibration, for which its reference is read as a scan."""

from __future__ import annotations

from dataclasses import replace

from device.errors import DeviceError
from device.imaging.flat_field import LinearFrame
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.calibration_report.report import DPI
from host_sync.errors import HostError
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.render.picture_file import figure_png
from host_sync.results.files import OVERVIEW_FILE

NO_REFERENCE = "no frame of untouched skin: nothing shows how flat it is read"


def with_overview(kept: KeptCalibration, reference: LinearFrame | None) -> KeptCalibration:
    """Return the calibration with the overview among the files of its report."""
    from host_sync.calibration_report.overview import overview_figure  # matplotlib takes a while to load

    at_rest, why_not = None, NO_REFERENCE
    if reference is not None:
        try:
            at_rest = reconstruct(reference, kept.calibration, "the reference", force=True).height
        except (DeviceError, HostError) as error:
            why_not = f"the reference cannot be read as a scan: {error}"
    picture = figure_png(overview_figure(kept.calibration, at_rest, why_not), DPI)
    return replace(kept, report=kept.report | {OVERVIEW_FILE: picture})
