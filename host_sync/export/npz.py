"""NumPy archive with all fields, in µm, without pickled objects."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np

from host_sync.export.source_surface import SourceSurface


def write_npz(file: BinaryIO, surface: SourceSurface) -> None:
    """Write `z_um`, `valid`, `pixel_pitch_um`, `name`, `origin`, `written_utc`; if known `sigma_um`, `extrapolated`."""
    arrays: dict[str, Any] = {
        "z_um": surface.z_um,
        "valid": np.isfinite(surface.z_um),
        "pixel_pitch_um": np.float64(surface.pitch_um),
        "name": np.str_(surface.name),
        "origin": np.str_(surface.origin),
        "written_utc": np.str_(surface.written_utc),
    }
    if surface.sigma_um is not None:
        arrays["sigma_um"] = surface.sigma_um
    if surface.extrapolated is not None:
        arrays["extrapolated"] = surface.extrapolated
    np.savez(file, allow_pickle=False, **arrays)
