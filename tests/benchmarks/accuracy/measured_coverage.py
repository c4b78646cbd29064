"""How often stated intervals hold the truth of measured numbers, over presses on the calibrated twin.

usage: python -m tests.benchmarks.accuracy.measured_coverage [--skins SKIN…] [--repeats 3] [--keep DIR] [--like-balls]

Prints, for each number: presses, share of them within one and within two stated standard uncertainties (68 % and 95 %
when they are right), root mean square of error over uncertainty, and root mean square of the error over the truth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Final

import numpy as np

from host_sync.measurement.height_samples import StatedScale
from host_sync.reconstruction.result_writer import write_result
from host_sync.results.reader import read_result
from tests.benchmarks.accuracy.measured_cases import RECIPES, Case, judged, shares
from tests.benchmarks.accuracy.twin_instrument import TwinInstrument, reference_profile
from tests.benchmarks.accuracy.twin_verdict import PLACES

SKINS: Final = ("diffuse", "flake", "sharp-flake")


def main() -> int:
    """Press, measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--skins", nargs="+", choices=SKINS, default=SKINS)
    parser.add_argument("--repeats", type=int, default=3, help="presses of each object")
    parser.add_argument("--keep", type=Path, help="folder where results are kept, and found again")
    parser.add_argument("--like-balls", action="store_true", help="leave out the ± for surfaces unlike the balls")
    arguments = parser.parse_args()
    cases: dict[str, list[Case]] = defaultdict(list)
    scale = StatedScale(unlike_balls_share=0.0) if arguments.like_balls else StatedScale()
    with tempfile.TemporaryDirectory(prefix="measured-") as name:
        folder = arguments.keep or Path(name)
        for skin in arguments.skins:
            press_all(folder / skin, skin, arguments.repeats)
        for truth in sorted(folder.glob("*/*.npz")):
            known = np.load(truth)
            kind = truth.stem.partition("-")[0]
            if truth.parent.name in arguments.skins and kind in (*RECIPES, "ball"):
                for case in judged(kind, read_result(truth.with_suffix("")), known["z"], known["contact"], scale):
                    cases[case.number].append(case)
    for number, count, once, twice, ratio, share in shares(cases):
        sys.stdout.write(f"{number:<42}{count:>4}{once:>8.0%}{twice:>8.0%}{ratio:>8.2f}{share:>8.1%}\n")
    return 0


def press_all(folder: Path, skin: str, repeats: int) -> None:
    """Press every object and five balls on an instrument with that skin, unless results are there already."""
    jobs = [(name, index) for index in range(repeats) for name in RECIPES] + [("ball", i) for i in range(len(PLACES))]
    if all((folder / f"{name}-{index}.npz").is_file() for name, index in jobs):
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="store-") as store:
        instrument = TwinInstrument(reference_profile(skin), Path(store) / "store")
    for name, index in jobs:
        scan = instrument.press_ball(*PLACES[index]) if name == "ball" else instrument.press_object(name)
        target = folder / f"{name}-{index}"
        write_result(target, instrument.reconstruct(scan), instrument.calibration, target.name)
        np.savez(target.with_suffix(".npz"), z=scan.truth.z_um, contact=scan.truth.contact)


if __name__ == "__main__":
    sys.exit(main())
