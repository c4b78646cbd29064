"""Sets rendered by makers' shading models and by a near-light bench, judged from the result files by another program.

Renderer and judge lie beside the real frames and are no part of this project; the renderer needs PyYAML. Figures are
means over scans: heights and features without untouched skin, the texture over the whole field (which has no zero) and
the wave of 10 px; shares within σ over all scans, in bands of tilt over the pixels of all scans.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from host_sync.frames.frame_set import load_frame_set
from host_sync.reconstruction.scans import reconstruct_frame_set
from tests.benchmarks.accuracy.marks import TILTS
from tests.benchmarks.accuracy.real_sets import data_folder

SETS: Final = ("finger", "series2", "matt", "tactile")
WITHOUT_ZERO: Final = ("rest", "roughfull")
FINEST: Final = "wave10px"
LONG_WAVE: Final = "wave80px"
WITHIN: Final = 2
"""Place of the share of slopes within σ among what the judge says of a band; the first is its count of pixels."""


def available() -> bool:
    """Whether renderer, judge, makers' models and PyYAML are there."""
    files = (_tool("make_simulated.py"), _tool("judge_heights.py"), _models())
    return all(file.exists() for file in files) and importlib.util.find_spec("yaml") is not None


def rendered_figures(folder: Path, report_progress: Callable[[str], None]) -> Iterator[tuple[str, float]]:
    """Figures of every set; frames and results stay in the folder."""
    for name in SETS if available() else ():
        report_progress(f"rendered {name}: rendering")
        _run(_tool("make_simulated.py"), _models(), folder / "rendered", "--devices", name)
        frames, results, record = (folder / "rendered" / part for part in (name, f"{name}-out", f"{name}.json"))
        reconstruct_frame_set(
            load_frame_set(frames / "frameset.toml"),
            results,
            report_progress=lambda words, name=name: report_progress(f"rendered {name}: {words}"),
        )
        report_progress(f"rendered {name}: judging")
        _run(_tool("judge_heights.py"), frames, results, "--json", record)
        presses = json.loads((results / "calibration" / "report.json").read_text())["presses"]
        yield f"rendered {name} presses that teach", sum(bool(press["balls"]) for press in presses) / len(presses)
        yield from figures_of(name, json.loads(record.read_text()))


def figures_of(name: str, verdict: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, float]]:
    """Figures of a judge's verdict, by scan."""
    scans = {scan: rows["ours"] for scan, rows in verdict.items() if "ours" in rows}
    objects = {scan: row for scan, row in scans.items() if scan not in WITHOUT_ZERO}
    features = [abs(off) for row in objects.values() for feature, off in row["feature"].items() if feature != FINEST]
    yield f"rendered {name} heights, rms", float(np.mean([row["rms"] for row in objects.values()]))
    yield f"rendered {name} features off by", float(np.mean(features)) / 100.0
    if "rest" in scans:
        yield f"rendered {name} untouched skin, rms", float(scans["rest"]["rms"])
    for figure, key in (
        ("heights within sigma", "h_in"),
        ("height errors over sigma", "h_x"),
        ("slopes within sigma", "s_in"),
    ):
        yield f"rendered {name} {figure}", float(np.mean([row[key] for row in scans.values() if key in row]))
    for tilt in TILTS:
        bands = [row["bands"][tilt] for row in scans.values() if tilt in row.get("bands", {})]
        if bands:
            within = np.average([band[WITHIN] for band in bands], weights=[band[0] for band in bands])
            yield f"rendered {name} slopes within sigma, {tilt} deg", float(within)
    for row in objects.values():
        if LONG_WAVE in row["feature"]:
            yield f"rendered {name} wave of 80 px off by", abs(row["feature"][LONG_WAVE]) / 100.0


def _run(program: Path, *arguments: Path | str) -> None:
    subprocess.run([sys.executable, str(program), *map(str, arguments)], check=True, capture_output=True)


def _tool(name: str) -> Path:
    return data_folder().parent / "tools" / name


def _models() -> Path:
    return data_folder() / "models"
