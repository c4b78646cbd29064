"""Frames of real sensors: calibrated, reconstructed and judged against the sphere, with labels and without."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from host_sync.cli.main import main

SHARED = Path(__file__).parents[3] / "shared"
DATA = Path(os.environ.get("RETROGRAPH_DATA", SHARED / "data"))
JUDGE = DATA.parent / "tools" / "judge_balls.py"
LABELLED = {"oem-bga": 55, "taxim-small": 10, "finger": 23}
WORST_SURFACE_DEG = {"oem-bga": 2.0, "taxim-small": 3.4, "finger": 3.5}

pytestmark = pytest.mark.skipif(
    not (DATA / "oem-bga").is_dir() or not JUDGE.is_file(),
    reason=f"no real frames in {DATA} with their judge beside them: set RETROGRAPH_DATA",
)


def judge(frame_set: Path, results: Path) -> dict[str, Any]:
    """What the judge says of result files, from a process of its own."""
    done = subprocess.run(
        [sys.executable, str(JUDGE), str(frame_set), str(results)], check=True, capture_output=True, text=True
    )
    verdict: dict[str, Any] = json.loads(done.stdout)
    return verdict


@pytest.mark.parametrize(
    "name", ["finger", *(pytest.param(name, marks=pytest.mark.slow) for name in ("oem-bga", "taxim-small"))]
)
def test_every_labelled_ball_is_reconstructed(name: str, tmp_path: Path) -> None:
    assert main(["reconstruct", str(DATA / name / "frameset.toml"), "--out", str(tmp_path)]) == 0
    verdict = judge(DATA / name, tmp_path)
    assert verdict["balls"] == LABELLED[name]
    assert verdict["lost"] == 0
    assert verdict["masked"] <= 0.03
    assert verdict["surface"]["mean"] <= WORST_SURFACE_DEG[name]
    assert verdict["radius_ratio_median"] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_a_ball_grid_without_labels_calibrates_as_well(tmp_path: Path) -> None:
    folder = DATA / "oem-bga"
    text = (folder / "frameset.toml").read_text()
    unlabelled = re.sub(r"^balls = \[.*?^\]", "", text, flags=re.DOTALL | re.MULTILINE)
    assert "balls" not in unlabelled
    for entry in folder.iterdir():
        if entry.is_dir():
            (tmp_path / entry.name).symlink_to(entry.resolve())
    (tmp_path / "frameset.toml").write_text(unlabelled)
    out = tmp_path / "out"
    assert main(["reconstruct", str(tmp_path / "frameset.toml"), "--out", str(out)]) == 0
    verdict = judge(folder, out)
    assert verdict["lost"] == 0
    assert verdict["surface"]["mean"] <= 2.6
    report = json.loads((out / "calibration" / "report.json").read_text())
    assert sum(len(press["balls"]) for press in report["presses"]) >= 50
