"""A call of the Python interface leaves a program's threads of matrices as it found them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import scipy.linalg  # noqa: F401 - whose library is counted too
from threadpoolctl import threadpool_info, threadpool_limits

from host_sync.kernels.process_settings import one_blas_thread


def threads() -> set[int]:
    found = {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}
    assert found
    return found


def test_matrices_have_one_thread_inside_and_what_they_had_outside() -> None:
    with threadpool_limits(2, user_api="blas"):
        assert threads() == {2}
        with one_blas_thread():
            assert threads() == {1}
            with one_blas_thread():
                assert threads() == {1}
            assert threads() == {1}
        assert threads() == {2}


def test_after_calls_that_overlap_matrices_have_their_threads_back() -> None:
    first_inside, both_inside, first_outside = Event(), Event(), Event()
    before = threads()

    def first() -> None:
        with one_blas_thread():
            first_inside.set()
            assert both_inside.wait(60)
        first_outside.set()

    def second() -> None:
        assert first_inside.wait(60)
        with one_blas_thread():
            assert threads() == {1}
            both_inside.set()
            assert first_outside.wait(60)

    with ThreadPoolExecutor(2) as pool:
        for call in (pool.submit(first), pool.submit(second)):
            call.result()
    assert threads() == before
