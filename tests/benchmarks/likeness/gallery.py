"""Recall of search by likeness on the twin's gallery, and its time with 10,000 entries.

    python -m tests.benchmarks.likeness.gallery [--presses 6] [--seed 100] [--spreads]

Every specimen of the gallery is pressed several times by hand: shifted by up to 1 mm, turned by any angle, 0.85 to
1.15 times as deep as usual, with the slope errors of a calibration. Every press asks for the five most alike of all
others: recall@5 is the share of the right specimen's presses among them. The spreads were taken at seed 0.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hal.simulator.gallery import gallery_names, specimen
from host_sync.likeness.descriptor import LENGTH, describe
from host_sync.likeness.index import Entry, LikenessIndex
from host_sync.likeness.search import nearest

sys.path.insert(0, str(Path(__file__).parents[2] / "apparatus"))

from press_pairs import Hand, press


def gallery_presses(count: int, seed: int) -> tuple[list[str], np.ndarray]:
    """Names and descriptors, float32 array of shape (8 count, LENGTH), of the presses of every specimen."""
    random = np.random.default_rng(seed)
    names, rows = [], []
    for name in gallery_names():
        item = specimen(name)
        for _ in range(count):
            x, y = random.uniform(-1.0, 1.0, 2)
            hand = Hand(x, y, random.uniform(-np.pi, np.pi), item.indentation_mm * random.uniform(0.85, 1.15))
            names.append(name)
            rows.append(describe(press(item.surface, hand, random)))
    return names, np.array(rows)


def recall_at_5(names: list[str], rows: np.ndarray) -> float:
    """Share of presses of the right specimen among the five nearest of every press."""
    hits = 0
    for number, name in enumerate(names):
        others = [at for at in range(len(names)) if at != number]
        found = nearest(rows[number], rows[others], 5)
        hits += sum(names[others[at]] == name for at, _ in found)
    return hits / (5 * len(names))


def search_time_s(count: int) -> float:
    """Time to open an index on disk with `count` entries, to read all of it and to find the five nearest, s."""
    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        with LikenessIndex(Path(folder)) as index:
            rows = random.standard_normal((count, LENGTH)).astype(np.float32)
            for number, row in enumerate(rows):
                index.put(f"scans/{number:06d}/results/one", Entry("stamp", row, None))
        started = time.perf_counter()
        with LikenessIndex(Path(folder)) as index:
            held = index.read()
        nearest(rows[7], np.array([entry.row for entry in held.values()]), 5)
        return time.perf_counter() - started


def main() -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--spreads", action="store_true")
    options = parser.parse_args()
    names, rows = gallery_presses(options.presses, options.seed)
    if options.spreads:
        by_name = rows.reshape(len(gallery_names()), options.presses, LENGTH)
        spreads = np.sqrt(by_name.var(axis=1, ddof=1).mean(axis=0))
        sys.stdout.write(", ".join(f"{spread:.3f}" for spread in spreads) + "\n")
    sys.stdout.write(f"recall@5 of {len(names)} presses, seed {options.seed}: {100 * recall_at_5(names, rows):.1f} %\n")
    sys.stdout.write(f"one search of 10,000 entries on disk: {search_time_s(10_000):.3f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
