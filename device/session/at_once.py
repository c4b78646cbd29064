"""Processing without a thread: for virtual time, in which nothing takes time but sleeping."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

from device.errors import DeviceError
from hal.errors import HalError

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class AtOnce(Executor):
    """Runs every job before `submit` returns, so that runs repeat exactly."""

    def submit(
        self, fn: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """A future that is done; what an instrument refuses waits in it, as in a thread's."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except (DeviceError, HalError) as error:
            future.set_exception(error)
        return future
