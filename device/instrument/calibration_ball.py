"""The ball that calibrates when nobody names another."""

from __future__ import annotations

from typing import Final

BALL_RADIUS_MM: Final = 3.0
