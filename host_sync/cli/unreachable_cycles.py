"""Rare searches for unreachable cycles: by itself Python does it hundreds of times to load libraries."""

from __future__ import annotations

import gc
from typing import Final

SEARCH_EVERY: Final = 400_000
"""Objects between two searches: more than the libraries make while they are loaded.

By Python's own number, 700, a second `retrosync reconstruct` searches 380 times, 0.13 of its processor seconds; by half
this number once, 0.06.
"""


def search_seldom() -> None:
    """Search for unreachable cycles every `SEARCH_EVERY` objects from now on."""
    gc.set_threshold(SEARCH_EVERY)
