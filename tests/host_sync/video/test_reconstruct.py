"""Heights and movies of sequences of known surfaces; interrupted and bad sequences leave nothing incomplete."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numba
import numpy as np
import pytest
import tifffile
from PIL import Image

from device.balls.sphere import Viewpoint
from device.errors import CalibrationMismatch, OutputError
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import DARK_OFFSET, FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from device.surface import GradientField, HeightMap, integrate_dct, stereographic_from_slope
from host_sync.errors import SequenceError
from host_sync.frames.sequence import BadFrame, StoredFrame
from host_sync.reconstruction.slope_reading import seen_elevation, seen_slopes
from host_sync.results.record import SequenceRecord, encode_record, read_listed_record
from host_sync.video.fine_pass import WIDEST_PX, corrects_coarsely
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.reconstruct import HeightStack, SequenceOptions, open_heights, reconstruct_sequence
from tests.apparatus.plain_calibration import plain_calibration

SHAPE = (120, 160)
PITCH_UM = 10.0
REST = 0.4
PEAKS_UM = (0.0, 20.0, 40.0, 60.0)


def calibration() -> SimpleNamespace:
    """A calibration for which log red is the slope along columns and log green that along rows."""
    one, wide = np.ones(3, np.float32), np.full(3, 3.0, np.float32)
    centre = np.full(3, np.log(1.0 + DARK_OFFSET), np.float32)
    coefficients = np.zeros((4, 1, 2), np.float32)
    coefficients[3, 0, 0] = coefficients[2, 0, 1] = 1.0
    every_colour = TrainingDomain(-wide, 1.0, 1.0, np.zeros((7, 7, 7), np.float32))
    curve = FeatureRegressor(FeatureScaler(centre, one, -wide, wide), 1, 0, coefficients)
    inverse = InverseMap(SHAPE, every_colour, curve, 2.0)
    flat_field = np.full((*SHAPE, 3), REST, np.float32)
    return plain_calibration(flat_field, inverse, PITCH_UM)


def bump_um(peak_um: float) -> np.ndarray:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return peak_um * np.exp(-((row - 60.0) ** 2 + (column - 80.0) ** 2) / (2.0 * 12.0**2))


def frame_of(peak_um: float, name: str) -> StoredFrame:
    q, p = np.gradient(bump_um(peak_um) / PITCH_UM)
    u = stereographic_from_slope(p, q)
    intensity = np.ones((*SHAPE, 3))
    intensity[..., :2] = (1.0 + DARK_OFFSET) * np.exp(u) - DARK_OFFSET
    return StoredFrame(name, np.rint(intensity * REST * 65535.0).astype(np.uint16))


class Played:
    """A sequence defined by the test; an exception in it is raised at its turn."""

    rate_hz = 50.0

    def __init__(self, *frames: StoredFrame | BadFrame | type[BaseException]) -> None:
        self._frames = frames
        self.count = len(frames)

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        for frame in self._frames:
            if isinstance(frame, type):
                raise frame
            yield frame


def press() -> list[StoredFrame]:
    return [frame_of(peak_um, f"frame {number}") for number, peak_um in enumerate(PEAKS_UM)]


def solver(**options: bool) -> FrameSolver:
    return FrameSolver(calibration(), "direct", "linear", **options)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a growing bump whose third frame cannot be read and whose fifth is black."""
    out = tmp_path_factory.mktemp("video") / "out"
    frames = press()
    black = StoredFrame("black.png", np.zeros((*SHAPE, 3), np.uint16))
    played = Played(*frames[:2], BadFrame("torn.png", "torn.png: is truncated"), frames[2], black, frames[3])
    report = reconstruct_sequence(played, calibration(), solver(), out, SequenceOptions("bump"))
    assert [outcome.name for outcome in report.failures] == ["torn.png", "black.png"]
    assert "black.png is black" in report.failures[1].reason
    return out


def test_frames_that_came_late_keep_the_time_at_which_they_were_taken(tmp_path: Path) -> None:
    late = [replace(frame, taken_ns=10**9 * at_s) for frame, at_s in zip(press(), (5, 6, 16, 17), strict=True)]
    for options, expected in (
        (SequenceOptions("x"), [0.0, 1.0, 11.0, 12.0]),
        (SequenceOptions("x", 2.0), [0, 0.5, 1, 1.5]),
    ):
        reconstruct_sequence(Played(*late), calibration(), solver(), tmp_path / "out", options)
        written = json.loads((tmp_path / "out" / "result.json").read_text())
        assert [frame["time_s"] for frame in written["frames"]] == expected
        rows = (tmp_path / "out" / "contact.csv").read_text().splitlines()[1:]
        assert [float(row.split(",")[1]) for row in rows] == expected


def test_every_page_is_its_frames_height_and_bad_frames_keep_their_time(result: Path) -> None:
    heights = tifffile.imread(result / "heights_um.tif")
    assert heights.dtype == np.float32
    assert heights.shape == (6, *SHAPE)
    for page, peak_um in zip((0, 1, 3, 5), PEAKS_UM, strict=True):
        assert np.abs(heights[page] - bump_um(peak_um)).max() < 0.02 * 60.0
    assert np.isnan(heights[[2, 4]]).all()


def test_imagej_reads_time_and_pitch(result: Path) -> None:
    with tifffile.TiffFile(result / "heights_um.tif") as tiff:
        about, first = tiff.imagej_metadata, tiff.pages.first
        assert tiff.series[0].axes == "TYX"
        assert not first.is_tiled
        assert first.compression == 1
        assert first.tags["XResolution"].value[1] / first.tags["XResolution"].value[0] == PITCH_UM
    assert about["frames"] == 6
    assert about["finterval"] == pytest.approx(1.0 / 50.0)
    assert about["unit"] == "um"


def test_the_record_has_every_frames_figures(result: Path) -> None:
    record = json.loads((result / "result.json").read_text())
    assert record["rate_hz"] == 50.0
    assert record["encoding"] == "linear"
    frames = record["frames"]
    assert [frame["time_s"] for frame in frames] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.1])
    assert frames[2]["failed"] == "torn.png: is truncated"
    shown = [frames[number] for number in (0, 1, 3, 5)]
    assert [frame["peak_um"] for frame in shown] == pytest.approx(PEAKS_UM, abs=1.0)
    contact = [frame["contact_share"] for frame in shown]
    assert contact[0] == 0.0
    assert 0.005 < contact[1] < contact[3] < 0.5
    assert all(frame["masked_share"] == frame["clipped_share"] == 0.0 for frame in shown)
    low_um, high_um = record["colour_range_um"]
    assert -1.5 < low_um < 1.5
    assert 50.0 < high_um < 61.0


def test_the_record_is_read_by_the_type_that_writes_it(result: Path) -> None:
    record = read_listed_record(result)
    assert isinstance(record, SequenceRecord)
    assert encode_record(record) == (result / "result.json").read_bytes()
    assert record.frames[2].failed == "torn.png: is truncated"
    assert record.frames[5].peak_um == pytest.approx(PEAKS_UM[-1], abs=1.0)


def test_the_movie_shows_every_frame_in_one_range_of_colours(result: Path) -> None:
    movie = cv2.VideoCapture(str(result / "relief.mp4"))
    assert movie.get(cv2.CAP_PROP_FPS) == pytest.approx(50.0)
    pictures = []
    while (read := movie.read())[0]:
        pictures.append(read[1].astype(float))
    movie.release()
    assert len(pictures) == 6
    rest, apex = ([picture[y, x].mean() for picture in pictures] for y, x in ((60, 40), (160, 180)))
    # Untouched skin keeps its colour; the apex grows lighter with its height; a frame without heights is white.
    assert np.ptp([rest[number] for number in (0, 1, 3, 5)]) < 12.0
    assert apex[0] + 20.0 < apex[1] < apex[3] < apex[5]
    assert rest[2] > 240.0
    with Image.open(result / "relief.gif") as gif:
        assert gif.n_frames == 2
        assert gif.info["duration"] == 80


def test_frames_of_another_size_or_order_are_named_and_the_others_go_on(tmp_path: Path) -> None:
    good = frame_of(40.0, "good")
    small = StoredFrame("small.png", good.pixels[:-1])
    report = reconstruct_sequence(
        Played(small, good), calibration(), solver(), tmp_path / "out", SequenceOptions("x", mp4=False, gif=False)
    )
    (failure,) = report.failures
    assert failure.reason.startswith("small.png: the frame is 160x119 pixels")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"heights_um.tif", "result.json", "contact.csv", "contact.png"}


def test_a_mirrored_frame_after_one_that_passes_is_refused() -> None:
    uneven = calibration()
    across, down = (np.linspace(0.98, 1.02, length)[:, None] for length in reversed(SHAPE))
    uneven.flat_field = np.ascontiguousarray(uneven.flat_field * across * down[:, None], np.float32)
    pixels = np.rint(uneven.flat_field * 65535.0).astype(np.uint16)
    of_uneven = FrameSolver(uneven, "direct", "linear")
    of_uneven.check(StoredFrame("good", pixels))
    mirrored = StoredFrame("mirrored", np.ascontiguousarray(pixels[:, ::-1]))
    with pytest.raises(CalibrationMismatch, match="mirrored left to right"):
        of_uneven.solve(mirrored, np.empty(SHAPE, np.float32))


def test_without_weights_a_clean_surface_is_the_same(tmp_path: Path) -> None:
    weighted, equal = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.float32)
    one, other = solver(), solver(weighted=False)
    frame = frame_of(60.0, "frame")
    one.solve(frame, weighted)
    other.solve(frame, equal)
    np.testing.assert_allclose(weighted, equal, atol=0.5)


def test_a_camera_nearby_is_as_a_still_frame_knows_it() -> None:
    """Where the camera stands at one side, slopes that rise towards it look steeper."""
    above, nearby = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.float32)
    frame = frame_of(60.0, "frame")
    solver().solve(frame, above)
    known = calibration()
    known.viewpoint = Viewpoint(-300.0, 0.5 * (SHAPE[0] - 1), 600.0)
    figures = FrameSolver(known, "direct", "linear").solve(frame, nearby)
    q, p = np.gradient(above / PITCH_UM)
    slopes = GradientField(p, q, np.isfinite(p), np.ones(SHAPE, np.float32))
    seen = seen_slopes(slopes, known.viewpoint)
    expected = seen_elevation(HeightMap(integrate_dct(seen.p, seen.q, PITCH_UM), PITCH_UM), known.viewpoint).z_um
    np.testing.assert_allclose(nearby - np.median(nearby), expected - np.median(expected), atol=0.5)
    assert np.abs(nearby - above).max() > 2.0
    assert figures.peak_um == pytest.approx(float(np.nanmax(nearby)))


def test_a_solver_keeps_no_trace_of_the_frame_before() -> None:
    first, second, again = (np.empty(SHAPE, np.float32) for _ in range(3))
    one = solver()
    one.solve(frame_of(60.0, "frame"), first)
    one.solve(frame_of(20.0, "other"), second)
    one.solve(frame_of(60.0, "frame"), again)
    np.testing.assert_array_equal(first, again)


def test_heights_do_not_depend_on_how_many_threads_there_are(tmp_path: Path) -> None:
    before, heights = numba.get_num_threads(), []
    try:
        for threads in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(threads)
            out = tmp_path / f"{len(heights)}"
            reconstruct_sequence(
                Played(*press()), calibration(), solver(), out, SequenceOptions("x", None, False, False)
            )
            heights.append(tifffile.imread(out / "heights_um.tif"))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*heights)


@pytest.mark.parametrize("end", [KeyboardInterrupt, OSError])
def test_an_interrupted_sequence_leaves_what_stood_there(tmp_path: Path, end: type[BaseException]) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("before")
    with pytest.raises(KeyboardInterrupt if end is KeyboardInterrupt else OutputError):
        reconstruct_sequence(Played(*press(), end), calibration(), solver(), out, SequenceOptions("x"))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (out / "result.json").read_text() == "before"


def test_a_sequence_without_a_good_frame_is_refused_whole(tmp_path: Path) -> None:
    mute = FrameSolver(calibration(), "direct", None)
    with pytest.raises(SequenceError, match=r"none of 4 frames could be reconstructed: frame 0: .*--encoding"):
        reconstruct_sequence(Played(*press()), calibration(), mute, tmp_path / "out", SequenceOptions("x"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("pages", [1, 2, 5])
def test_a_stack_that_ends_early_says_how_many_pages_it_has(tmp_path: Path, pages: int) -> None:
    path = tmp_path / "stack.tif"
    with HeightStack(path, SHAPE, 5, PITCH_UM, 25.0) as stack:
        for number in range(pages):
            stack.append(np.full(SHAPE, number, np.float32))
    with tifffile.TiffFile(path) as tiff:
        assert len(tiff.pages) == tiff.imagej_metadata["frames"] == pages
    assert open_heights(path)[:, 3, 4].tolist() == list(range(pages))


@pytest.mark.parametrize(("columns", "coarse"), [(WIDEST_PX, False), (WIDEST_PX + 1, True)])
def test_light_that_is_corrected_on_fewer_cells_makes_frames_doubtful(columns: int, coarse: bool) -> None:
    known = calibration().light
    assert corrects_coarsely(columns, known, "direct") == coarse
    assert not corrects_coarsely(columns, known, "paper")
    assert not corrects_coarsely(columns, replace(known, confirmed=0.0), "direct")
