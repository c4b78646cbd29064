"""numba's compiler, with compiled kernels cached by all that they reach, and the time that a run spent compiling.

Every module of the package takes numba's functions from here.

numba itself compiles a cached kernel again when the kernel's file changes, whatever the change, and not when another
file changes that holds a kernel or a constant which it uses: old and new code would run together and heights would be
wrong without notice. Its index of a kernel's compiled types is also written without a lock, so that two processes can
exchange two types. Here a compiled kernel is a file named by a digest of the bytecode, the constants and the options of
the kernel and of every kernel that it calls, of its argument types, of the processor and of the versions of numba and
llvmlite. A docstring or a moved line changes none of these.
"""

from __future__ import annotations

import dis
import inspect
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import EnumType
from hashlib import blake2b
from pathlib import Path
from tempfile import NamedTemporaryFile
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import numpy as np

from host_sync.kernels.cache import SETTING, SUFFIX, configure_cache

configure_cache()

import llvmlite  # noqa: E402
import numba  # noqa: E402
from numba import get_num_threads, set_num_threads  # noqa: E402
from numba.core import event  # noqa: E402
from numba.core.caching import _Cache  # noqa: E402
from numba.core.compiler import CompileResult  # noqa: E402
from numba.core.dispatcher import Dispatcher  # noqa: E402
from numba.core.serialize import dumps  # noqa: E402

__all__ = ["get_num_threads", "kernel_digest", "njit", "set_num_threads", "watch_compiling"]

DIGEST_BYTES: Final = 16
OWN_PACKAGES: Final = ("hal", "device", "host_sync")
PLAIN: Final = (type(None), bool, int, float, complex, str, bytes, np.generic)


def njit(*, cache: bool = False, **options: Any) -> Callable[[Any], Any]:
    """Compile a function as `numba.njit` does, cached by all that it reaches."""

    def compiled(function: FunctionType) -> Any:
        dispatcher = numba.njit(**options)(function)
        if cache:
            dispatcher._cache = _KernelCache(dispatcher)
        return dispatcher

    return compiled


def kernel_digest(kernel: Any) -> bytes:
    """Return the digest of everything that decides what a kernel computes.

    Argument types and the machine are no part of it.

    Raises
    ------
    TypeError
        The kernel uses a global whose content cannot be part of the digest: a module or a plain function of this
        package, or an object of another kind than numbers, texts, arrays, containers of these, types and kernels.
    """
    digest = blake2b(digest_size=DIGEST_BYTES)
    for fact in _facts_of_kernel(kernel, set()):
        digest.update(fact.encode("utf-8", "surrogatepass") + b"\0")
    return digest.digest()


class _KernelCache(_Cache):
    """Compiled signatures of one kernel, a file each; a folder that cannot be read or written keeps none."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._digest: bytes | None = None
        self._folder = os.environ.get(SETTING, "")
        self._enabled = bool(self._folder)

    @property
    def cache_path(self) -> str:
        return self._folder

    def enable(self) -> None:
        self._enabled = bool(self._folder)

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        """Do nothing: what is out of date has another name."""

    def load_overload(self, signature: object, target_context: Any) -> object | None:
        target_context.refresh()
        if not self._enabled:
            return None
        path = self._path(signature, target_context.codegen())
        try:
            content = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        if blake2b(content[DIGEST_BYTES:], digest_size=DIGEST_BYTES).digest() != content[:DIGEST_BYTES]:
            return None  # a file that was not fully written when the power failed
        try:
            reduced = pickle.loads(content[DIGEST_BYTES:])  # noqa: S301 - written by `save_overload`, in the user's cache
            compiled: object = CompileResult._rebuild(target_context, *reduced)  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError):
            return None  # a kernel that it calls, or a type, was in another module when it was compiled
        return compiled

    def save_overload(self, signature: object, compiled: Any) -> None:
        if (
            not self._enabled
            or any(not loop.can_cache for loop in compiled.lifted)
            or compiled.library.has_dynamic_globals
        ):
            return
        content = dumps(compiled._reduce())  # type: ignore[no-untyped-call]
        path = self._path(signature, compiled.codegen)
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=path.parent, delete=False) as stream:
                stream.write(blake2b(content, digest_size=DIGEST_BYTES).digest() + content)
            Path(stream.name).replace(path)

    def _path(self, signature: object, codegen: Any) -> Path:
        """Return the file of a signature.

        The kernel's digest is taken at the first call, when all that it calls is defined.
        """
        if self._digest is None:
            self._digest = kernel_digest(self._kernel)
        facts = (signature, codegen.magic_tuple(), numba.__version__, llvmlite.__version__, sys.version_info[:2])
        named = blake2b(self._digest + repr(facts).encode(), digest_size=DIGEST_BYTES)
        function = self._kernel.py_func
        name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
        return Path(self._folder) / f"{name}-{named.hexdigest()}{SUFFIX}"


def _facts_of_kernel(kernel: Any, seen: set[int]) -> Iterator[str]:
    if id(kernel) in seen:
        yield f"again {kernel.py_func.__qualname__}"
        return
    seen.add(id(kernel))
    function = kernel.py_func
    yield f"kernel {function.__qualname__}"
    yield from _facts(kernel.targetoptions, seen, function)
    yield from _facts(function.__defaults__, seen, function)
    yield from _facts_of_code(function.__code__, function.__doc__)
    for name, value in _reached(function):
        yield name
        yield from _facts(value, seen, function)


def _facts_of_code(code: CodeType, docstring: str | None = None) -> Iterator[str]:
    yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_exceptiontable.hex()}"
    for number, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            yield from _facts_of_code(constant)
        elif number or constant != docstring:
            yield repr(constant)


def _reached(function: FunctionType) -> Iterator[tuple[str, object]]:
    """Globals, by name, and closure variables that a function reads."""
    for name in sorted(set(_globals_of(function.__code__))):
        if name in function.__globals__:
            yield name, function.__globals__[name]
    yield from zip(
        function.__code__.co_freevars, (cell.cell_contents for cell in function.__closure__ or ()), strict=True
    )


def _globals_of(code: CodeType) -> Iterator[str]:
    for instruction in dis.get_instructions(code):
        if instruction.opname == "LOAD_GLOBAL":
            yield instruction.argval
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _globals_of(constant)


def _facts(value: object, seen: set[int], user: FunctionType) -> Iterator[str]:
    """Return the facts that identify the content of a value that a kernel uses."""
    if isinstance(value, PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, Dispatcher):
        yield from _facts_of_kernel(value, seen)
    elif isinstance(value, np.ndarray):
        yield f"array {value.dtype} {value.shape} {value.strides} {value.tobytes().hex()}"
    elif isinstance(value, dict):
        yield from _facts(sorted(value.items()), seen, user)
    elif isinstance(value, (set, frozenset)):
        yield from _facts(sorted(value, key=repr), seen, user)
    elif isinstance(value, (tuple, list)):
        yield f"{type(value).__qualname__} of {len(value)}"
        for item in value:
            yield from _facts(item, seen, user)
    elif isinstance(value, EnumType):
        yield from _facts({name: value[name].value for name in value.__members__}, seen, user)
    elif isinstance(value, type) and hasattr(value, "_fields"):
        yield f"named tuple {value.__qualname__} {value._fields}"
    elif isinstance(module := inspect.getmodule(value), ModuleType) and _is_foreign(module):
        yield f"{module.__name__} {getattr(value, '__qualname__', value)!s}"
    elif isinstance(value, np.ufunc):
        yield f"ufunc {value.__name__}"
    else:
        raise TypeError(f"the kernel {user.__module__}.{user.__qualname__} uses {value!r}, which no digest can cover")


def _is_foreign(module: ModuleType) -> bool:
    return module.__name__.partition(".")[0] not in OWN_PACKAGES


class _Watch(event.Listener):
    """Passes on numba's events."""

    def __init__(self, begin: Callable[[], None], end: Callable[[], None]) -> None:
        self._begin = begin
        self._end = end

    def on_start(self, _: event.Event) -> None:
        self._begin()

    def on_end(self, _: event.Event) -> None:
        self._end()


def watch_compiling(begin: Callable[[], None], end: Callable[[], None]) -> None:
    """Have `begin` and `end` called around every compilation, nested ones too, in the thread that compiles."""
    event.register("numba:compile", _Watch(begin, end))  # type: ignore[no-untyped-call]


class CompileTime:
    """Counts the seconds in which at least one thread compiles; what is loaded from the cache does not count."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = 0
        self._since_s = 0.0
        self._total_s = 0.0
        watch_compiling(self._begin, self._end)

    @property
    def total_s(self) -> float:
        """Seconds so far."""
        with self._lock:
            return self._total_s + (time.monotonic() - self._since_s if self._running else 0.0)

    def _begin(self) -> None:
        with self._lock:
            self._running += 1
            if self._running == 1:
                self._since_s = time.monotonic()

    def _end(self) -> None:
        with self._lock:
            self._running -= 1
            if self._running == 0:
                self._total_s += time.monotonic() - self._since_s
