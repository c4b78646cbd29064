"""Every kind of foreign frame by every frame of some frame sets: how many are refused, and why; honest ones as well.

usage: python tests/benchmarks/accuracy/foreign_frames.py FRAMESET.toml... [--per-set 24]

Frames of the other sets, scaled to a set's size, stand for those of another device.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import LinearFrame, estimate_flat_field, flat_field_correct, make_flat_field
from device.surface import Float32Array
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.frames.frame_set import FrameSet, load_frame_set
from host_sync.frames.linear_light import read_frame
from host_sync.results.record import FrameCheck, refusals

SATURATED: Final = 0.98


def dimmed(channel: int) -> Callable[[Float32Array], NDArray[np.floating]]:
    """A change that leaves 85 % of one channel."""
    return lambda rgb: rgb * np.where(np.arange(3) == channel, 0.85, 1.0)


KINDS: Final[dict[str, Callable[[Float32Array], NDArray[np.floating]]]] = {
    "honest": lambda rgb: rgb,
    "red 15 % weaker": dimmed(0),
    "green 15 % weaker": dimmed(1),
    "blue 15 % weaker": dimmed(2),
    "all 10 % darker": lambda rgb: 0.9 * rgb,
    "all 10 % brighter": lambda rgb: 1.1 * rgb,
    "shifted 12 columns": lambda rgb: np.roll(rgb, 12, axis=1),
    "shifted 12 rows": lambda rgb: np.roll(rgb, -12, axis=0),
    "mirrored": lambda rgb: rgb[:, ::-1],
    "upside down": lambda rgb: rgb[::-1],
    "turned 180 degrees": lambda rgb: rgb[::-1, ::-1],
    "channels B, G, R": lambda rgb: rgb[..., ::-1],
    "channels G, R, B": lambda rgb: rgb[..., [1, 0, 2]],
    "blurred 1.5 px": lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 1.5),
    "blurred 3 px": lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 3.0),
}


class Judged:
    """A frame set with its model, and every frame that its calibration did or did not see."""

    def __init__(self, frame_set: FrameSet, per_set: int) -> None:
        self.name = frame_set.path.parent.name
        presses = [read_frame(press.frame) for press in frame_set.presses]
        self.frames = [(scan.name, read_frame(scan.frame)) for scan in frame_set.scans][:per_set]
        reference = read_frame(frame_set.reference) if frame_set.reference else None
        everything = presses + [frame for _, frame in self.frames]
        self.flat_field = make_flat_field(reference) if reference else estimate_flat_field(everything)
        taught = [
            (flat_field_correct(frame, self.flat_field), list(press.balls or ()))
            for frame, press in zip(presses, frame_set.presses, strict=True)
        ]
        self.model = FrameModel.of(reference, self.flat_field, taught)
        self.frames += [(press.name, frame) for press, frame in zip(frame_set.presses, presses, strict=True)]
        del self.frames[per_set:]
        self.spent_s: list[float] = []

    def check(self, rgb: NDArray[np.floating]) -> tuple[FrameCheck, ...]:
        """What the model says of a frame's linear light."""
        rows, columns, _ = self.flat_field.shape
        if rgb.shape != self.flat_field.shape:
            rgb = cv2.resize(np.ascontiguousarray(rgb), (columns, rows), interpolation=cv2.INTER_AREA)
        light = np.ascontiguousarray(rgb, np.float32)
        clipped = np.asarray((light >= SATURATED).any(axis=-1))
        intensity = flat_field_correct(LinearFrame(light, clipped), self.flat_field)
        began_s = time.process_time()
        checks = self.model.check(intensity, self.flat_field)
        self.spent_s.append(time.process_time() - began_s)
        return checks


def _shown(frame: LinearFrame) -> Callable[[Float32Array], NDArray[np.floating]]:
    """A change that puts another frame in the place of any."""
    return lambda _: frame.rgb


def main() -> int:
    """Print the table of every set; 1 when an honest frame is refused or a foreign one passes every check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--per-set", type=int, default=24, help="frames of each set")
    arguments = parser.parse_args()
    judged = [Judged(load_frame_set(path), arguments.per_set) for path in arguments.sets]
    wrong = 0
    for one in judged:
        sys.stdout.write(f"{one.name}\n" + "".join(f"  {words}\n" for words in one.model.blind))
        others = [other for other in judged if other is not one]
        for line, missed in table(one, others):
            sys.stdout.write(line)
            sys.stdout.flush()
            wrong += missed
    return 1 if wrong else 0


def table(one: Judged, others: list[Judged]) -> Iterator[tuple[str, int]]:
    """A line for every kind, and how many frames of it were judged wrongly without saying that they could not be."""
    foreign = {
        f"frame of {other.name}": _shown(other.frames[i % len(other.frames)][1]) for i, other in enumerate(others)
    }
    for kind, change in {**KINDS, **foreign}.items():
        outcomes = [one.check(change(frame.rgb)) for _, frame in one.frames]
        spent_ms = 1e3 * float(np.median(one.spent_s[-len(outcomes) :]))
        refused = [words for checks in outcomes if (words := refusals(checks))]
        unsure = sum(any(c.outcome == "not checked" for c in checks) and not refusals(checks) for checks in outcomes)
        missed = len(refused) if kind == "honest" else len(outcomes) - len(refused) - unsure
        reason = refused[0][0] if refused else ""
        told = f"{len(refused)}/{len(outcomes)} refused, {unsure} not wholly checked, {spent_ms:.0f} ms"
        yield f"  {kind:20s} {told:50s} {reason}\n", missed


if __name__ == "__main__":
    sys.exit(main())
