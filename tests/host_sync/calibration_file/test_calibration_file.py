"""A calibration as a file: the same bits again, found by what it was made from, refused when it is not sound."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from pressed_frames import write_frame_set

from device.balls.sphere import Viewpoint
from device.bundles.calibration import CalibrationBundle
from device.errors import CalibrationError
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import CalibrationCache, frames_of_set, key_of_set
from host_sync.calibration_file.kept_calibration import (
    FACTS_FILE,
    REPORT_NAMES,
    KeptCalibration,
    facts_of,
    make_calibration,
    read_archive,
    read_calibration_file,
    write_archive,
)
from host_sync.calibration_file.soundness import check_sound
from host_sync.cli.main import main
from host_sync.denoising.frame_noise import NullColour
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set import load_frame_set
from host_sync.kernels.cache import USER_CACHE
from host_sync.light.model import LightModel
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.slope_reading import read_slopes
from host_sync.results.record import SlopeNoise
from host_sync.results.typed_members import READ_ERRORS, as_members, from_members

MUTATIONS = 60
FIELDS = (
    "height_um.tif",
    "slope_p.tif",
    "slope_q.tif",
    "height_sigma_um.tif",
    "slope_sigma.tif",
    "height_draws_um.tif",
)


@pytest.fixture(scope="module")
def frame_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_frame_set(tmp_path_factory.mktemp("frames") / "set")


@pytest.fixture(scope="module")
def kept(frame_set: Path) -> KeptCalibration:
    described = load_frame_set(frame_set)
    key = key_of_set(described)
    frames = replace(frames_of_set(described), paper=True)
    return make_calibration(frames, lambda found: facts_of(found, "gel-3", key, encoding="linear"))


@pytest.fixture(scope="module")
def file(kept: KeptCalibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kept") / "gel.calibration"
    kept.write(path)
    return path


@pytest.fixture
def cache(kept: KeptCalibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CalibrationCache:
    """A cache that holds the calibration, and is the user's."""
    monkeypatch.setenv(USER_CACHE, str(tmp_path / "cache"))
    found = CalibrationCache.of_user()
    assert found.keep(kept)
    return found


def test_what_was_read_is_the_same_to_the_last_bit(kept: KeptCalibration, file: Path) -> None:
    read = read_calibration_file(file)
    assert read.as_file() == file.read_bytes()
    assert read.facts.calibration_id == kept.calibration.calibration_id
    assert set(np.load(file, allow_pickle=False)) > {"arrays/0000"}


def test_commands_take_the_file_and_give_the_same_bits(
    file: Path, frame_set: Path, cache: CalibrationCache, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    named, found = tmp_path / "named", tmp_path / "found"
    assert main(["reconstruct", str(frame_set), "--calibration", str(file), "--out", str(named)]) == 0
    calibration_id = read_calibration_file(file).facts.calibration_id
    assert f"calibration {calibration_id} of gel-3, from {file}, made 20" in capsys.readouterr().out
    assert main(["reconstruct", str(frame_set), "--out", str(found)]) == 0
    assert f"calibration {calibration_id} of gel-3, made 20" in capsys.readouterr().out
    for name in FIELDS:
        assert (named / "ball" / name).read_bytes() == (found / "ball" / name).read_bytes()
    assert (found / "calibration" / "report.json").read_bytes() == read_calibration_file(file).report["report.json"]


def test_a_place_that_cannot_be_written_is_named_before_the_work(
    frame_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(frame_set), "--out", str(tmp_path / "missing" / "gel.calibration")]) == 2
    said = capsys.readouterr()
    assert said.err.endswith(f"there is no folder {tmp_path / 'missing'}; make it, or choose another\n")
    assert said.err.count("\n") == 1, "nothing was calibrated"
    assert said.out == ""


def test_the_second_reconstruction_is_the_first_to_the_last_bit(
    frame_set: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(USER_CACHE, str(tmp_path / "cache"))
    said = []
    for run in ("first", "second"):
        assert main(["reconstruct", str(frame_set), "--out", str(tmp_path / run)]) == 0
        said.append("made now" in capsys.readouterr().out)
    assert said == [True, False]
    for name in FIELDS:
        assert (tmp_path / "first" / "ball" / name).read_bytes() == (tmp_path / "second" / "ball" / name).read_bytes()


@pytest.mark.slow
def test_the_papers_model_is_fitted_when_it_is_asked_for(
    frame_set: Path, kept: KeptCalibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(USER_CACHE, str(tmp_path / "cache"))
    cache, described = CalibrationCache.of_user(), load_frame_set(frame_set)
    plain = Calibrator(cache).of_frame_set(described)
    assert plain.calibration.paper is None
    assert plain.calibration.calibration_id != kept.calibration.calibration_id
    assert set(plain.report) == {"report.json", "balls.png", "residuals.png"}
    assert read_calibration_file(plain.as_file()).as_file() == plain.as_file()
    asked = Calibrator(cache, paper=True).of_frame_set(described)
    assert asked.calibration.paper_model.table.filled_bins > 1
    assert asked.calibration.preferred == plain.calibration.preferred == "direct"
    assert set(asked.report) > set(plain.report)
    found = cache.find(plain.facts.key)
    assert found is not None
    assert found.calibration.paper is not None


def test_the_papers_method_wants_a_calibration_that_holds_its_model(
    frame_set: Path, kept: KeptCalibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = replace(kept.calibration, paper=None, held_out_deg={"direct": 0.5})
    report = {name: data for name, data in kept.report.items() if name in REPORT_NAMES}
    path = tmp_path / "plain.calibration"
    KeptCalibration(calibration, report, kept.facts).write(path)
    asked = ["reconstruct", str(frame_set), "--calibration", str(path), "--out", str(tmp_path / "out")]
    assert main([*asked, "--method", "paper"]) == 2
    assert "`retrosync calibrate --paper`" in capsys.readouterr().err
    with pytest.raises(CalibrationError, match="paper=True"):
        reconstruct(frames_of_set(load_frame_set(frame_set)).presses[0].frame, calibration, "ball", "paper")
    assert main(asked) == 0


def test_a_reference_that_is_not_the_calibrations_is_not_used_in_silence(
    file: Path, frame_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(frame_set.parent, tmp_path / "set")
    command = ["reconstruct", str(folder / "frameset.toml"), "--calibration", str(file), "--out", str(tmp_path / "out")]
    assert main(command) == 0
    assert "[reference]" not in capsys.readouterr().err
    flat = cv2.imread(str(folder / "flat.png"), cv2.IMREAD_UNCHANGED)
    assert cv2.imwrite(str(folder / "flat.png"), (0.97 * flat).astype(flat.dtype))
    assert main(command) == 0
    assert "[reference] differs from the calibration's, which is used instead" in capsys.readouterr().err
    data = (folder / "flat.png").read_bytes()
    (folder / "flat.png").write_bytes(data[: len(data) // 2])
    shutil.rmtree(tmp_path / "out")
    assert main(command) == 2
    assert "flat.png" in capsys.readouterr().err
    assert not (tmp_path / "out").exists(), "it is refused before any work"


def test_json_says_which_calibration_was_used_and_what_became_of_each_scan(
    file: Path, frame_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(frame_set.parent, tmp_path / "set")
    black = cv2.imread(str(folder / "flat.png"), cv2.IMREAD_UNCHANGED) * 0
    assert cv2.imwrite(str(folder / "black.png"), black)
    with (folder / "frameset.toml").open("a") as stream:
        stream.write('[[scan]]\nname = "black"\nimage = "black.png"\n')
    out = tmp_path / "out"
    command = ["reconstruct", str(folder / "frameset.toml"), "--calibration", str(file), "--out", str(out), "--json"]
    assert main(command) == 1
    said = capsys.readouterr()
    facts = json.loads(said.out)
    (used,) = facts["calibrations"]
    assert used["calibration_id"] == read_calibration_file(file).facts.calibration_id
    assert used["source"].startswith(f"from {file}")
    good, bad = facts["scans"]
    assert good == {"scan": "ball", "folder": str(out / "ball")}
    assert (bad["scan"], "is black" in bad["reason"]) == ("black", True)
    assert said.err.startswith("retrosync: black: ")


def test_a_black_press_is_left_out_by_name(frame_set: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(frame_set.parent, tmp_path / "set")
    path = folder / "frameset.toml"
    described = load_frame_set(path)
    assert frames_of_set(described).left_out == ()
    black = np.zeros_like(cv2.imread(str(described.presses[1].frame.images[0]), cv2.IMREAD_UNCHANGED))
    for number, press in enumerate(described.presses):
        if number in (1, 2):
            assert cv2.imwrite(str(press.frame.images[0]), black)
    frames = frames_of_set(load_frame_set(path))
    kept = [press.name for number, press in enumerate(described.presses) if number not in (1, 2)]
    assert [press.name for press in frames.presses] == kept
    assert [sentence.split(" (")[0] for sentence in frames.left_out] == ["press-01", "press-02"]
    assert all("is black" in sentence and sentence.endswith("it is not used") for sentence in frames.left_out)
    for press in described.presses:
        assert cv2.imwrite(str(press.frame.images[0]), black)
    frames = frames_of_set(load_frame_set(path))
    assert (len(frames.presses), frames.left_out) == (len(described.presses), ())


def test_a_scan_without_presses_is_reconstructed_with_a_file(file: Path, frame_set: Path, tmp_path: Path) -> None:
    shutil.copy(frame_set.parent / "ball-6.png", tmp_path / "own.png")
    own = tmp_path / "own.toml"
    own.write_text(
        'name = "own"\npixel_pitch_um = 20\nencoding = "linear"\n[[scan]]\nname = "own"\nimage = "own.png"\n'
    )
    assert main(["reconstruct", str(own), "--calibration", str(file), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "own" / "height_um.tif").is_file()
    own.write_text(own.read_text().replace("= 20", "= 30"))
    assert main(["reconstruct", str(own), "--calibration", str(file), "--out", str(tmp_path / "out")]) == 2


def test_calibrate_writes_the_file(frame_set: Path, cache: CalibrationCache, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.calibration"
    assert main(["calibrate", str(frame_set), "--out", str(out)]) == 0
    kept = read_calibration_file(out)
    picture = kept.report["overview.png"]
    assert out.with_name(f"{out.name}.png").read_bytes() == picture
    shown = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    assert shown.std() > 10.0
    others = {name: data for name, data in kept.report.items() if name != "overview.png"}
    replace(kept, report=others).write(out)
    assert out.read_bytes() == file.read_bytes()


def test_the_key_changes_with_everything_that_the_calibration_is_made_from(frame_set: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(frame_set.parent, tmp_path / "set") / "frameset.toml"
    key, text = key_of_set(load_frame_set(copy)), copy.read_text()
    assert key == key_of_set(load_frame_set(frame_set))
    camera = ('"linear"', '"linear"\npupil_height_mm = 160.0')
    for old, new in (
        camera,
        ("= 20.0", "= 20.1"),
        ("ball_radius_mm = 0.96", "ball_radius_mm = 0.95"),
        ('"linear"', '"srgb"'),
    ):
        assert old in text
        copy.write_text(text.replace(old, new))
        assert key_of_set(load_frame_set(copy)) != key
    copy.write_text(text + '[[scan]]\nname = "more"\nimage = "ball-6.png"\n')
    assert key_of_set(load_frame_set(copy)) == key
    picture = copy.parent / "ball-3.png"
    picture.write_bytes(picture.read_bytes() + b"\0")
    assert key_of_set(load_frame_set(copy)) != key


def test_a_calibration_is_made_once_and_a_damaged_one_again(
    frame_set: Path, kept: KeptCalibration, cache: CalibrationCache, tmp_path: Path
) -> None:
    sources: list[str] = []
    calibrator = Calibrator(cache, obtained=lambda _, source: sources.append(source))
    first = calibrator.of_frame_set(load_frame_set(frame_set))
    assert calibrator.of_frame_set(load_frame_set(frame_set)) is first
    assert sources == [f"made {kept.facts.made_utc} and kept since"]
    (path,) = (tmp_path / "cache").rglob("*.calibration")
    path.write_bytes(path.read_bytes()[:-100])
    assert cache.find(kept.facts.key) is None
    assert not path.exists()
    assert not CalibrationCache(None).keep(kept)
    assert not CalibrationCache(Path("/dev/null/nowhere")).keep(kept)


@pytest.mark.slow
def test_the_calibration_that_tests_share_is_the_one_made_again(
    calibrator: Calibrator, twin_bundle: CalibrationBundle
) -> None:
    again = Calibrator(CalibrationCache(None)).of_bundle(twin_bundle).calibration
    # An id is the digest of every array and number.
    assert again.calibration_id == calibrator.of_bundle(twin_bundle).calibration.calibration_id


def test_what_is_no_calibration_is_refused_in_a_sentence(
    frame_set: Path, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.zip"
    with zipfile.ZipFile(other, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FACTS_FILE, "{}")
        archive.writestr("arrays/0000.npy", bytes(10_000_000))
    text, short = tmp_path / "text", tmp_path / "short"
    text.write_text("not a calibration")
    short.write_bytes(file.read_bytes()[:4000])
    for path in (other, text, short, tmp_path / "missing", tmp_path):
        command = ["reconstruct", str(frame_set), "--calibration", str(path), "--out", str(tmp_path / "out")]
        assert main(command) == 2
        said = capsys.readouterr()
        assert said.err.startswith(f"retrosync: {path}")
        assert said.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_file_of_random_damage_is_read_or_refused(file: Path, tmp_path: Path) -> None:
    data, rng, path = file.read_bytes(), np.random.default_rng(0), tmp_path / "damaged"
    refused = 0
    for _ in range(MUTATIONS):
        changed = bytearray(data)
        for place in rng.integers(0, len(data), 4):
            reach = len(data) if rng.random() < 0.5 else 3000
            at = int(place) % reach
            changed[at : at + 3] = rng.bytes(3)
        path.write_bytes(changed)
        try:
            read_calibration_file(path)
        except CalibrationFileError as error:
            refused += 1
            assert str(error).startswith(str(path))  # noqa: PT017
    assert refused > 0.8 * MUTATIONS


def test_a_forged_file_with_the_right_digest_is_read_or_refused(file: Path) -> None:
    """Whoever forges a file can write its digest too: what it holds is looked at all the same."""
    facts, members = read_archive(file, "file")
    rng, refused = np.random.default_rng(1), 0
    names = sorted(name for name in members if not name.startswith("report/"))
    for number in range(MUTATIONS):
        name = "records.msgpack" if number % 2 else names[int(rng.integers(len(names)))]
        changed = bytearray(members[name])
        reach = len(changed) if name == "records.msgpack" else min(200, len(changed))
        changed[int(rng.integers(reach))] ^= 1 << int(rng.integers(8))
        path = file.with_name("forged")
        with path.open("wb") as stream:
            write_archive(stream, facts, members | {name: bytes(changed)})
        try:
            read_calibration_file(path)
        except CalibrationFileError:
            refused += 1
    assert refused > 0.2 * MUTATIONS


def with_table(calibration: Calibration, **changed: Any) -> Calibration:
    return replace(calibration, paper=replace(calibration.paper, table=calibration.paper.table._replace(**changed)))


def with_map(calibration: Calibration, **changed: Any) -> Calibration:
    return replace(calibration, inverse=replace(calibration.inverse, map=replace(calibration.inverse.map, **changed)))


def with_gains(calibration: Calibration, gains: tuple[tuple[float, ...], ...]) -> Calibration:
    return replace(calibration, slope_error=msgspec.structs.replace(calibration.slope_error, ball_gains=gains))


def with_ball_places(calibration: Calibration, *places: tuple[float, float]) -> Calibration:
    return replace(calibration, slope_error=msgspec.structs.replace(calibration.slope_error, ball_places=places))


def with_light(calibration: Calibration, folds: int = 2, **changed: Any) -> Calibration:
    """With a light model of so many folds, the last of them changed."""
    light = calibration.light
    all_folds = (light.model, replace(light.model, **changed))
    return replace(calibration, light=replace(light, folds=all_folds[2 - folds :]))


def with_sources(calibration: Calibration, *place_and_extent: float) -> Calibration:
    """With every source at one place."""
    sources = calibration.light.model.sources
    return with_light(calibration, sources=np.broadcast_to(place_and_extent, sources.shape).copy())


def with_denoising(calibration: Calibration, **changed: Any) -> Calibration:
    """With other parts of the removal of noise."""
    assert calibration.denoising is not None
    return replace(calibration, denoising=replace(calibration.denoising, **changed))


def with_null_colour(calibration: Calibration, **changed: Any) -> Calibration:
    """With a null colour that changes nothing, but for what is changed."""
    null_colour = NullColour(np.zeros((3, 3, 3), np.float32), np.zeros((3, 3, 2), np.float32), 1.0)
    return with_denoising(calibration, null_colour=replace(null_colour, **changed))


HARMS: dict[str, Callable[[Calibration], Calibration]] = {
    "a table that points beyond its end": lambda one: with_table(one, bin_of=one.paper.table.bin_of + np.int32(10**6)),
    "candidates that end early": lambda one: with_table(one, candidates=one.paper.table.candidates[:-1]),
    "a negative bin": lambda one: with_table(one, bin_of=-one.paper.table.bin_of - np.int32(1)),
    "a flat field of another size": lambda one: replace(one, flat_field=one.flat_field[:-2]),
    "a flat field of zero": lambda one: replace(one, flat_field=0.0 * one.flat_field),
    "a map of another field": lambda one: with_map(one, shape=(10, 10)),
    "a map that is not finite": lambda one: with_map(one, max_trained_slope=float("nan")),
    "a domain without width": lambda one: with_map(one, domain=replace(one.inverse.map.domain, cell=0.0)),
    "no pitch": lambda one: replace(one, pitch_um=float("nan")),
    "one method beside both models": lambda one: replace(one, held_out_deg={"direct": 1.0}),
    "a model that is missing": lambda one: replace(one, paper=None),
    "fewer errors than tilts": lambda one: replace(
        one, slope_error=msgspec.structs.replace(one.slope_error, pixel_deg=())
    ),
    "fewer gains than tilts": lambda one: with_gains(one, ((0.0,),)),
    "a gain that is not finite": lambda one: with_gains(one, ((float("nan"),) * len(one.slope_error.tilt_deg),)),
    "sources over another field": lambda one: with_light(one, shape=(10, 10)),
    "sources under the skin": lambda one: with_sources(one, 0.7, 0.0, -0.4, 0.0, 0.0),
    "sources at no place": lambda one: with_sources(one, float("nan"), 0.0, 0.4, 0.0, 0.0),
    "strengths of two channels": lambda one: with_light(one, strengths=one.light.model.strengths[:2]),
    "strengths of more sources than there are": lambda one: with_light(
        one, strengths=np.hstack([one.light.model.strengths, np.ones((3, 1))])
    ),
    "a channel without light": lambda one: with_light(one, strengths=0.0 * one.light.model.strengths),
    "light below none": lambda one: with_light(one, strengths=-one.light.model.strengths),
    "a lobe without width": lambda one: with_light(one, gloss_width=0.0),
    "a lobe without a tail": lambda one: with_light(one, tail=0.0),
    "beams that point nowhere": lambda one: with_light(one, beam=float("nan")),
    "a residual field of fewer terms": lambda one: with_light(one, residual=one.light.model.residual[:, 1:]),
    "a residual field that is not finite": lambda one: with_light(one, residual=np.nan * one.light.model.residual),
    "a residual field beyond measure": lambda one: with_light(one, residual=one.light.model.residual + 1e300),
    "intensity without an error": lambda one: with_light(one, sigma=np.zeros(3)),
    "sources without an error": lambda one: with_light(one, source_sigma=np.zeros(3)),
    "a light model without folds": lambda one: with_light(one, folds=0),
    "a light model of one fold": lambda one: with_light(one, folds=1),
    "a camera on the skin": lambda one: replace(one, viewpoint=Viewpoint(100.0, 80.0, 0.0)),
    "a camera at no height": lambda one: replace(one, viewpoint=Viewpoint(100.0, 80.0, float("nan"))),
    "a blur without measure": lambda one: with_denoising(
        one, slope_noise=SlopeNoise((0.0,), (0.1,), (0.1,), 0.6, 0.6, 1.5, 1.5, raw_blur_px=float("nan"))
    ),
    "a null colour for no slope": lambda one: with_null_colour(one, limit=0.0),
    "a null colour for slopes that are no number": lambda one: with_null_colour(one, limit=float("nan")),
    "a null colour of two channels": lambda one: with_null_colour(one, channels=np.zeros((3, 3, 2), np.float32)),
    "a null colour that is not finite": lambda one: with_null_colour(
        one, slopes=np.full((3, 3, 2), np.nan, np.float32)
    ),
    "light that falls off without measure": lambda one: with_light(one, fall_off=float("nan")),
    "fewer places than balls with a gain": lambda one: with_ball_places(one, (0.5, 0.5)),
    "a ball at no place": lambda one: with_ball_places(one, *((float("nan"), 0.5),) * len(one.slope_error.ball_gains)),
    "a gain beyond measure": lambda one: with_gains(one, ((1e300,) * len(one.slope_error.tilt_deg),)),
}


def test_a_camera_nearby_and_blurs_are_read_as_they_were_written(kept: KeptCalibration) -> None:
    noise = SlopeNoise((0.0,), (0.1,), (0.1,), 0.6, 0.6, 1.5, 1.5, 0.5, 0.6)
    known = with_denoising(replace(kept.calibration, viewpoint=Viewpoint(100.0, 80.0, 9000.0)), slope_noise=noise)
    found = from_members(as_members(known), Calibration)
    assert (found.viewpoint, found.slope_noise) == (known.viewpoint, noise)
    check_sound(found, "file")


def test_the_light_model_is_read_as_it_was_written(kept: KeptCalibration) -> None:
    read = from_members(as_members(kept.calibration), Calibration).light
    written = kept.calibration.light
    assert len(read.folds) == len(written.folds)
    np.testing.assert_array_equal(read.shift_px, written.shift_px)
    for own, other in zip((read.model, *read.folds), (written.model, *written.folds), strict=True):
        for field in fields(other):
            np.testing.assert_array_equal(getattr(own, field.name), getattr(other, field.name), err_msg=field.name)


def test_a_light_model_without_sources_is_read_as_it_was_written(kept: KeptCalibration) -> None:
    light = kept.calibration.light

    def sourceless(model: LightModel) -> LightModel:
        return replace(
            model, sources=np.zeros((0, 5)), strengths=np.zeros((3, 0)), haze=np.ones(3), albedo=0.0
        )  # fmt: skip

    folds = tuple(sourceless(fold) for fold in light.folds)
    written = replace(kept.calibration, light=replace(light, model=sourceless(light.model), folds=folds))
    found = from_members(as_members(written), Calibration)
    check_sound(found, "file")
    assert not found.light.has_sources
    np.testing.assert_array_equal(found.light.model.residual, light.model.residual)


def drawn_null_colour() -> NullColour:
    """A null colour that changes every slope."""
    rng = np.random.default_rng(2)
    channels, slopes = (0.1 * rng.standard_normal(shape).astype(np.float32) for shape in ((3, 3, 3), (3, 3, 2)))
    return NullColour(channels, slopes, 0.4)


def raw_slopes(calibration: Calibration, frame_set: Path) -> np.ndarray:
    """Raw slopes of a press, shape (2, H, W)."""
    frame = frames_of_set(load_frame_set(frame_set)).presses[0].frame
    found = read_slopes(frame, calibration, "press", "direct", force=False).raw_gradients()
    return np.stack([found.p, found.q])


def test_a_null_colour_is_read_as_it_was_written(kept: KeptCalibration, frame_set: Path) -> None:
    null_colour = drawn_null_colour()
    known = KeptCalibration(with_denoising(kept.calibration, null_colour=null_colour), kept.report, kept.facts)
    read = read_calibration_file(known.as_file(), "file")
    found = read.calibration.null_colour
    assert found is not None
    np.testing.assert_array_equal(found.channels, null_colour.channels)
    np.testing.assert_array_equal(found.slopes, null_colour.slopes)
    assert found.limit == null_colour.limit
    assert read.as_file() == known.as_file()
    np.testing.assert_array_equal(raw_slopes(read.calibration, frame_set), raw_slopes(known.calibration, frame_set))


def test_a_null_colour_that_holds_for_no_slope_is_refused_in_a_sentence(kept: KeptCalibration) -> None:
    damaged = KeptCalibration(with_null_colour(kept.calibration, limit=0.0), kept.report, kept.facts)
    with pytest.raises(
        CalibrationFileError, match=r"^gel: .*its null colour holds for slopes up to 0.*: calibrate again"
    ):
        read_calibration_file(damaged.as_file(), "gel")


def test_a_missing_array_or_one_of_another_type_is_an_error(file: Path) -> None:
    _, members = read_archive(file, "file")
    for changed in ({}, {"records.msgpack": b"\xc0"}, {"records.msgpack": members["records.msgpack"]}):
        with pytest.raises(READ_ERRORS):
            from_members(changed, Calibration)
