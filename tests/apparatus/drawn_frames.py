"""Waits until a page has drawn."""

from __future__ import annotations

from typing import Any


def settle(page: Any) -> None:
    """Wait for two frames of a page."""
    page.wait_for_function("() => (window.drawn = (window.drawn ?? 0) + 1) % 3 === 0")
