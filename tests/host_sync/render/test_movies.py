"""Movies for browsers: VP9 with the extra `movies`, an animated WebP without it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from host_sync.render.picture_file import ReliefGif, ReliefMovie, plays_in_browser

SHAPE = (120, 160)


def picture(number: int) -> np.ndarray:
    """A field whose left part grows lighter from picture to picture."""
    found = np.full((*SHAPE, 3), 30, np.uint8)
    found[:, :80] = 30 + 20 * number
    return found


def test_an_mp4_holds_vp9_where_its_encoder_is_installed(tmp_path: Path) -> None:
    library = pytest.importorskip("av", reason="the extra `movies` is not installed")
    assert plays_in_browser()
    path = tmp_path / "a.mp4"
    with ReliefMovie(path, SHAPE, 25.0) as movie:
        for number in range(10):
            movie.append(picture(number))
    with library.open(str(path)) as held:
        (stream,) = held.streams.video
        assert (stream.codec_context.name, stream.average_rate) == ("vp9", 25)
        shown = [frame.to_ndarray(format="rgb24") for frame in held.decode(video=0)]
    assert len(shown) == 10
    for number, frame in enumerate(shown):
        assert abs(float(frame[:, :60].mean()) - (30 + 20 * number)) < 6.0


def test_a_webp_plays_in_full_colour(tmp_path: Path) -> None:
    movie = ReliefGif(10, 10.0)
    for number in range(10):
        movie.append(number, picture(number))
    movie.write(tmp_path / "a.webp")
    with Image.open(tmp_path / "a.webp") as shown:
        assert (shown.n_frames, shown.info["loop"]) == (10, 0)
        for number in range(10):
            shown.seek(number)
            assert abs(float(np.asarray(shown.convert("RGB"))[:, :60].mean()) - (30 + 20 * number)) < 6.0
