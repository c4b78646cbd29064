"""Uncertainty of the scale of heights from those of pixel pitch and ball radius.

A ball's slopes are its places over its radius: p = s / sqrt(1 - s²), s = pixels times pitch over radius. Heights add up
slopes times pitch. So a height is proportional to the square of the pitch and to the inverse of the radius (of gentle
slopes; steep ones feel both more). Neither shows in the shading of balls of one size: what shading shows is the ratio
of a ball's places to its radius alone, and a map learned from it fits as well with both wrong by one share. Balls of
two radii contradict each other where one of the two is wrong; they do not determine the pitch either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from device.surface import Float64Array
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.pixel_pitch import RECTANGLE, PixelPitch
from host_sync.results.record import HEIGHT_PER_PITCH

PIXEL_PITCH: Final = "pixel pitch"
SAME_RADIUS: Final = 0.02
"""Radii this share apart are two sizes of balls."""


class ScaleUncertainty(msgspec.Struct, frozen=True):
    """Standard uncertainties of the scale; None is not measured, never 0.

    pixel_pitch_sigma_um : of the pixel pitch, µm
    pixel_pitch_share : the same over the pitch
    ball_radius_share : of the balls' radii, as a share
    height_share : of heights, as a share
    not_measured : which of the two that heights depend on are not
    """

    pixel_pitch_sigma_um: float | None
    pixel_pitch_share: float | None
    ball_radius_share: float | None
    height_share: float | None
    not_measured: tuple[str, ...]


def scale_uncertainty(
    pitch: PixelPitch | None, presses: Sequence[PressFrame], radius_shares: Float64Array, radii_px: Float64Array
) -> ScaleUncertainty:
    """Return the scale's uncertainty.

    radius_shares : radius that shading gives each ball over the one stated
    radii_px : the one stated, by ball
    """
    pitch_share = pitch.sigma_um / pitch.pitch_um if pitch else None
    radius_share = _radius_share(presses, radius_shares, radii_px)
    height_share = None
    if pitch_share is not None and radius_share is not None:
        height_share = float(np.hypot(HEIGHT_PER_PITCH * pitch_share, radius_share))
    named = {PIXEL_PITCH: pitch_share, "ball radius": radius_share}
    return ScaleUncertainty(
        pixel_pitch_sigma_um=pitch.sigma_um if pitch else None,
        pixel_pitch_share=pitch_share,
        ball_radius_share=radius_share,
        height_share=height_share,
        not_measured=tuple(name for name, share in named.items() if share is None),
    )


def with_stated_pitch(scale: ScaleUncertainty, pitch_um: float, tolerance: float) -> ScaleUncertainty:
    """Return the scale's uncertainty with that of a stated pixel pitch; a measured pitch is kept.

    tolerance : fraction, ±, within which the stated pitch lies
    """
    if scale.pixel_pitch_share is not None:
        return scale
    share = RECTANGLE * tolerance
    radius_share = scale.ball_radius_share
    return msgspec.structs.replace(
        scale,
        pixel_pitch_sigma_um=share * pitch_um,
        pixel_pitch_share=share,
        height_share=None if radius_share is None else float(np.hypot(HEIGHT_PER_PITCH * share, radius_share)),
        not_measured=tuple(name for name in scale.not_measured if name != PIXEL_PITCH),
    )


def _radius_share(presses: Sequence[PressFrame], shares: Float64Array, radii_px: Float64Array) -> float | None:
    """Return the relative uncertainty of the radius, from the stated tolerances.

    Else from balls of several sizes, by how far shading puts each size from the rest.
    """
    tolerances = [press.radius_tolerance for press in presses if press.radius_tolerance is not None]
    if tolerances:
        return RECTANGLE * max(tolerances)
    sizes = np.round(np.log(radii_px) / SAME_RADIUS).astype(int)
    middles = [float(np.nanmedian(shares[sizes == size])) for size in np.unique(sizes)]
    return float(np.std(middles, ddof=1)) if len(middles) > 1 else None
