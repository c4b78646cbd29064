"""`retrosync compare`: a result against the maker's own height map of the same scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from host_sync.cli.console import DONE, print_line

if TYPE_CHECKING:
    from host_sync.results.reader import ResultSurface


def compare_command(result: Path, other: Path, /) -> int:
    """Compare a result with another height map of the same pixels, such as the maker's TMD file of the scan.

    Parameters
    ----------
    result
        Folder that reconstruct wrote, or a surface file.
    other
        The map to compare it with: a surface file such as GelSight's TMD, or a result's folder.
    """
    from host_sync.measurement.map_difference import map_difference

    surface, reference = _surface(result), _surface(other)
    found = map_difference(surface.height, reference.height)
    share = found.percent_of_depth
    of_depth = "" if share is None else f" = {share:.2f} % of the depth of {found.depth_um:.4g} µm"
    print_line(
        f"{surface.record.name} against {reference.record.name}: rms {found.rms_um:.4g} µm{of_depth}, mean "
        f"{found.mean_um:.4g} µm, over {found.compared:.0%} of the pixels, a plane taken off"
    )
    for one in (surface, reference):
        for doubt in one.doubts:
            print_line(f"{one.record.name}: {doubt.sentence}")
    return DONE


def _surface(path: Path) -> ResultSurface:
    from host_sync.measurement.foreign_file import read_foreign
    from host_sync.results.reader import read_result

    return read_foreign(path) if path.is_file() else read_result(path)
