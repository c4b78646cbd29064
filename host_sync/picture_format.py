"""The formats that figures are written in."""

from __future__ import annotations

from typing import Literal

PictureFormat = Literal["png", "pdf", "svg"]
