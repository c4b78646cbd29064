"""The report of a population: what it says is what its results are, and its outliers are shown."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.report.population import without_common_start
from tests.apparatus.printing import needs_browser

Write = Callable[..., Path]


ORDINARY = [1.00, 1.02, 0.99, 1.01, 0.98, 1.00, 1.01, 0.99, 1.02, 1.00, 0.99, 1.01, 1.00, 0.98]
RECIPE = """
parameters = ["Sa", "Sq"]
[scale]
pixel_pitch_share = 0.001
[[tolerance]]
of = "surface"
number = "Sa"
low = 1.0
high = 1.5
"""


@pytest.fixture
def places(write_result: Write, wave: np.ndarray) -> list[str]:
    """Fourteen alike results, no two of them equal, and, in ninth place, one of twice the height."""
    alike = [size + 1e-5 * at for at, size in enumerate(ORDINARY)]
    sizes = [*alike[:8], 2.0, *alike[8:]]
    return [str(write_result(size * wave, f"part {at:02}", seed=at)) for at, size in enumerate(sizes)]


@pytest.fixture
def chosen(tmp_path: Path) -> str:
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return str(path)


@needs_browser
def test_a_population_has_charts_capability_and_its_outlier_as_a_thumbnail(
    places: list[str], chosen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["report", *places, "--recipe", chosen, "--population", "--out", str(out)]) == 1  # one fails
    assert capsys.readouterr().out.split() == [str(out / "population.html"), str(out / "population.pdf")]
    assert sorted(path.name for path in out.iterdir()) == ["numbers.csv", "population.html", "population.pdf"]
    with (out / "numbers.csv").open(encoding="utf-8") as stream:
        sa = [float(row["value"]) for row in csv.DictReader(stream) if row["name"] == "Sa"]
    assert len(sa) == 15
    page = (out / "population.html").read_text(encoding="utf-8")
    assert "<h1>15 results</h1>" in page
    step = float(np.mean(np.abs(np.diff(sa))))
    mean = float(np.mean(sa))
    cpk = min(mean - 1.0, 1.5 - mean) / (3.0 * step / 1.128)
    assert f"{(1.5 - 1.0) / (6.0 * step / 1.128):.2f}, {cpk:.2f} ± " in page
    assert "1 of 15" in page
    assert "part 08" in page.partition("Outliers, the farthest first")[2].partition("</table>")[0]
    assert "beyond the control limits" in page
    assert "1.879; fail: 1 to 1.5" in page
    assert "Tolerances: fail" in page
    assert page.count("data:image/png;base64,") == 2  # Sa, which has a tolerance, and the outlier
    assert page.count("result.json</td>") == 15
    assert (out / "population.pdf").read_bytes().startswith(b"%PDF")


def test_a_population_needs_two_results_and_replaces_none_unasked(
    places: list[str], chosen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--recipe", chosen, "--population", "--no-pdf", "--out", str(tmp_path / "out")]
    assert main(["report", places[0], *arguments]) == 2
    assert "a population is two results or more" in capsys.readouterr().err
    assert main(["report", *places[:2], *arguments]) == 0
    before = (tmp_path / "out" / "population.html").read_bytes()
    assert main(["report", *places[2:4], *arguments]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "out" / "population.html").read_bytes() == before
    assert main(["report", *places[2:4], *arguments, "--overwrite"]) == 0
    assert (tmp_path / "out" / "population.html").read_bytes() != before


def test_an_outlier_that_cannot_be_read_again_is_named(
    places: list[str], chosen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from host_sync.measurement.measure import measure_result
    from host_sync.measurement.recipe import read_recipe
    from host_sync.report.population import compose_population

    recipe = read_recipe(Path(chosen))
    measured = [measure_result(Path(place), recipe).numbers_only() for place in places]
    (Path(places[8]) / "height_um.tif").write_bytes(b"II*")
    report = compose_population(measured)
    assert [note for note in report.notes if note.startswith("part 08: no thumbnail: ")]
    assert len(report.pictures) == 1


def test_two_kinds_of_parts_are_doubted(write_result: Write, wave: np.ndarray, tmp_path: Path) -> None:
    sizes = [1.0, 1.01, 0.99, 1.001, 3.0, 3.01, 2.99, 3.001]
    places = [str(write_result(size * wave, f"part {at:02}", seed=at)) for at, size in enumerate(sizes)]
    for given, doubted in ((places, True), (places[:4], False)):
        out = tmp_path / f"report-{len(given)}"
        assert main(["report", *given, "--out", str(out), "--population", "--no-pdf"]) == 0
        assert ("not one population: 8 of 8 results" in (out / "population.html").read_text()) == doubted


@pytest.mark.parametrize(
    ("names", "start", "ends"),
    [
        (["rg1d9e93-b0075e1f-000001", "rg1d9e93-b0075e1f-000012"], "rg1d9e93-b0075e1f-", ["000001", "000012"]),
        (["part 01", "part 02"], "", ["part 01", "part 02"]),
        (["workpiece-", "workpiece-2"], "", ["workpiece-", "workpiece-2"]),
        (["housing"] * 2, "", ["housing"] * 2),
    ],
)
def test_a_chart_leaves_out_what_all_ids_begin_with(names: list[str], start: str, ends: list[str]) -> None:
    assert without_common_start(names) == (start, ends)
