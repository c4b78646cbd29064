"""Tests that print a report want a browser."""

from __future__ import annotations

import pytest

from host_sync.report.writing import find_browser

needs_browser = pytest.mark.skipif(find_browser() is None, reason="chromium is not installed (make test-deps)")
