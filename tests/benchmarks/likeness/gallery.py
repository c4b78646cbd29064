"""Recall of search by likeness on the twin's gallery, and its time with 10,000 entries.

    python -m tests.benchmarks.likeness.gallery [--presses 6] [--seed 100] [--whitening]

Every specimen of the gallery is pressed several times by hand: shifted by up to 1 mm, turned by any angle, 0.85 to
1.15 times as deep as usual, with the slope errors of a calibration. Every press asks for the five most alike of all
others: recall@5 is the share of the right specimen's presses among them. `--whitening` prints the factor of
`host_sync.likeness.search`, learned at seeds 0 to 7.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np

from device.io.atomic import RESULTS
from hal.simulator.operator import gallery_names, specimen
from host_sync.likeness.descriptor import LENGTH, describe
from host_sync.likeness.search import Entry, LikenessIndex, nearest, updated
from host_sync.results.files import RECORD_FILE

sys.path.insert(0, str(Path(__file__).parents[2] / "apparatus"))

from press_pairs import Hand, press

LEARNED: Final = range(8)
"""Seeds that teach the whitening."""

LEAST_SPREAD: Final = 0.02
LEAST_VARIANCE: Final = 0.3


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


def whitening(presses: list[tuple[list[str], np.ndarray]]) -> np.ndarray:
    """Lower triangular G: G^T times the difference of two presses of one specimen has unit covariance.

    The covariance is that of all presses about their specimen's mean, in units of the figures' own spreads (at least
    `LEAST_SPREAD`), and no direction of it varies less than `LEAST_VARIANCE`: of eight specimens no more can be told.
    """
    apart = []
    for names, rows in presses:
        for name in set(names):
            same = rows[[other == name for other in names]].astype(np.float64)
            apart.append((same - same.mean(axis=0)) * np.sqrt(len(same) / (len(same) - 1)))
    every = np.concatenate(apart)
    spreads = np.maximum(every.std(axis=0), LEAST_SPREAD)
    variances, directions = np.linalg.eigh((every / spreads).T @ (every / spreads) / len(every))
    inverse = (directions / np.maximum(variances, LEAST_VARIANCE)) @ directions.T / np.outer(spreads, spreads)
    return np.linalg.cholesky(inverse)


def recall_at_5(names: list[str], rows: np.ndarray) -> float:
    """Share of presses of the right specimen among the five nearest of every press."""
    hits = 0
    for number, name in enumerate(names):
        others = [at for at in range(len(names)) if at != number]
        found = nearest(rows[number], rows[others], 5)
        hits += sum(names[others[at]] == name for at, _ in found)
    return hits / (5 * len(names))


def search_time_s(count: int) -> float:
    """Time of one search in a library of `count` scans, whose index is up to date, s: every record looked at again."""
    random = np.random.default_rng(1)
    rows = random.standard_normal((count, LENGTH)).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        with LikenessIndex(Path(folder)) as index:
            for number, row in enumerate(rows):
                result = Path(f"scans/{number:06d}/{RESULTS}/one")
                (Path(folder) / result).mkdir(parents=True)
                (Path(folder) / result / RECORD_FILE).touch()
                facts = (Path(folder) / result / RECORD_FILE).stat()
                index.put(str(result), Entry(f"{facts.st_mtime_ns} {facts.st_size}", row, None))
        started = time.perf_counter()
        held = updated(Path(folder), _must_be_known)
        nearest(rows[7], np.array([entry.row for entry in held.values()]), 5)
        return time.perf_counter() - started


def _must_be_known(words: str) -> None:
    raise AssertionError(words)


def main() -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--whitening", action="store_true")
    options = parser.parse_args()
    if options.whitening:
        factor = whitening([gallery_presses(options.presses, seed) for seed in LEARNED])
        sys.stdout.write(", ".join(f"{value:.3g}" for value in factor[np.tril_indices(LENGTH)]) + "\n")
        return 0
    names, rows = gallery_presses(options.presses, options.seed)
    sys.stdout.write(f"recall@5 of {len(names)} presses, seed {options.seed}: {100 * recall_at_5(names, rows):.1f} %\n")
    sys.stdout.write(f"one search in a library of 10,000 scans: {search_time_s(10_000):.3f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
