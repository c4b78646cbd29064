"""Pictures of a press over time and of a calibration in a report, and the bytes of its sheet."""

from pathlib import Path

import cv2
import numpy as np

from device.bundles.scan import MovieFrameRecord, MovieRecord
from device.surface import HeightMap
from host_sync.report.pictures import movie_picture, overview_picture
from host_sync.report.writing import Picture, Report, _repeatable, html_page

FIELD = HeightMap(np.zeros((1000, 1400), np.float32), 10.0)


def movie(best: int) -> MovieRecord:
    frames = tuple(
        MovieFrameRecord(f"movie-{i:03}.tif", 50.0 * i, min(0.008 * i, 0.3), None if i < 3 else 12.0 * i)
        for i in range(40)
    )
    return MovieRecord(2, best, frames)


def red_column(best: int) -> float:
    picture = movie_picture(movie(best), FIELD)
    image = np.asarray(cv2.imdecode(np.frombuffer(picture.png, np.uint8), cv2.IMREAD_COLOR), np.int64)
    assert image.shape[1::-1] == picture.size
    red = (image[..., 2] - image[..., 0] > 80) & (image[..., 2] - image[..., 1] > 80)
    return float(np.nonzero(red)[1].mean())


def test_the_frame_that_became_the_scan_is_marked_where_it_was_taken() -> None:
    assert red_column(10) < red_column(20) < red_column(35)


def test_frames_whose_depth_is_unknown_are_counted_not_drawn_as_zero() -> None:
    caption = movie_picture(movie(30), FIELD).caption
    assert caption.startswith("The press over time, 40 frames")
    assert caption.endswith("3 frames without a depth")


def test_the_overview_of_a_calibration_takes_the_width_of_a_page(tmp_path: Path) -> None:
    overview = tmp_path / "overview.png"
    assert cv2.imwrite(str(overview), np.zeros((2100, 1680, 3), np.uint8))
    (sheet,) = overview_picture(overview)
    relief = Picture("relief", sheet.png, (900, 700))
    page = html_page(Report("one", "none", (), (), (relief, sheet), (), ()))
    assert page.count('<img class="sheet"') == 1
    assert '<img class="sheet" src="data:image/png;base64,' in page.partition("<figcaption>relief")[2]
    overview.write_bytes(b"no picture")
    assert list(overview_picture(overview)) == []


def test_a_sheet_is_the_same_whenever_it_was_printed_and_however_the_browser_numbers_its_elements() -> None:
    def printed(first: int, day: int) -> bytes:
        elements = b"".join(b"/ID (node%08d) /Headers [(node%08d)]" % (first + 3 * k, first) for k in range(2))
        return b"/CreationDate (D:202601%02d120000+00'00')" % day + elements

    assert _repeatable(printed(17, 3)) == _repeatable(printed(16, 4))
    assert _repeatable(printed(17, 3)).count(b"(node00000000)") == 3
