"""What a board costs and weighs: the price classes of its rows in the bill of materials, and what it carries."""

from __future__ import annotations

import re
from collections.abc import Iterator

from tests.drawings.board.power import power_table
from tests.drawings.board.weights import handheld_g
from tests.drawings.board.wiring import wired_boards

CLASS_EUROS = {
    "–": (0, 0), "A": (0, 2), "B": (2, 10), "C": (10, 40), "D": (40, 100), "E": (100, 250), "M": (80, 200),
}  # fmt: skip
"""Least and most of each class; the page gives E no upper end, and what is known of such lenses stays under 250."""

ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| ([A-EM–]) \| ([^|]*) \|", re.MULTILINE)
BLOCK = re.compile(r"(<!-- made by `make board`: (\w+) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def with_total(page: str) -> str:
    """The bill with its tables of totals and power computed again."""
    return BLOCK.sub(lambda found: found[1] + "\n".join(_block(found[2], page)) + "\n" + found[3], page)


def _block(name: str, page: str) -> Iterator[str]:
    return {"total": lambda: _table(page), "power": power_table}[name]()


def part_numbers(page: str) -> dict[str, str]:
    """The part number, or what stands in its place, of every row."""
    return {f"{what} ({boards})": number for what, number, _, boards in ROW.findall(page)}


def rows_of(board: str, page: str) -> list[tuple[str, str]]:
    """What is bought for a board whatever its options, and the price class of each: rows for it by name or for all."""
    name = board.removesuffix("-binned")
    return [(what, price) for what, _, price, boards in ROW.findall(page) if {"all", name} & set(boards.split(", "))]


def euros(board: str, page: str) -> tuple[int, int]:
    """Least and most that a board costs, in euros."""
    ranges = [CLASS_EUROS[price] for _, price in rows_of(board, page)]
    return sum(least for least, _ in ranges), sum(most for _, most in ranges)


def seated_panel(page: str) -> dict[str, str]:
    """Rows that a panel on its seat adds, and the price class of each."""
    return {what: price for what, _, price, boards in ROW.findall(page) if boards == "with `--screen panel`"}


def panel_euros(page: str) -> tuple[int, int]:
    """Least and most that a panel and its seat cost, in euros."""
    ranges = [CLASS_EUROS[price] for price in seated_panel(page).values()]
    return sum(least for least, _ in ranges), sum(most for _, most in ranges)


def _table(page: str) -> Iterator[str]:
    yield "| board | rows | total | handheld weighs |"
    yield "|---|---|---|---|"
    for board in wired_boards():
        if board.endswith("-binned"):
            continue
        least, most = euros(board, page)
        grams = handheld_g(board)
        weight = "no housing" if grams is None else f"about {round(grams, -1):.0f} g"
        yield f"| {board} | {len(rows_of(board, page))} | {least} to {most} € | {weight} |"
