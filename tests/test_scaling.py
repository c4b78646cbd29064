"""The simulated cluster and the fleet's bill follow closed forms where there are some."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from tests.benchmarks.scaling.cluster_simulation import Cluster, simulate
from tests.benchmarks.scaling.fleet import MEASURED, Fleet, bill
from tests.benchmarks.scaling.scan_costs import ScanCost

ROOT = Path(__file__).parent.parent
COST = ScanCost("1456x1088", (0.9, 1.0, 1.1), 2_000_000, 8_000_000)
FAST = Cluster(dispatch_s=1e-9, storage_bytes_s=1e15)


def test_one_worker_does_one_scan_after_the_other() -> None:
    run = simulate(COST, Cluster(0.01, 100e6, 0.02), 1, 30)
    assert run.scans_s == pytest.approx(1.0 / (1.0 + 0.01 + 0.02 + 0.1))
    assert run.of_ideal == pytest.approx(1.1 / 1.13)
    assert run.storage_busy == pytest.approx(0.1 / 1.13)


@pytest.mark.parametrize("workers", [2, 16, 64])
def test_workers_who_share_nothing_scale_as_their_number(workers: int) -> None:
    equal = msgspec.structs.replace(COST, core_s=(1.0,))
    assert simulate(equal, FAST, workers, 10 * workers).of_ideal == pytest.approx(1.0, abs=1e-5)
    assert 0.95 < simulate(COST, FAST, workers, 40 * workers).of_ideal <= 1.0


def test_storage_and_program_bound_the_rate() -> None:
    stored = simulate(COST, Cluster(1e-9, 100e6), 64, 2000)
    assert stored.scans_s == pytest.approx(10.0, rel=0.02)
    assert stored.storage_busy > 0.98
    handed = simulate(COST, Cluster(0.05, 1e15), 64, 2000)
    assert handed.scans_s == pytest.approx(20.0, rel=0.02)
    assert handed.dispatch_busy > 0.98


def test_more_workers_than_scans_do_each_one() -> None:
    assert simulate(COST, FAST, 8, 3).scans_s == pytest.approx(3.0 / 1.1)


def test_the_bill_is_arithmetic() -> None:
    found = bill(COST, Fleet(handhelds=10, scans_a_day=360, work_h=10.0, done_h=2.0, days=100, core_share=0.5))
    assert found.scans == 3600
    assert found.tb_a_day == pytest.approx(0.036)
    assert found.tb_kept == pytest.approx(3.6)
    assert found.mbit_s == pytest.approx(8.0 * 3600 * 2.0 / 36000.0)
    assert found.cores == pytest.approx(1.0)  # an hour of computing, half of a core's time, in two hours
    assert found.cores_price == pytest.approx(2.0 * 0.04)
    assert found.storage_price == pytest.approx(3600.0 * 0.023)
    assert found.frames_tb_kept == pytest.approx(0.72)
    assert found.frames_price == pytest.approx(720.0 * 0.023)
    assert found.requests_price == pytest.approx(3600 * 20 / 1000.0 * 0.005)


def test_the_command_prints_the_tables_of_the_document() -> None:
    """Those of docs/scaling.md are what it prints of the measured costs."""
    ran = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.scaling.fleet"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "| 64 |" in ran.stdout
    assert ran.stdout.strip() in (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    assert len(msgspec.json.decode(MEASURED.read_bytes(), type=list[ScanCost])) == 2
