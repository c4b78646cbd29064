"""numba with its cache folder chosen first: every module of the package takes numba's functions from here.

numba reads its settings when it is imported, and would otherwise write compiled kernels beside the sources.
"""

from __future__ import annotations

from host_sync.kernels.cache import configure_cache

configure_cache()

from numba import get_num_threads, njit, set_num_threads  # noqa: E402

__all__ = ["get_num_threads", "njit", "set_num_threads"]
