"""Real frames, reconstructed by the program's command and judged from the result files by another program."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from host_sync.frames.frame_set import load_frame_set
from host_sync.reconstruction.scans import reconstruct_frame_set

ROOT: Final = Path(__file__).parents[3]
SETS: Final = ("oem-bga", "taxim-small", "finger")


def data_folder() -> Path:
    """Folder of the frames: named by RETROGRAPH_DATA, else ../shared/data beside the project."""
    return Path(os.environ.get("RETROGRAPH_DATA", ROOT.parent / "shared" / "data"))


def judge_program() -> Path:
    """The judge of real frames; it is stored beside them and is not part of the project."""
    return data_folder().parent / "tools" / "judge_balls.py"


def available(name: str) -> bool:
    """Whether the set and the judge exist."""
    return frame_set_file(name).is_file() and judge_program().is_file()


def judge_set(name: str, out: Path, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """Verdict of the judge on a set calibrated and reconstructed into the folder `out`."""
    reconstruct_frame_set(load_frame_set(frame_set_file(name)), out, report_progress=report_progress)
    report_progress("judging")
    return judge_results(name, out)


def frame_set_file(name: str) -> Path:
    """The file that describes a set."""
    return data_folder() / name / "frameset.toml"


def judge_results(name: str, results: Path) -> dict[str, Any]:
    """Verdict of the judge on the result files of a set."""
    run = subprocess.run(
        [sys.executable, str(judge_program()), str(data_folder() / name), str(results)],
        check=True,
        capture_output=True,
        text=True,
    )
    verdict: dict[str, Any] = json.loads(run.stdout)
    return verdict
