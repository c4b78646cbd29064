"""Known surfaces with known errors: what the certificate says of them is what was put in."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import msgspec
import numpy as np
import pytest
import tifffile

from device.surface import HeightMap
from host_sync.calibration.calibrate import Calibration
from host_sync.certificate.certificate import (
    Certificate,
    HashedFile,
    check_specimen,
    verdict_of,
    write_certificate,
)
from host_sync.certificate.characteristics import CheckedSpecimen, characteristics
from host_sync.certificate.specimen_measurement import (
    MeasureTable,
    ScanTable,
    SpecimenFile,
    judge,
    measured_quantity,
    read_specimen,
)
from host_sync.errors import MeasurementError
from host_sync.frames.frame_set import FrameSpec
from host_sync.results.doubts import CERTIFICATE_FILE
from host_sync.results.reader import ResultRecord, ResultSurface
from tests.apparatus.printing import needs_browser

SHAPE, PITCH_UM = (120, 400), 10.0
LINE: dict[str, Any] = {"from_um": (500.0, 600.0), "to_um": (3500.0, 600.0), "width_um": 200.0}


def surface_of(z_um: np.ndarray, scale_sigma: float = 0.01) -> ResultSurface:
    """A result whose samples are the height times a scale error."""
    rows, columns = z_um.shape
    record = ResultRecord(
        schema="retrograph.result/1", name="made", rows=rows, columns=columns, pixel_pitch_um=PITCH_UM
    )
    errors = scale_sigma * np.linspace(-1.5, 1.5, 16) / np.linspace(-1.5, 1.5, 16).std()
    samples = np.stack([error * z_um for error in errors]).astype(np.float32)
    return ResultSurface(Path("made"), record, HeightMap(z_um.astype(np.float32), PITCH_UM), samples, None)


def step(height_um: float, flank_um: float = 0.0) -> np.ndarray:
    x = np.arange(SHAPE[1]) * PITCH_UM - 2000.0
    share = np.clip(x / flank_um + 0.5, 0.0, 1.0) if flank_um else (x > 0.0)
    return np.tile(height_um * share, (SHAPE[0], 1))


def specimen(kind: str, certified_um: float, expanded_um: float = 1.0, **more: Any) -> SpecimenFile:
    measure = more.pop("measure", MeasureTable(**LINE))
    scan = (ScanTable(image="a.png"),)
    return SpecimenFile(
        name=f"{kind} {certified_um:g}", kind=kind, certified_um=certified_um,  # type: ignore[arg-type]
        expanded_uncertainty_um=expanded_um, scan=scan, measure=measure, **more,
    )  # fmt: skip


def checked(file: SpecimenFile, *z_um: np.ndarray) -> CheckedSpecimen:
    surfaces = tuple(surface_of(z) for z in z_um)
    return CheckedSpecimen(file, judge(file, [measured_quantity(file, one) for one in surfaces], ()), surfaces)


def symbols(*specimens: CheckedSpecimen) -> dict[str, Any]:
    return {one.symbol: one for one in characteristics(specimens)}


def test_a_step_within_its_uncertainty_agrees_and_one_beyond_does_not() -> None:
    # 1 % of the scale, and 9 % for what is unlike a ball, are in the ± of a measured height.
    good = checked(specimen("step", 100.0), step(101.0)).result
    assert good.mean_um == pytest.approx(101.0, rel=1e-4)
    assert good.expanded_um is not None
    assert good.e_n == pytest.approx(1.0 / np.hypot(good.expanded_um, 1.0), rel=1e-3)
    assert good.agrees
    bad = checked(specimen("step", 100.0), step(200.0)).result
    assert bad.agrees is False
    assert verdict_of([good]) == "agrees"
    assert verdict_of([good, bad]) == "does not agree"


def test_the_certified_uncertainty_is_taken_at_its_own_coverage_factor() -> None:
    file = specimen("step", 100.0, 3.0, coverage_factor=3.0)
    assert checked(file, step(100.0)).result.certified_expanded_um == pytest.approx(2.0)


def test_scatter_of_scans_comes_beside_what_they_share() -> None:
    one = checked(specimen("step", 100.0), step(100.0)).result
    three = checked(specimen("step", 100.0), step(70.0), step(100.0), step(130.0)).result
    assert one.expanded_um is not None
    assert three.expanded_um is not None
    assert three.expanded_um == pytest.approx(np.hypot(one.expanded_um, 2.0 * 30.0 / np.sqrt(3.0)), rel=0.05)


def test_without_samples_nothing_is_judged() -> None:
    file = specimen("step", 100.0)
    surface = surface_of(step(100.0))
    plain = ResultSurface(surface.folder, surface.record, surface.height, None, None)
    result = judge(file, [measured_quantity(file, plain)], ())
    assert (result.e_n, result.agrees) == (None, None)
    assert "no uncertainty" in result.words[0]
    assert verdict_of([result]) == "not judged"


def test_amplification_and_linearity_are_those_that_were_put_in() -> None:
    heights = (50.0, 100.0, 300.0)
    found = symbols(*(checked(specimen("step", h), step(1.02 * h + (3.0 if h == 100.0 else 0.0))) for h in heights))
    true, seen = np.array(heights), 1.02 * np.array(heights) + np.array([0.0, 3.0, 0.0])
    alpha = (true * seen).sum() / (true**2).sum()
    assert found["α_z"].value == pytest.approx(alpha, rel=1e-4)
    assert found["l_z"].value == pytest.approx(np.abs(seen - alpha * true).max(), abs=0.02)
    assert found["α_x"].value is None
    assert "period" in found["α_x"].basis


def test_one_height_shows_no_linearity() -> None:
    found = symbols(checked(specimen("step", 100.0), step(100.0)))
    assert found["l_z"].value is None
    assert "two heights" in found["l_z"].basis


def test_noise_and_flatness_come_from_repeated_scans_of_a_flat() -> None:
    random = np.random.default_rng(4)
    bow = 2.0 * np.linspace(-1.0, 1.0, SHAPE[1])[None, :] ** 2 * np.ones((SHAPE[0], 1))
    scans = [bow + 0.3 * cv2.GaussianBlur(random.standard_normal(SHAPE), (0, 0), 1e-6) for _ in range(6)]
    file = specimen("flat", 0.0, 0.1, measure=MeasureTable())
    found = symbols(checked(file, *scans))
    assert found["N_M"].value == pytest.approx(0.3, rel=0.03)
    quiet = symbols(checked(file, bow, bow))
    assert quiet["N_M"].value == pytest.approx(0.0, abs=1e-4)
    assert quiet["z_FLT"].value == pytest.approx(2.0, rel=0.02)


def test_a_copied_scan_is_named_and_shows_no_noise(tmp_path: Path) -> None:
    flat = np.random.default_rng(3).normal(0.0, 1.0, SHAPE).astype(np.float32)
    record = {
        "schema": "retrograph.result/1", "name": "made", "rows": SHAPE[0], "columns": SHAPE[1],
        "pixel_pitch_um": PITCH_UM, "calibration_id": "abc",
    }  # fmt: skip
    for name in "ab":
        (tmp_path / name).mkdir()
        tifffile.imwrite(tmp_path / name / "height_um.tif", flat)
        (tmp_path / name / "result.json").write_bytes(msgspec.json.encode(record))
    file = specimen("flat", 1.0, measure=MeasureTable(region_um=(0.0, 0.0, 3000.0, 1000.0)))
    file = msgspec.structs.replace(file, scan=tuple(ScanTable(result=name) for name in "ab"))
    calibration = cast(Calibration, SimpleNamespace(calibration_id="abc"))
    judged = check_specimen(
        tmp_path / "f.toml", file, calibration, FrameSpec((), "linear"), tmp_path / "out", lambda _: None
    )
    assert len(judged.result.values_um) == 1
    assert "scan 2 is a copy of an earlier one: it is not used" in judged.result.words
    assert symbols(judged)["N_M"].value is None


def test_a_flat_is_never_judged_by_its_noise() -> None:
    result = checked(specimen("flat", 0.0, 0.1, measure=MeasureTable()), step(1.0)).result
    assert result.agrees is None
    good = checked(specimen("step", 100.0), step(101.0)).result
    assert verdict_of([good, result]) == "agrees"


def test_the_width_of_an_edge_is_its_flanks() -> None:
    found = symbols(checked(specimen("step", 100.0), step(100.0, flank_um=400.0)))
    assert found["W_R"].value == pytest.approx(0.8 * 400.0, rel=0.1)


def test_a_period_shows_the_lateral_scale() -> None:
    x = np.arange(SHAPE[1]) * PITCH_UM
    wave = np.tile(5.0 * np.sin(2.0 * np.pi * x / 303.0), (SHAPE[0], 1))
    file = specimen("period", 300.0, 0.5, axis="x", measure=MeasureTable(**LINE, pixel_pitch_share=0.01))
    one = checked(file, wave, wave)
    found = symbols(one)
    assert one.result.agrees  # 1 % off, with 1 % of the pitch unknown
    assert found["α_x"].value == pytest.approx(1.01, abs=1e-4)
    assert found["α_y"].value is None


def test_a_line_without_the_period_is_refused() -> None:
    file = specimen("period", 300.0, 0.5, axis="x")
    noise = np.random.default_rng(0).standard_normal(SHAPE)
    with pytest.raises(MeasurementError, match="shows no period near 300"):
        measured_quantity(file, surface_of(noise))


FILE = """
name = "step"
kind = "step"
certified_um = 100.0
expanded_uncertainty_um = 0.5
[[scan]]
image = "step.png"
[measure]
from_um = [0, 0]
to_um = [100, 0]
"""


def test_a_specimens_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "STEP.toml"
    path.write_text(FILE)
    file = read_specimen(path)
    assert file.standard_uncertainty_um == 0.25
    assert file.measure.to_um == (100.0, 0.0)


def test_the_example_in_the_documents_is_one() -> None:
    assert read_specimen(Path(__file__).parents[3] / "docs" / "certificate" / "STEP.toml").kind == "step"


@pytest.mark.parametrize(
    ("now", "then", "words"),
    [
        ("to_um = [100, 0]", "", "measure.to_um"),
        ('kind = "step"', 'kind = "stair"', "kind"),
        ("certified_um = 100.0", "certified_um = 0.0", "certifies nothing"),
        ("expanded_uncertainty_um = 0.5", "expanded_uncertainty_um = 0.0", "expanded_uncertainty_um"),
        ('image = "step.png"', 'image = "step.png"\nresult = "out"', "scan[0]"),
        ('image = "step.png"', "", "scan[0]"),
        ('kind = "step"', 'kind = "step"\naxis = "x"', "axis"),
        ('kind = "step"', 'kind = "step"\nheight = 3', "height"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(tmp_path: Path, now: str, then: str, words: str) -> None:
    path = tmp_path / "STEP.toml"
    assert now in FILE
    path.write_text(FILE.replace(now, then))
    with pytest.raises(MeasurementError) as raised:
        read_specimen(path)
    assert words in str(raised.value)
    assert str(path) in str(raised.value)


@needs_browser
def test_the_certificate_is_written_as_json_and_pages(tmp_path: Path) -> None:
    good = checked(specimen("step", 100.0), step(101.0), step(102.0, flank_um=200.0))
    certificate = Certificate(
        program="retrograph 0", written_utc="2026-01-01T00:00:00Z", instrument="made", calibration_id="c0ffee",
        calibration_passed=True, calibration_notes=("a note",), pixel_pitch_um=PITCH_UM, rows=SHAPE[0],
        columns=SHAPE[1], balls=12, held_out_error_deg=1.0, verdict=verdict_of([good.result]),
        specimens=(good.result,), characteristics=characteristics([good]), files=(HashedFile("a.png", 1, "ab" * 32),),
    )  # fmt: skip
    pages, *sheets = write_certificate(certificate, tmp_path)
    assert pages == tmp_path / "certificate.html"
    assert "<h1>Calibration certificate: made</h1>" in pages.read_text(encoding="utf-8")
    assert "<code></code>" not in pages.read_text(encoding="utf-8")
    read = msgspec.json.decode((tmp_path / CERTIFICATE_FILE).read_bytes(), type=Certificate)
    assert read == certificate
    assert sheets == [tmp_path / "certificate.pdf"]
    before = sheets[0].read_bytes()
    assert before.startswith(b"%PDF")
    write_certificate(certificate, tmp_path)
    assert sheets[0].read_bytes() == before
