"""Distances have the same bits with any number of OpenCV's threads, on small fields, and wherever arrays lie."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from host_sync.integration.zero_level import distance_px


@pytest.fixture(autouse=True)
def threads_as_before() -> Iterator[None]:
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


@pytest.mark.parametrize("shape", [(40, 60), (191, 256)])
def test_the_bits_do_not_depend_on_threads_or_on_places_in_memory(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    mask = random.random(shape) < 0.001
    mask[3, 5] = True
    found, held = set(), []
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        for _ in range(10):
            held.append(np.full(random.integers(1, 300_000), 7, np.uint8))  # moves what is allocated next
            found.add(distance_px(mask).tobytes())
    assert len(found) == 1
    row, column = np.indices(shape)
    places = np.argwhere(mask)
    exact = np.sqrt(np.min([(row - down) ** 2 + (column - right) ** 2 for down, right in places], axis=0))
    assert np.frombuffer(found.pop(), np.float32).reshape(shape) == pytest.approx(exact, rel=2e-7)


def test_other_calls_keep_what_they_were_using() -> None:
    before = cv2.ipp.useIPP()
    distance_px(np.eye(9, dtype=np.bool_))
    assert cv2.ipp.useIPP() == before
