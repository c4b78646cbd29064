"""Six lights against three on the same public presses of a ball grid.

    python -m tests.benchmarks.accuracy.six_lights FOLDER

FOLDER is testdata/OEMData of gelsightinc/sdkdemo. BGA-001 teaches; the maker's own circles are the truth of BGA-002,
BGA-003 and BGA-004, which are judged by the program that judges real sets. Lights 1, 3 and 5 are three lights; 2, 4 and
6 are the others, so that what both read wrong alike is known: a mean of them cannot go below the root of the covariance
of their errors. Pixel pitch is that of the real set oem-bga, and the grid does not measure it again, so that three
lights are that set's.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from device.balls.sphere import Ball
from host_sync.frames.frame_set import FrameSet, FrameSpec, PressSpec, load_frame_set
from host_sync.importers.draft import Said
from host_sync.importers.gelsight_scan import import_gelsight
from host_sync.reconstruction.scans import reconstruct_frame_set
from tests.benchmarks.accuracy.real_sets import judge_program

PITCH_UM: Final = 3.40381
TEACHES: Final = "BGA-001"
JUDGED: Final = ("BGA-002", "BGA-003", "BGA-004")
LIGHTS: Final = {"three": slice(0, None, 2), "other three": slice(1, None, 2), "six": slice(None)}
INNER: Final = 0.9
"""Share of a contact's radius that is judged, as the judge has it."""

Slopes = NDArray[np.float64]


def with_lights(frame_set: FrameSet, chosen: slice) -> FrameSet:
    """The set with some of its lights, taught by one scan, the others to be reconstructed."""

    def some(frame: FrameSpec) -> FrameSpec:
        return replace(frame, images=frame.images[chosen])

    return replace(
        frame_set,
        reference=some(frame_set.reference) if frame_set.reference else None,
        presses=tuple(
            replace(p, frame=some(p.frame), grid_pitch_mm=None) for p in frame_set.presses if _scan_of(p) == TEACHES
        ),
        scans=tuple(replace(s, frame=some(s.frame)) for s in frame_set.scans if s.name in JUDGED),
        lights=frame_set.lights[chosen],
    )


def _scan_of(press: PressSpec) -> str:
    return press.frame.images[0].parent.name


def write_truth(frame_set: FrameSet, scan: str, folder: Path) -> tuple[Ball, ...]:
    """The circles of a scan's press, written where the judge reads them."""
    press = next(press for press in frame_set.presses if _scan_of(press) == scan)
    balls = press.balls or ()
    folder.mkdir(exist_ok=True)
    (folder / "frameset.toml").write_text(f"pixel_pitch_um = {frame_set.pixel_pitch_um}\n")
    rows = ", ".join(f"{{ x = {b.column:.2f}, y = {b.row:.2f}, r = {b.contact_radius_px:.2f} }}" for b in balls)
    (folder / f"truth-{scan}.toml").write_text(f"ball_radius_mm = {press.ball_radius_mm}\nballs = [{rows}]\n")
    return balls


def verdict(truth: Path, results: Path) -> dict[str, Any]:
    """What the judge says of the results."""
    command = [sys.executable, str(judge_program()), str(truth), str(results)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    said: dict[str, Any] = json.loads(run.stdout)
    return said


def slope_errors(results: Path, balls: tuple[Ball, ...], radius_px: float, pitch_um: float) -> Slopes:
    """Errors of the height map's slopes in every contact, float64 array of shape (N, 2).

    Each ball's mean is taken off: it is where its circle was drawn beside it.
    """
    height = tifffile.imread(results / "height_um.tif").astype(np.float64) / pitch_um
    down, right = np.gradient(height, axis=0), np.gradient(height, axis=1)
    slope = np.stack([right, down], axis=-1)
    rows, columns = np.mgrid[: height.shape[0], : height.shape[1]]
    errors = []
    for ball in balls:
        reach = round(ball.contact_radius_px) + 1
        top, left = max(round(ball.row) - reach, 0), max(round(ball.column) - reach, 0)
        part = np.s_[top : round(ball.row) + reach, left : round(ball.column) + reach]
        x, y = columns[part] - ball.column, rows[part] - ball.row
        inside = x**2 + y**2 < (INNER * ball.contact_radius_px) ** 2
        depth = np.sqrt(radius_px**2 - x[inside] ** 2 - y[inside] ** 2)
        sphere = -np.stack([x[inside], y[inside]], axis=-1) / depth[:, None]
        error = slope[part][inside] - sphere
        errors.append(error - np.nanmean(error, axis=0))
    return np.concatenate(errors)


def main() -> int:
    """Print errors of three lights, the other three and six, and what a mean of both threes could reach."""
    if len(sys.argv) != 2 or not (Path(sys.argv[1]) / TEACHES).is_dir():
        sys.stderr.write(f"name the folder OEMData of gelsightinc/sdkdemo, which holds {TEACHES}\n")
        return 2
    if not judge_program().is_file():
        sys.stderr.write(f"{judge_program()}: is missing: set RETROGRAPH_DATA to the folder of the real sets\n")
        return 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        import_gelsight(Path(sys.argv[1]), Said(PITCH_UM, None, None, None)).write(folder / "oem.toml")
        everything = load_frame_set(folder / "oem.toml")
        for label, chosen in LIGHTS.items():
            reconstruct_frame_set(with_lights(everything, chosen), folder / label, report_progress=_report_progress)
        for scan in JUDGED:
            sys.stdout.write(_row(everything, scan, folder) + "\n")
    return 0


def _report_progress(words: str) -> None:
    sys.stderr.write(f"{words}\n")


def _row(frame_set: FrameSet, scan: str, folder: Path) -> str:
    balls = write_truth(frame_set, scan, folder / scan)
    said = {label: verdict(folder / scan, folder / label) for label in LIGHTS}
    radius_px = next(press.radius_px for press in frame_set.presses if _scan_of(press) == scan)
    first, second = (
        slope_errors(folder / label / scan, balls, radius_px, frame_set.pixel_pitch_um)
        for label in ("three", "other three")
    )
    known = np.isfinite(first + second).all(axis=-1)
    variance, other, shared = (
        float(np.mean(np.sum(a[known] * b[known], axis=-1)))
        for a, b in ((first, first), (second, second), (first, second))
    )
    figures = "; ".join(
        f"{label} {one['surface']['mean']:.3f}° / {one['surface_smooth2']['mean']:.3f}°" for label, one in said.items()
    )
    ratio = said["six"]["surface"]["mean"] / said["three"]["surface"]["mean"]
    alike = shared / np.sqrt(variance * other)
    return f"{scan}: {figures}; six / three {ratio:.2f}; alike {alike:.2f}; limit {np.sqrt(shared / variance):.2f}"


if __name__ == "__main__":
    sys.exit(main())
