"""The figures of the paper's model, by the name of their file."""

from __future__ import annotations

from matplotlib.figure import Figure

from host_sync.calibration.ambiguity_figure import ambiguity_figure
from host_sync.calibration.paper_model import PaperModel
from host_sync.calibration.reflectance_figure import reflectance_figure


def paper_figures(model: PaperModel) -> dict[str, Figure]:
    """Figures like the paper's 3 and 4."""
    return {"reflectance-maps": reflectance_figure(model), "ambiguous-bins": ambiguity_figure(model)}
