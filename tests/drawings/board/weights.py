"""What a handheld weighs: the rows of the bill of materials that it carries, in grams, and the block by its volume.

Masses of bought parts are makers' figures where they are known and estimates else; a fifth of the total may be missing.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from tests.drawings.board.block import Block

ACRYLIC_G_CM3: Final = 1.19
PETG_G_CM3: Final = 1.27
PANEL_G: Final = 280.0 + 97.0 + 13.0
"""The first 7-inch panel, its printed seat by its volume, and screws and foam tape."""

CARRIED_G: Final[dict[str, dict[str, float]]] = {
    "computer": {"pi4-imx477": 46, "pi5-imx296": 46},
    "cooler": {"pi5-imx296": 20},
    "camera": {"pi4-imx477": 31, "pi5-imx296": 34},
    "lens": {"pi4-imx477": 65, "pi5-imx296": 65},
    "extension rings": {"pi4-imx477": 20, "pi5-imx296": 15},
    "power bank": {"pi4-imx477": 190, "pi5-imx296": 190},
    "housing": {"pi4-imx477": 226, "pi5-imx296": 236},
    "straps (2)": {"pi4-imx477": 15, "pi5-imx296": 15},
    "carrier": {"pi4-imx477": 20, "pi5-imx296": 20},
    "wire": {"pi4-imx477": 20, "pi5-imx296": 20},
    "screws (15)": {"pi4-imx477": 9, "pi5-imx296": 9},
    "screws (6)": {"pi4-imx477": 6, "pi5-imx296": 6},
    "button": {"pi4-imx477": 12, "pi5-imx296": 12},
}
"""By row of the bill and board: housing with saddle (36 g by its volume) and without cap, carrier with what it carries,
wire with LEDs and plugs, the power bank with its cable."""


def block_g(block: Block | None = None) -> float:
    """Mass of the block."""
    block = block or Block.of_source()
    heights = np.linspace(0.0, 1.0, 201)
    edges = block.lower + (block.upper - block.lower) * heights
    half = np.arccos(edges / block.radius)
    areas = math.pi * block.radius**2 - 3.0 * block.radius**2 * (half - 0.5 * np.sin(2.0 * half))
    return float(np.mean(areas) * block.height * 1e-3 * ACRYLIC_G_CM3)


def handheld_g(board: str) -> float | None:
    """Mass of a handheld with battery, without panel, g; None of a board that has no housing."""
    if board not in CARRIED_G["housing"]:
        return None
    bought = sum(grams.get(board, 0.0) for grams in CARRIED_G.values())
    return bought + block_g()
