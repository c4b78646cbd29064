"""The paper's method and the default side by side: updates the table of docs/paper.md, and on request its pictures.

usage: python -m tests.benchmarks.accuracy.methods [--pictures] [--only real twin]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image
from rich.console import Console

from host_sync.calibration.calibrate import METHODS, Method
from host_sync.calibration_file.calibrator import Calibrator, calibrate_frame_set
from host_sync.evaluation import frames_to_draw, write_figures
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.linear_light import read_frame
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from tests.benchmarks.accuracy import real_sets
from tests.benchmarks.accuracy.marks import SKINS
from tests.benchmarks.accuracy.twin_instrument import TwinInstrument, reference_profile
from tests.benchmarks.accuracy.twin_verdict import PLACES, judge_instrument

DOCUMENT: Final = real_sets.ROOT / "docs" / "paper.md"
PICTURES: Final = real_sets.ROOT / "docs" / "pictures"
BEGIN, END = "<!-- begin table -->", "<!-- end table -->"
BOARDS: Final = (("twin", "25 mm"), ("twin-distant", "250 mm"))
PARTS: Final = ("real", "twin")
DRAWN: Final = (("oem-bga", ("reflectance-maps", "ball-errors")), ("finger", ("ambiguous-bins", "ball-errors")))
PICTURE_DPI: Final = 90
COLOURS: Final = 96


@dataclass(frozen=True, slots=True)
class Row:
    """Errors of one set or instrument by method: surface and its bias (degrees), relative radius error."""

    name: str
    surface_deg: dict[Method, float]
    smooth_deg: dict[Method, float]
    radius_off_by: dict[Method, float]

    @property
    def line(self) -> str:
        """A line of the table."""
        cells = [
            *(f"{self.surface_deg[method]:.2f}°" for method in ("paper", "direct")),
            *(f"{self.smooth_deg[method]:.2f}°" for method in ("paper", "direct")),
            *(f"{100.0 * self.radius_off_by[method]:.1f} %" for method in ("paper", "direct")),
        ]
        return f"| {self.name} | {' | '.join(cells)} |"


def main() -> int:
    """Measure and update, row by row; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", action="store_true", help="draw the document's pictures again, too")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="leave the other rows as they are")
    arguments = parser.parse_args()
    console = Console()
    with tempfile.TemporaryDirectory(prefix="methods-") as name:
        parts = {"real": real_rows(Path(name)), "twin": twin_rows(Path(name))}
        for part in arguments.only:
            for row in parts[part]:
                console.print(row.line, soft_wrap=True)
                refresh(DOCUMENT, [row])
    for set_name, figures in filter(lambda item: real_sets.available(item[0]), DRAWN if arguments.pictures else ()):
        draw(set_name, figures, console.print)
    return 0


def twin_rows(folder: Path) -> Iterator[Row]:
    """One row per skin under near and distant lights."""
    for board, distance in BOARDS:
        for skin in SKINS:
            instrument = TwinInstrument(reference_profile(skin, board), folder / f"{board}-{skin}", paper=True)
            verdicts = {
                method: judge_instrument(instrument, lambda _: None, method, PLACES[:2], ()) for method in METHODS
            }
            yield Row(
                f"twin, {skin}, lights at {distance}",
                {method: verdict.surface_deg for method, verdict in verdicts.items()},
                {method: verdict.smooth_deg for method, verdict in verdicts.items()},
                {method: verdict.radius_off_by for method, verdict in verdicts.items()},
            )


def real_rows(folder: Path) -> Iterator[Row]:
    """One row per available real set."""
    for name in filter(real_sets.available, real_sets.SETS):
        frame_set = load_frame_set(real_sets.frame_set_file(name))
        calibration = calibrate_frame_set(frame_set, paper=True)
        verdicts = {}
        for method in METHODS:
            out = folder / f"{name}-{method}"
            for scan in frame_set.scans:
                found = reconstruct(read_frame(scan.frame), calibration, scan.name, method, force=True)
                write_result(out / scan.name, found, calibration, scan.name)
            verdicts[method] = real_sets.judge_results(name, out)
        yield Row(
            name,
            {method: verdict["surface"]["mean"] for method, verdict in verdicts.items()},
            {method: verdict["surface_smooth2"]["mean"] for method, verdict in verdicts.items()},
            {method: abs(verdict["radius_ratio_median"] - 1.0) for method, verdict in verdicts.items()},
        )


def refresh(document: Path, rows: list[Row]) -> None:
    """Write these rows between the document's marker lines; those of unmeasured sets stay."""
    text = document.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    table, after = rest.split(END)
    lines = table.strip().splitlines()
    measured = {row.name: row.line for row in rows}
    kept = {line.split("|")[1].strip(): line for line in lines[2:]}
    body = list((kept | measured).values())
    document.write_text(f"{before}{BEGIN}\n{chr(10).join([*lines[:2], *body])}\n{END}{after}", encoding="utf-8")


def draw(name: str, figures: Sequence[str], report_progress: Callable[[str], None]) -> None:
    """Write the named figures of one real set, small enough for the repository."""
    with tempfile.TemporaryDirectory(prefix="methods-") as folder:
        drawn = frames_to_draw(str(real_sets.frame_set_file(name)), None, Calibrator(paper=True))
        for path in write_figures(*drawn, Path(folder), dpi=PICTURE_DPI):
            if path.stem in figures:
                target = PICTURES / f"{path.stem}-{name}.png"
                with Image.open(path) as picture:
                    picture.convert("RGB").quantize(COLOURS).save(target, optimize=True)
                report_progress(str(target))


if __name__ == "__main__":
    sys.exit(main())
