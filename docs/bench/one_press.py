"""One press of the handheld: virtual time of the twin for what the hand waits for, CPU time for what is computed.

The board's own drivers run over the twin, with real rhythms of the indicator; the twin computes in no time at all, so
the CPU time that the same step took on this machine is added where something waits for it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
from fresh import fresh
from plan import Plan, Shape, named
from specimen import BALL_RADIUS_MM, twin_of

from device.bundle_store import BundleStore
from device.session.events import Event, MayLift, PressRefused, PressSeen, ScanFinished
from device.session.instrument import Instrument
from hal.clock import VirtualClock
from hal.interfaces import ButtonPress
from hal.rhythm_indicator import RHYTHMS
from hal.twin.bench import Bench, build
from hal.twin.gallery import exhibit
from hal.twin.scene import Press
from hal.twin.wired.hardware import wired_hardware

PRESSES = 20
APART_S = 3.0
PHASE_S = 0.0037
"""Each push comes a little later within a frame than the one before."""


def measure(plan: Plan, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Every figure of one press, on a twin of the reference's size."""
    shape = plan.calibrated if plan.quick else plan.small
    tell(f"one press, {named(shape)}")
    calibration_s = fresh(calibrated, shape, folder / "one-press", threads=1)
    return fresh(presses, shape, folder / "one-press", min(PRESSES, 2 * plan.rounds), threads=1) | {
        "calibration_virtual_s": calibration_s
    }


def calibrated(shape: Shape, folder: Path) -> float:
    """Virtual seconds of a guided calibration of a twin of (H, W) pixels, published to a store in `folder`."""
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
    """The longest that anybody waited, over so many presses of a coin."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    began_s = time.process_time()
    bench, instrument = _instrument(shape, folder)
    with instrument:
        instrument.step()
        start_s = time.process_time() - began_s
        coin = exhibit("coin")
        bench.place(Press(coin.surface, (0.0, 0.0), 0.0, coin.indentation_mm))
        waits: list[dict[str, float]] = []
        coach_ms: list[float] = []
        live_ns: list[int] = []
        for number in range(count):
            pushed_ns = _push(bench, 1.0 + number * PHASE_S)
            events = list(_events(bench, instrument, APART_S, coach_ms, live_ns))
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


def _instrument(shape: Shape, folder: Path) -> tuple[Bench, Instrument]:
    clock = VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)
    wired = wired_hardware(build(twin_of(shape), clock), "PCA9955B")
    return wired.bench, Instrument(wired.hardware, BundleStore(folder, clock, boot_id="b0075e1f"))


def _push(bench: Bench, in_s: float, held_s: float = 0.12) -> int:
    """Somebody pushes the button then; says when, ns."""
    at_ns = bench.clock.monotonic_ns() + round(in_s * 1e9)
    bench.schedule_button(ButtonPress(at_ns, held_s))
    return at_ns


def _events(
    bench: Bench, instrument: Instrument, for_s: float, coach_ms: list[float], live_ns: list[int]
) -> Iterator[Event]:
    """What happens within so many seconds, live readings noted on the way."""
    end_ns = bench.clock.monotonic_ns() + round(for_s * 1e9)
    while bench.clock.monotonic_ns() < end_ns:
        instrument.step()
        live = instrument.state.live
        if live and live.at_ns not in live_ns[-1:]:
            coach_ms.append(live.reading.cpu_ms)
            live_ns.append(live.at_ns)
        yield from instrument.take_events()


def _waits(events: list[Event], pushed_ns: int) -> dict[str, float]:
    """How long after the push each thing happened, ms: virtual time, and with the CPU time of judging and storing."""
    seen = next(event for event in events if isinstance(event, PressSeen))
    lift = next(event for event in events if isinstance(event, MayLift))
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


def _refused_ms(bench: Bench, instrument: Instrument) -> float:
    """How long after the push a press of a gel without a calibration is refused, ms."""
    instrument.change_gel("bench-without-calibration")
    instrument.step()
    instrument.take_events()
    pushed_ns = _push(bench, 0.5)
    refused = [event for event in _events(bench, instrument, 2.0, [], []) if isinstance(event, PressRefused)]
    return (refused[0].at_ns - pushed_ns) * 1e-6
