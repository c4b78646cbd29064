"""The certificate's picture: every specimen's error over its certified value, with both uncertainties."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Final

from matplotlib.figure import Figure

from host_sync.certificate.certificate import Certificate
from host_sync.report.content import Picture
from host_sync.text import printable

DPI: Final = 130
SIZE_IN: Final = (7.0, 2.4)
_RED: Final = "#b03020"
_BLUE: Final = "#24527a"


def pictures_of(certificate: Certificate) -> Iterator[Picture]:
    """The picture, where a specimen was measured."""
    shown = [one for one in certificate.specimens if one.error_um is not None and one.certified_um > 0.0]
    if not shown:
        return
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(visible=True, axis="y", linewidth=0.3, alpha=0.5)
    axes.axhline(0.0, color="black", linewidth=0.6)
    for place, one in enumerate(shown):
        percent = 100.0 / one.certified_um
        colour = _RED if one.agrees is False else _BLUE
        own = percent * one.certified_expanded_um
        axes.fill_between([place - 0.3, place + 0.3], -own, own, color="black", alpha=0.15, linewidth=0.0)
        off = percent * (one.error_um or 0.0)
        if one.expanded_um is None:
            axes.plot([place], [off], "x", color=colour)
        else:
            axes.errorbar([place], [off], [percent * one.expanded_um], fmt="o", color=colour, capsize=4, linewidth=1.1)
    names = [printable(one.name).replace("$", r"\$")[:24] for one in shown]
    axes.set_xticks(range(len(shown)), names, fontsize=7)
    axes.set_xlim(-0.6, len(shown) - 0.4)
    axes.set_ylabel("error, % of certified")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    size = (round(SIZE_IN[0] * DPI), round(SIZE_IN[1] * DPI))
    yield Picture("Error of each specimen with its ± (k = 2); grey: ± of the certified value", stream.getvalue(), size)
