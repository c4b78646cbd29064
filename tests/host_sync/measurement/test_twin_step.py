"""The twin's step of 100 µm, pressed, pulled and reconstructed: its height does not know how long its line is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.library.library import Library
from host_sync.measurement.measure import measure_result
from host_sync.measurement.recipe import Recipe, StepTable

RISE_UM = 100.0
SHARES = (0.7, 0.85, 1.0, 1.25, 1.5)
BASES_UM = (2000.0, 3000.0, 4000.0)
PLACES_UM = (-1500.0, 0.0, 1500.0)


@pytest.mark.slow
def test_the_height_of_a_step_is_within_one_sigma_over_all_line_lengths(tmp_path: Path) -> None:
    card, library = tmp_path / "card", tmp_path / "library"
    handheld = [sys.executable, "-m", "device", "--board", "twin", "--store", str(card)]
    for command in (["calibrate"], ["scan", "--object", "step", "--part", "step"]):
        subprocess.run([*handheld, *command], check=True, stdout=subprocess.DEVNULL)
    assert main(["pull", str(card), "--library", str(library)]) == 0
    assert main(["reconstruct", "--library", str(library)]) == 0
    shelf = Library(library)
    folder = shelf.newest_result(shelf.named("step"))
    whole = measure_result(folder, Recipe(parameters=("Sa",)), samples=False)
    rows, columns = whole.height.z_um.shape
    right, down = ((size - 1) * whole.height.pitch_um / 2.0 for size in (columns, rows))
    for base_um in BASES_UM:
        for place_um in PLACES_UM:
            steps = tuple(
                StepTable(
                    name=f"{share:g}",
                    from_um=(right - share * base_um / 2.0, down + place_um),
                    to_um=(right + share * base_um / 2.0, down + place_um),
                    width_um=300.0,
                )
                for share in SHARES
            )
            found = measure_result(folder, Recipe(parameters=("Sa",), step=steps))
            heights = [one for one in found.quantities if one.name == "height"]
            print(f"{base_um:g} µm at {place_um:+g}: {[one.number for one in heights]}")  # noqa: T201
            known = [(one.value, one.uncertainty) for one in heights if one.value and one.uncertainty]
            assert all(one.uncertainty or any("lengthen it" in words for words in one.warnings) for one in heights)
            assert all(abs(one - other) < np.hypot(a, b) for one, a in known for other, b in known)
            assert all(abs(value - RISE_UM) < 2.0 * sigma for value, sigma in known)
            if base_um > 2000.0:
                values = [value for value, _ in known]
                assert len(known) == len(SHARES)
                assert max(values) - min(values) < min(sigma for _, sigma in known)
