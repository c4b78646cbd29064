"""A 5 x 5 mosaic of a ruler on the twin's skin: its length over 60 mm, its seams, and the overlaps that are wrong.

    python -m tests.benchmarks.mosaic.ruler [--side 5] [--out DIR]

The twin's skin is draped over the ruler at each press, shifted and turned as by a hand; its slopes get the errors of
a calibration (noise, patches, a gain that changes over the field) and are integrated, as for pairs of presses.
Graduations repeat each millimetre: a wrong overlap looks right but for numbers and the grain of the metal.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.align import Pose, turning
from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.mosaic.adjustment import adjusted
from host_sync.mosaic.links import Layout
from host_sync.mosaic.presses import Press
from host_sync.mosaic.stitch import planned, stitch
from host_sync.mosaic.writing import MosaicRecord
from host_sync.registration.fit import between_pixels
from host_sync.results.reader import read_result

sys.path.insert(0, str(Path(__file__).parents[2] / "apparatus"))

from mosaic_presses import press_of_map
from press_pairs import PITCH_MM, SHAPE, Hand, press

GRAIN_MM: Final = 0.02
"""Pixel of the ruler's own map."""

SIZE_MM: Final = (56.0, 84.0)
LENGTH_MM: Final = 60.0
ROW_MM: Final = 7.0
"""Distance of its scales."""

RAISED_MM: Final = 0.04
"""Graduations are raised: a skin bridges cuts as narrow as those of a ruler."""

PRESSED_MM: Final = 0.4
STEP_MM: Final = (9.1, 12.2)
WRONG: Final = 50


@dataclass(frozen=True, slots=True, eq=False)
class ReliefMap:
    """A surface given by its heights at `GRAIN_MM`.

    map_mm : float32 array, heights, highest 0; x to the right and y upwards from its middle
    """

    map_mm: Float32Array

    def height_mm(self, x_mm: Float64Array, y_mm: Float64Array) -> Float64Array:
        """Height (mm), NaN outside the map."""
        rows, columns = self.map_mm.shape
        row = (0.5 * (rows - 1) - y_mm / GRAIN_MM).astype(np.float32)
        column = (0.5 * (columns - 1) + x_mm / GRAIN_MM).astype(np.float32)
        return np.asarray(between_pixels(self.map_mm, row, column), np.float64)


def ruler_map(seed: int = 12) -> ReliefMap:
    """Scales with graduations each millimetre, longer each five and ten, and numbers, on ground metal."""
    rows, columns = (round(size / GRAIN_MM) for size in SIZE_MM)
    cut = np.zeros((rows, columns), np.uint8)
    for scale, y_mm in enumerate(np.arange(-21.0, 22.0, ROW_MM)):
        for graduation in range(-40, 41):
            long_mm = 4.0 if graduation % 10 == 0 else 2.6 if graduation % 5 == 0 else 1.6
            ends = [_pixel(graduation, y_mm), _pixel(graduation, y_mm + long_mm)]
            cv2.line(cut, ends[0], ends[1], 255, round(0.14 / GRAIN_MM), cv2.LINE_AA)
            if graduation % 5 == 0:
                at = _pixel(graduation + 0.25, y_mm + 2.9)
                words = f"{scale}{graduation + 40:02d}"
                cv2.putText(cut, words, at, cv2.FONT_HERSHEY_SIMPLEX, 1.6, 255, 5, cv2.LINE_AA)
    depth = cv2.GaussianBlur(cut.astype(np.float32) / 255.0, (0, 0), 0.03 / GRAIN_MM)
    random = np.random.default_rng(seed)
    # Grinding leaves scratches across the scales, a few micrometres deep.
    ground = cv2.GaussianBlur(random.standard_normal((rows, columns)).astype(np.float32), (0, 0), 4.0, sigmaY=20.0)
    z_mm = RAISED_MM * depth + np.float32(0.003) * ground / ground.std()
    return ReliefMap((z_mm - z_mm.max()).astype(np.float32))


def _pixel(x_mm: float, y_mm: float) -> tuple[int, int]:
    """Column and row of the ruler's map."""
    return round(0.5 * SIZE_MM[1] / GRAIN_MM + x_mm / GRAIN_MM), round(0.5 * SIZE_MM[0] / GRAIN_MM - y_mm / GRAIN_MM)


def places(side: int, random: np.random.Generator) -> list[Pose]:
    """Where presses lie on the ruler (px; rows downwards): a grid, half a millimetre and two degrees off."""
    return [
        Pose(
            (row - 0.5 * (side - 1)) * STEP_MM[0] / PITCH_MM + random.normal(0.0, 10.0),
            (column - 0.5 * (side - 1)) * STEP_MM[1] / PITCH_MM + random.normal(0.0, 10.0),
            float(np.radians(random.normal(0.0, 2.0))),
        )
        for row in range(side)
        for column in range(side)
    ]


def pressed(ruler: ReliefMap, place: Pose, depth_mm: float, random: np.random.Generator) -> HeightMap:
    """The press at a place."""
    turn = place.turn
    x_mm, y_mm = place.right * PITCH_MM, -place.down * PITCH_MM
    cosine, sine = float(np.cos(turn)), float(np.sin(turn))
    hand = Hand(-(cosine * x_mm - sine * y_mm), -(sine * x_mm + cosine * y_mm), turn, depth_mm)
    return press(ruler, hand, random)


def press_sigma_um(ruler: ReliefMap, place: Pose) -> float:
    """Standard uncertainty of a height, µm: what two presses of one place are apart, a plane taken off, over √2."""
    maps = [pressed(ruler, place, PRESSED_MM, np.random.default_rng(seed)).z_um for seed in (1, 2)]
    apart = (maps[1] - maps[0]).astype(np.float64)
    row, column = np.meshgrid(*(np.linspace(-1.0, 1.0, size) for size in SHAPE), indexing="ij")
    design = np.stack([np.ones(apart.size), row.ravel(), column.ravel()], axis=-1)
    rest = apart.ravel() - design @ np.linalg.lstsq(design, apart.ravel(), rcond=None)[0]
    return float(rest.std() / np.sqrt(2.0))


def true_presses(ruler: ReliefMap, truth: list[Pose], random: np.random.Generator) -> list[Press]:
    """Presses of different depth at the places, each with a level of its own."""
    sigma_um = press_sigma_um(ruler, truth[len(truth) // 2])
    presses = []
    for number, place in enumerate(truth):
        z_um = pressed(ruler, place, PRESSED_MM * random.uniform(0.9, 1.1), random).z_um
        row, column = np.meshgrid(*(np.linspace(-0.5, 0.5, size) for size in SHAPE), indexing="ij")
        level = random.normal(0.0, 20.0) + random.normal(0.0, 20.0) * row + random.normal(0.0, 20.0) * column
        presses.append(press_of_map(f"press-{number:02d}", (z_um + level).astype(np.float32), sigma_um))
    return presses


def said_layout(truth: list[Pose], within_mm: float, random: np.random.Generator) -> Layout:
    """Where a person who moves along the ruler says that the presses are: a quarter of `within_mm` off."""
    off = random.normal(0.0, 0.25 * within_mm / PITCH_MM, (len(truth), 2))
    return Layout(np.array([[place.down, place.right] for place in truth]) + off, within_mm / PITCH_MM)


def lengths_mm(z_um: Float32Array, record: MosaicRecord, truth: list[Pose]) -> list[float]:
    """Measured length of `LENGTH_MM` on every scale: distance of two graduations, found in the mosaic's heights."""
    found = np.array([[place.row_px, place.column_px] for place in record.presses])
    real = np.array([[place.down, place.right] for place in truth])
    # Where to look for graduations; how long the ruler is comes from what is found there.
    one, other = found - found.mean(axis=0), real - real.mean(axis=0)
    turn = float(np.arctan2((other[:, 1] * one[:, 0] - other[:, 0] * one[:, 1]).sum(), (one * other).sum()))
    to_mosaic = turning(turn)
    measured = []
    for y_mm in np.arange(-21.0, 22.0, ROW_MM):
        ends = []
        for x_mm in (-0.5 * LENGTH_MM, 0.5 * LENGTH_MM):
            line_mm = np.stack(np.meshgrid(y_mm + np.linspace(0.3, 1.3, 24), x_mm + np.linspace(-0.45, 0.45, 181)), -1)
            on_ruler = np.stack([-line_mm[..., 0], line_mm[..., 1]], axis=-1) / PITCH_MM - real.mean(axis=0)
            at = on_ruler @ to_mosaic.T + found.mean(axis=0)
            if (at < 2).any() or (at > np.array(z_um.shape) - 3).any():
                break
            profile = between_pixels(z_um, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)).mean(axis=1)
            high = np.clip(profile - np.median(profile) - 4.0, 0.0, None)
            if not np.isfinite(profile).all() or not high.max() > 5.0:
                break
            ends.append(float((line_mm[:, 0, 1] * high).sum() / high.sum()))
        if len(ends) == 2:
            measured.append(ends[1] - ends[0])
    return measured


def write(line: str) -> None:
    """Write one line."""
    sys.stdout.write(line + "\n")


def main(arguments: list[str] | None = None) -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", type=int, default=5)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--within-mm", type=float, default=2.0, help="how far off the layout is said to be; 0: none")
    options = parser.parse_args(arguments)
    random = np.random.default_rng(options.seed)
    ruler = ruler_map()
    truth = places(options.side, random)
    presses = true_presses(ruler, truth, random)
    layout = said_layout(truth, options.within_mm, random) if options.within_mm else None
    with tempfile.TemporaryDirectory() as folder:
        out = options.out or Path(folder) / "ruler"
        started = time.perf_counter()
        record = stitch(presses, out, layout=layout)
        taken_s = time.perf_counter() - started
        z_um = read_result(out).height.z_um
    each_s = taken_s / len(presses)
    write(f"{len(record.presses)} of {len(presses)} presses, {len(record.used)} overlaps, {each_s:.2f} s a press")
    measured = lengths_mm(z_um, record, truth)
    for length_mm in measured:
        write(f"length: {length_mm:.4f} mm of {LENGTH_MM:g} mm ({100.0 * (length_mm / LENGTH_MM - 1.0):+.4f} %)")
    write(f"span: {record.span_um * 1e-3:.3f} mm, σ {record.span_sigma_um:.1f} µm")
    seams = [link.seam_sigmas or 0.0 for link in record.used]
    beyond = [link.seam_beyond_2_sigmas or 0.0 for link in record.used]
    write(f"seams: worst {max(seams):.2f} σ (rms over its overlap), median {np.median(seams):.2f} σ")
    write(f"{100.0 * float(np.mean(beyond)):.1f} % of the overlaps differ by more than 2 σ")
    write(f"stretch: {100.0 * (record.stretch_median or 0.0):+.4f} %")
    _wrong(presses, truth, layout, random)
    write(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
    return 0


def _wrong(presses: list[Press], truth: list[Pose], layout: Layout | None, random: np.random.Generator) -> None:
    """Print what becomes of overlaps that look right and are wrong."""
    plan = planned(presses, layout=layout)
    off = []
    for link in plan.links:
        said = truth[link.first].then(truth[link.second].back()).of(link.here)
        off.append(float(np.hypot(*(link.there - said))))
    wrong = [value > 5.0 for value in off]
    used = plan.adjusted.used
    both = list(zip(wrong, used, strict=True))
    write(
        f"overlaps accepted by themselves: {len(off)}, {sum(wrong)} wrong by more than 5 px; used: "
        f"{sum(two for one, two in both if one)} wrong, {sum(two for one, two in both if not one)} right"
    )
    right = [link for link, bad in zip(plan.links, wrong, strict=True) if not bad]
    made = []
    while len(made) < WRONG:
        model = right[int(random.integers(len(right)))]
        one, other = sorted(int(press) for press in random.choice(len(presses), 2, replace=False))
        away = random.integers(-3, 4, 2) / PITCH_MM  # whole graduations
        if not away.any():
            continue
        if len(made) % 2:  # half of them between the presses of a right link, half between any two
            one, other = model.first, model.second
        made.append(dataclasses.replace(model, first=one, second=other, there=model.there + away))
    reach_px = 0.5 * float(np.hypot(*SHAPE))
    found = adjusted([*right, *made], len(presses), reach_px)
    errors = [
        place.then(found.places[0].back()).distance(real.then(truth[0].back()), 0.0)
        for place, real in zip(found.places, truth, strict=True)
        if place is not None and found.places[0] is not None
    ]
    rejected = sum(not one for one in found.used[len(right) :])
    kept = sum(found.used[: len(right)])
    write(f"made: {rejected} of {WRONG} wrong overlaps rejected, {kept} of {len(right)} right ones used")
    write(f"places off by at most {max(errors):.2f} px")


if __name__ == "__main__":
    raise SystemExit(main())
