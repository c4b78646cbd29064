"""The report's picture of a press over time."""

import cv2
import numpy as np

from device.bundles.movie import MovieFrameRecord, MovieRecord
from device.surface.fields import HeightMap
from host_sync.report.pictures import movie_picture

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
