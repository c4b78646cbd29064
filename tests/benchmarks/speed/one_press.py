"""One press of the handheld: virtual time of the twin for waiting, CPU time for computing.

The board's own drivers run on the twin, with the real rhythms of the indicator. The twin computes in zero virtual time,
so the CPU time of a step on this machine is added where something waits for it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2

from device.instrument.events import CaptureDone, Event, PressRefused, PressSeen, ScanFinished
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.clock import VirtualClock
from hal.drivers.gpio_lines import RHYTHMS
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from tests.benchmarks.speed.fresh import fresh
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.specimen import BALL_RADIUS_MM, twin_of

sys.path.insert(0, str(Path(__file__).parents[2] / "apparatus"))

from emulated_board import emulated_hardware

PRESSES = 20
APART_S = 3.0
SMALLEST: Shape = (272, 364)
"""On smaller twins noise hides what the lights' levels are, and every verdict waits."""

UNTOUCHED_S = 2.0
"""After the start the lights are measured on untouched skin, one by one."""

PHASE_S = 0.0037
"""Each push comes this much later within a frame than the previous one."""


def measure(plan: Plan, folder: Path, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """All figures of one press, on a twin of the reference size."""
    shape = SMALLEST if plan.quick else plan.small
    report_progress(f"one press, {named(shape)}")
    calibration_s = fresh(calibrated, shape, folder / "one-press", threads=1)
    return fresh(presses, shape, folder / "one-press", min(PRESSES, 2 * plan.rounds), threads=1) | {
        "calibration_virtual_s": calibration_s
    }


def calibrated(shape: Shape, folder: Path) -> float:
    """Virtual duration, s, of a guided calibration of a twin of (H, W) pixels, published to a store in `folder`."""
    bench, instrument = _instrument(shape, folder)
    began_ns = bench.clock.monotonic_ns()
    with instrument:
        instrument.start_calibration(BALL_RADIUS_MM)
        instrument.step()
        while instrument.state.guide is None or not instrument.state.guide.is_over:
            instrument.step()
        if instrument.state.guide.phase != "passed":
            raise RuntimeError(instrument.state.guide.instruction)
    return (bench.clock.monotonic_ns() - began_ns) * 1e-9


def presses(shape: Shape, folder: Path, count: int) -> dict[str, Any]:
    """Longest waiting times over this many presses of a coin."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    began_s = time.process_time()
    bench, instrument = _instrument(shape, folder)
    with instrument:
        instrument.step()
        start_s = time.process_time() - began_s
        list(_events(bench, instrument, UNTOUCHED_S, [], []))
        coin = specimen("coin")
        waits: list[dict[str, float]] = []
        coach_ms: list[float] = []
        live_ns: list[int] = []
        for number in range(count):
            bench.place(Press(coin.surface, (0.0, 0.0), 0.0, coin.indentation_mm))
            pushed_ns = _push(bench, 1.0 + number * PHASE_S)
            events = []
            for event in _events(bench, instrument, APART_S, coach_ms, live_ns):
                events.append(event)
                if isinstance(event, CaptureDone):
                    bench.place(None)  # the cue says so; the lights are seen on the skin that it leaves
            waits.append(_waits(events, pushed_ns))
        refused_ms = _refused_ms(bench, instrument)
    gaps_ms = [1e-6 * (after - before) for before, after in pairwise(live_ns)]
    longest = {name: max(wait[name] for wait in waits) for name in waits[0]}
    return longest | {
        "refused_ms": refused_ms,
        "coach_hz": 1e3 / sorted(gaps_ms)[len(gaps_ms) // 2],
        "coach_cpu_ms": sorted(coach_ms)[len(coach_ms) // 2],
        "opening_cpu_s": start_s,
        "presses": count,
        "size": named(shape),
    }


def _instrument(shape: Shape, folder: Path) -> tuple[SimulatedScene, Instrument]:
    clock = VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)
    emulated = emulated_hardware(build(twin_of(shape), clock), "PCA9955B")
    return emulated.bench, Instrument(emulated.hardware, BundleStore(folder, clock, boot_id="b0075e1f"))


def _push(bench: SimulatedScene, in_s: float, held_s: float = 0.12) -> int:
    """Schedule a push of the button; returns its time, ns."""
    at_ns = bench.clock.monotonic_ns() + round(in_s * 1e9)
    bench.schedule_button(ButtonPress(at_ns, held_s))
    return at_ns


def _events(
    bench: SimulatedScene, instrument: Instrument, for_s: float, coach_ms: list[float], live_ns: list[int]
) -> Iterator[Event]:
    """Events within this many seconds, with live readings recorded."""
    end_ns = bench.clock.monotonic_ns() + round(for_s * 1e9)
    while bench.clock.monotonic_ns() < end_ns:
        instrument.step()
        live = instrument.state.live
        if live and live.at_ns not in live_ns[-1:]:
            coach_ms.append(live.reading.cpu_ms)
            live_ns.append(live.at_ns)
        yield from instrument.take_events()


def _waits(events: list[Event], pushed_ns: int) -> dict[str, float]:
    """Time from the push to each event, ms: virtual time, plus the CPU time of verdict and storing."""
    seen = next(event for event in events if isinstance(event, PressSeen))
    lift = next(event for event in events if isinstance(event, CaptureDone))
    done = next(event for event in events if isinstance(event, ScanFinished))
    stored_ms = (done.at_ns - pushed_ns) * 1e-6 + done.cpu_ms
    return {
        "cue_ms": (seen.at_ns - pushed_ns) * 1e-6,
        "may_lift_ms": (lift.at_ns - pushed_ns) * 1e-6,
        "verdict_after_lift_ms": (done.at_ns - lift.at_ns) * 1e-6 + done.cpu_ms,
        "on_disk_ms": stored_ms,
        "preview_ms": stored_ms,
        "ready_again_ms": (done.at_ns - pushed_ns) * 1e-6 + 1e3 * sum(map(sum, RHYTHMS[done.verdict.level])),
        "publish_cpu_ms": done.cpu_ms,
    }


def _refused_ms(bench: SimulatedScene, instrument: Instrument) -> float:
    """Time from the push until a press of a gel without a calibration is refused, ms."""
    instrument.change_gel("bench-without-calibration")
    instrument.step()
    instrument.take_events()
    pushed_ns = _push(bench, 0.5)
    refused = [event for event in _events(bench, instrument, 2.0, [], []) if isinstance(event, PressRefused)]
    return (refused[0].at_ns - pushed_ns) * 1e-6
