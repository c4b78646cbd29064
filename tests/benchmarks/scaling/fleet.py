"""What a fleet of handhelds costs in storage, network, cores and money, and how a cluster scales, from measured costs.

usage: python -m tests.benchmarks.scaling.fleet [--costs costs.json] [--help: every assumption, and the option for it]

The costs of a scan are those of `tests.benchmarks.scaling.scan_costs`; everything else is an assumption that an option
changes. Prices are assumptions too, not anybody's offer.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from tests.benchmarks.scaling.cluster_simulation import Cluster, simulate
from tests.benchmarks.scaling.scan_costs import ScanCost

MEASURED = Path(__file__).with_name("costs.json")
WORKERS = (1, 2, 4, 8, 16, 32, 64)
SCANS_A_WORKER = 40
"""Scans of a simulation, for each worker."""


@dataclass(frozen=True)
class Fleet:
    """Assumptions.

    handhelds, scans_a_day : each takes so many scans on a day of work
    work_h : hours of a day in which scans are taken, evenly
    done_h : hours in which a day's scans must be reconstructed
    days : days of work that are kept
    core_share : fraction of a core's time that computes scans
    core_h_price, gb_month_price, request_price : money for an hour of a core, a gigabyte stored for a month, and a
        thousand writes to the object store
    files_a_scan : files of a scan and its results, each a write
    """

    handhelds: int = 1000
    scans_a_day: int = 200
    work_h: float = 8.0
    done_h: float = 24.0
    days: int = 250
    core_share: float = 0.8
    core_h_price: float = 0.04
    gb_month_price: float = 0.023
    request_price: float = 0.005
    files_a_scan: int = 20


@dataclass(frozen=True)
class Bill:
    """What a fleet takes.

    tb_a_day : stored for each day of work, terabytes (10^12 bytes)
    tb_kept, frames_tb_kept : of all days that are kept, and of their raw frames alone
    mbit_s : arriving while scans are taken, on average
    cores : that must be there
    cores_price, requests_price : money for a day of work's cores and writes
    storage_price, frames_price : for a month of all that is kept, and of the raw frames alone
    """

    scans: int
    tb_a_day: float
    tb_kept: float
    frames_tb_kept: float
    mbit_s: float
    cores: float
    cores_price: float
    storage_price: float
    frames_price: float
    requests_price: float


def bill(cost: ScanCost, fleet: Fleet) -> Bill:
    """What the fleet takes when every scan costs this."""
    scans = fleet.handhelds * fleet.scans_a_day
    kept_bytes = scans * (cost.raw_bytes + cost.result_bytes)
    frames_bytes = fleet.days * scans * cost.raw_bytes
    core_h = scans * cost.mean_core_s / 3600.0 / fleet.core_share
    return Bill(
        scans=scans,
        tb_a_day=kept_bytes / 1e12,
        tb_kept=fleet.days * kept_bytes / 1e12,
        frames_tb_kept=frames_bytes / 1e12,
        mbit_s=8.0 * scans * cost.raw_bytes / (3600.0 * fleet.work_h) / 1e6,
        cores=core_h / fleet.done_h,
        cores_price=core_h * fleet.core_h_price,
        storage_price=fleet.days * kept_bytes / 1e9 * fleet.gb_month_price,
        frames_price=frames_bytes / 1e9 * fleet.gb_month_price,
        requests_price=scans * fleet.files_a_scan / 1000.0 * fleet.request_price,
    )


def tables(costs: Sequence[ScanCost], fleet: Fleet, cluster: Cluster) -> Iterator[str]:
    """Lines of Markdown: a scan, the fleet, and the simulated cluster."""
    yield "| a scan | core, s | raw frame, MB | results, MB |"
    yield "| --- | --- | --- | --- |"
    for cost in costs:
        yield f"| {cost.size} | {cost.mean_core_s:.2f} | {cost.raw_bytes / 1e6:.2f} | {cost.result_bytes / 1e6:.2f} |"
    yield ""
    yield "| the fleet | " + " | ".join(cost.size for cost in costs) + " |"
    yield "| --- |" + " --- |" * len(costs)
    bills = [bill(cost, fleet) for cost in costs]
    for words, values in (
        ("scans a day", [f"{one.scans}" for one in bills]),
        ("arriving while scans are taken, Mbit/s", [f"{one.mbit_s:.0f}" for one in bills]),
        ("cores", [f"{one.cores:.1f}" for one in bills]),
        ("stored a day, TB", [f"{one.tb_a_day:.2f}" for one in bills]),
        (f"stored after {fleet.days} days, TB", [f"{one.tb_kept:.0f}" for one in bills]),
        ("raw frames alone, TB", [f"{one.frames_tb_kept:.0f}" for one in bills]),
        ("cores, money a day", [f"{one.cores_price:.0f}" for one in bills]),
        ("writes to the object store, money a day", [f"{one.requests_price:.0f}" for one in bills]),
        (f"a month of what {fleet.days} days leave, money", [f"{one.storage_price:.0f}" for one in bills]),
        ("a month of the raw frames alone, money", [f"{one.frames_price:.0f}" for one in bills]),
    ):
        yield f"| {words} | " + " | ".join(values) + " |"
    for cost in costs:
        yield ""
        yield f"| workers, {cost.size} | scans an hour | of ideal | storage busy | program busy |"
        yield "| --- | --- | --- | --- | --- |"
        for workers in WORKERS:
            run = simulate(cost, cluster, workers, SCANS_A_WORKER * workers)
            shares = " | ".join(
                f"{100.0 * share:.0f} %" for share in (run.of_ideal, run.storage_busy, run.dispatch_busy)
            )
            yield f"| {workers} | {3600.0 * run.scans_s:.0f} | {shares} |"


def main() -> int:
    """Print the tables; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--costs", type=Path, default=MEASURED, help="file of scan_costs")
    parser.add_argument("--dispatch-ms", type=float, default=6.2, help="the program's time for one scan")
    parser.add_argument("--latency-ms", type=float, default=25.0, help="a worker's wait for its next scan besides")
    parser.add_argument("--storage-mb-s", type=float, default=1000.0, help="rate of the storage that workers share")
    for name, value in asdict(Fleet()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value, help="assumed")
    options = vars(parser.parse_args())
    costs = msgspec.json.decode(options.pop("costs").read_bytes(), type=list[ScanCost])
    cluster = Cluster(
        options.pop("dispatch_ms") / 1e3, options.pop("storage_mb_s") * 1e6, options.pop("latency_ms") / 1e3
    )
    for line in tables(costs, Fleet(**options), cluster):
        sys.stdout.write(f"{line}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
