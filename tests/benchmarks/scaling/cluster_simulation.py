"""A simulated cluster: how many scans an hour so many workers reconstruct, by measured costs of a scan.

A discrete simulation in virtual time of what `retrosync reconstruct --cluster` does. A worker asks for its next scan
when it has done one. Two things are shared and serve one request after the other, in the order of arrival: the
program that hands out scans, and the storage that raw frames are read from and results are written to.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field

from tests.benchmarks.scaling.scan_costs import ScanCost


@dataclass(frozen=True)
class Cluster:
    """What is shared.

    dispatch_s : time of the program that hands out scans, for one scan
    latency_s : a worker waits so long for its next scan besides; this is not shared
    storage_bytes_s : rate of the shared storage, for all workers together
    """

    dispatch_s: float
    storage_bytes_s: float
    latency_s: float = 0.0


@dataclass
class _Shared:
    """Serves one request at a time; knows when it is free."""

    free_s: float = 0.0
    busy_s: float = field(default=0.0)

    def serve(self, asked_s: float, takes_s: float) -> float:
        """When a request is done."""
        self.free_s = max(asked_s, self.free_s) + takes_s
        self.busy_s += takes_s
        return self.free_s


@dataclass(frozen=True)
class Run:
    """What a simulated cluster did.

    scans_s : scans per second
    of_ideal : that over what the workers would do if storage were theirs alone and scans came at once
    storage_busy, dispatch_busy : fraction of the time in which what is shared was busy
    """

    workers: int
    scans_s: float
    of_ideal: float
    storage_busy: float
    dispatch_busy: float


def simulate(cost: ScanCost, cluster: Cluster, workers: int, scans: int) -> Run:
    """Reconstruct so many scans with so many workers; a scan takes the measured times in turns."""
    dispatcher, storage = _Shared(), _Shared()
    steps = _steps(cost, cluster)
    waiting = list(range(scans))[::-1]
    # When, the worker (which decides between equal times), the scan and its next step.
    events: list[tuple[float, int, int, int]] = [
        (0.0, worker, waiting.pop(), 0) for worker in range(min(workers, scans))
    ]
    heapq.heapify(events)
    end_s = 0.0
    while events:
        now_s, worker, scan, step = heapq.heappop(events)
        if step == len(steps):
            end_s = max(end_s, now_s)
            if waiting:
                heapq.heappush(events, (now_s, worker, waiting.pop(), 0))
            continue
        name, takes_s = steps[step]
        if name == "compute":
            done_s = now_s + cost.core_s[scan % len(cost.core_s)]
        elif name == "wait":
            done_s = now_s + takes_s
        else:
            done_s = (dispatcher if name == "dispatch" else storage).serve(now_s, takes_s)
        heapq.heappush(events, (done_s, worker, scan, step + 1))
    alone_s = cost.mean_core_s + sum(takes_s for name, takes_s in steps if name in {"read", "write"})
    rate = scans / end_s
    return Run(workers, rate, rate / (workers / alone_s), storage.busy_s / end_s, dispatcher.busy_s / end_s)


def _steps(cost: ScanCost, cluster: Cluster) -> Sequence[tuple[str, float]]:
    """What a scan goes through, and how long each takes where it is served at once."""
    return (
        ("dispatch", cluster.dispatch_s),
        ("wait", cluster.latency_s),
        ("read", cost.raw_bytes / cluster.storage_bytes_s),
        ("compute", 0.0),
        ("write", cost.result_bytes / cluster.storage_bytes_s),
    )
