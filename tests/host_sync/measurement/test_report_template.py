"""Reports: template, logo, tolerances, signature, and names on the relief that do not overprint."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.report.pictures import LETTER_MM, placed
from tests.apparatus.printing import needs_browser

Write = Callable[..., Path]

RECIPE = """
name = "incoming inspection"
parameters = ["Sa", "Sq"]
[[distance]]
name = "one"
from_um = [100, 200]
to_um = [900, 400]
[[distance]]
name = "two"
from_um = [100, 600]
to_um = [900, 400]
[[circle]]
name = "rim"
centre_um = [500, 400]
radius_um = 200
[[tolerance]]
number = "Sa"
low = {low}
high = 2
[scale]
pixel_pitch_share = 0.001
"""
TEMPLATE = """
organisation = "Müller & Söhne <Prüflabor>"
address = "Werkstraße 1"
logo = "logo.png"
operator = "Ada"
instrument = "RG-7, bench 2"
procedure = "PA-12"
footer = "for internal use"
"""


@pytest.fixture
def files(tmp_path: Path, write_result: Write, wave: np.ndarray) -> list[str]:
    assert cv2.imwrite(str(tmp_path / "logo.png"), np.full((60, 200, 3), (40, 90, 200), np.uint8))
    (tmp_path / "template.toml").write_text(TEMPLATE)
    (tmp_path / "recipe.toml").write_text(RECIPE.format(low=1))
    return [
        "report",
        str(write_result(wave)),
        "--recipe",
        str(tmp_path / "recipe.toml"),
        "--out",
        str(tmp_path / "out"),
    ]


@needs_browser
def test_a_template_has_its_words_logo_and_verdict(files: list[str], tmp_path: Path) -> None:
    assert main([*files, "--template", str(tmp_path / "template.toml")]) == 1  # there is no rim
    page = (tmp_path / "out" / "wave.html").read_text()
    for words in ("Müller &amp; Söhne &lt;Prüflabor&gt;", "Werkstraße 1", "Ada", "RG-7, bench 2", "PA-12"):
        assert words in page
    assert '<p class="verdict pass">Tolerances: pass</p>' in page
    assert '<td class="verdict pass">pass: 1 to 2</td>' in page
    assert "core line (dashed) over Sk" in page
    if shutil.which("pdftotext"):
        words = subprocess.run(
            ["pdftotext", "-layout", str(tmp_path / "out" / "wave.pdf"), "-"],
            check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
        for part in ("Müller & Söhne <Prüflabor>", "Tolerances: pass", "pass: 1 to 2", "for internal use"):
            assert part in words


def signature(page: Path) -> str:
    (found,) = re.findall(r"<code>([0-9a-f]{64})</code>", page.read_text())
    return str(found)


def test_the_signature_changes_with_a_number_and_with_nothing_else(files: list[str], tmp_path: Path) -> None:
    found = []
    for low in (1, 1, 1.9):
        (tmp_path / "recipe.toml").write_text(RECIPE.format(low=low))
        assert main([*files, "--no-pdf", "--overwrite"]) == 1
        found.append(signature(tmp_path / "out" / "wave.html"))
    assert found[0] == found[1] != found[2]
    assert '<p class="verdict fail">' in (tmp_path / "out" / "wave.html").read_text()


def test_the_signature_covers_footer_calibration_and_hashes_that_are_not_printed(
    files: list[str], tmp_path: Path
) -> None:
    folder, found = Path(files[1]), []
    (tmp_path / "short.toml").write_text('footer = "internal"\nparts = ["numbers", "calibration"]\n')
    (tmp_path / "other.toml").write_text('footer = "public"\nparts = ["numbers", "calibration"]\n')

    def signed(template: str) -> None:
        assert main([*files, "--no-pdf", "--overwrite", "--template", str(tmp_path / template)]) == 1
        found.append(signature(tmp_path / "out" / "wave.html"))

    signed("short.toml")
    signed("other.toml")
    record = folder / "result.json"
    record.write_bytes(record.read_bytes().replace(b'"warnings":[]', b'"warnings":[],"calibration_notes":["worn"]'))
    signed("short.toml")
    (folder / "result.json").write_bytes(record.read_bytes() + b"\n")
    signed("short.toml")
    assert len(set(found)) == 4


def test_parts_are_left_out(files: list[str], tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text('parts = ["numbers", "calibration"]\n')
    assert main([*files, "--no-pdf", "--template", str(tmp_path / "short.toml")]) == 1
    page = (tmp_path / "out" / "wave.html").read_text()
    assert "<figure>" not in page
    assert "<h2>Provenance</h2>" not in page
    assert "<h2>Calibration</h2>" in page


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("parts = ['pictures']\n", "a report has numbers"),
        ("parts = ['everything']\n", "accepted keys are"),
        ("colour = 'red'\n", "accepted keys are organisation"),
        ("logo = 'none.png'\n", "name the logo's file"),
        ("logo = 'template.toml'\n", "is no picture"),
        ("organisation = \n", "is not TOML"),
    ],
)
def test_what_is_no_template_is_refused_before_any_work(
    text: str, words: str, files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "template.toml").write_text(text)
    assert main([*files, "--template", str(tmp_path / "template.toml")]) == 2
    assert words in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_names_at_one_place_stand_below_one_another_and_inside() -> None:
    names = [(f"distance {number}", 9.9, 5.0) for number in range(5)]
    shown = list(placed(names, 10.0, 10.0))
    letter, line = (10.0 * share for share in LETTER_MM)
    for (_, _, one), (_, _, other) in itertools.combinations(shown, 2):
        assert abs(one - other) > 0.99 * line
    for words, left, _ in shown:
        assert left + letter * len(words) <= 10.0 + 1e-9
