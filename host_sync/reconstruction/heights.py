"""Heights of a frame over its skin at rest, from slopes with the prior that the skin rests."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from device.balls.viewpoint import Viewpoint
from device.imaging.flat_field import LinearFrame
from device.inverse_map.skin_at_rest import MIN_RESTING
from device.surface.fields import GradientField, HeightMap
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration
from host_sync.denoising.blur_correction import BLUR_PX, without_blur
from host_sync.frame_checks.colour_check import check_datum
from host_sync.integration.integrate import IntegrationReport, integrate
from host_sync.integration.zero_level import Datum, find_datum, no_datum
from host_sync.johnson2009.model import integrate_forward_difference
from host_sync.reconstruction.perspective import seen_elevation, seen_slopes
from host_sync.reconstruction.rest_prior import RestPrior
from host_sync.reconstruction.slope_reading import SlopeReading
from host_sync.results.record import FrameCheck, SlopeNoise


@dataclass(frozen=True, slots=True, eq=False)
class RestingSlopes:
    """Slopes of a frame with the prior that the skin rests.

    read : at the skin's own places
    over_pixels : as they rise over the pixels of a camera nearby; `read` where the camera is far away
    prior : None where it does not apply
    viewpoint : of the camera; None where it is far away or not known
    pitch_um : distance of neighbouring pixels
    is_papers : estimated by the paper's method
    """

    read: GradientField
    over_pixels: GradientField
    prior: RestPrior | None
    viewpoint: Viewpoint | None
    pitch_um: float
    is_papers: bool

    @classmethod
    def of(cls, reading: SlopeReading, *, keep_noise: bool) -> RestingSlopes:
        """Return the slopes of a reading; with `keep_noise` no prior applies."""
        read, calibration, is_papers = reading.gradients, reading.first.calibration, reading.method == "paper"
        viewpoint = calibration.viewpoint
        seen = read if viewpoint is None else seen_slopes(read, viewpoint)
        prior = None if keep_noise or is_papers else RestPrior.of(seen, reading.rest)
        if prior is not None:
            prior.apply(read)
            seen = read if viewpoint is None else seen_slopes(read, viewpoint)
        return cls(read, seen, prior, viewpoint, calibration.pitch_um, is_papers)

    def integrate(self, slopes: GradientField | None = None) -> tuple[HeightMap, IntegrationReport]:
        """Return the heights of slopes over pixels, by default its own, and the report of the solver."""
        solve = integrate_forward_difference if self.is_papers else integrate
        return solve(self.over_pixels if slopes is None else slopes, self.pitch_um)

    def integrate_detail(self, raw: GradientField, height: HeightMap) -> tuple[GradientField, HeightMap]:
        """Return raw slopes with the same prior over the pixels of a known height map, and their heights."""
        over_pixels = raw if self.viewpoint is None else seen_slopes(raw, self.viewpoint, height)
        if self.prior is not None:
            self.prior.apply(over_pixels)
        return over_pixels, self.integrate(over_pixels)[0]

    def check(self) -> tuple[FrameCheck, ...]:
        """Return how much of the skin is at rest, where the prior applies."""
        if self.prior is None:
            return ()
        return (FrameCheck("skin at rest", "passed", self.prior.resting, MIN_RESTING, "of the field"),)


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """Heights of a frame.

    height : zero at skin at rest
    gradients : the slopes that it was integrated from, of a camera nearby as they rise over its pixels
    datum : what the zero was taken from
    unlit : why the skin there is not lit as skin at rest is, a sentence each
    """

    height: HeightMap
    gradients: GradientField
    datum: Datum
    unlit: list[str]

    @classmethod
    def of(cls, slopes: RestingSlopes, integrated: HeightMap, reading: SlopeReading) -> Heights:
        """Return integrated heights over their zero, as a camera nearby sees them."""
        first, gradients = reading.first, slopes.over_pixels
        at_rest = None if slopes.prior is None else slopes.prior.at_rest(integrated.z_um.shape)
        found = find_datum(integrated, gradients, at_rest=at_rest) if reading.has_rest else None
        datum = (found or no_datum(integrated, gradients)).at_rest(integrated, gradients)
        model = first.calibration.skin_at_rest
        gain_sigma = 0.0 if model is None else model.gain_sigma
        unlit = [] if datum.is_relative else check_datum(first.intensity, datum.skin, gain_sigma)
        height = datum.level(integrated)
        if slopes.viewpoint is not None:
            height = seen_elevation(height, slopes.viewpoint)
            gradients = seen_slopes(slopes.read, slopes.viewpoint, height, out=gradients)
        return cls(height, gradients, datum, unlit)


def noise_of(frame: LinearFrame | RawFrame, calibration: Calibration) -> SlopeNoise | None:
    """Return the noise that shrinkage leaves in slopes of a frame; None where nothing is shrunk."""
    noise = calibration.slope_noise
    if noise is None or isinstance(frame, RawFrame) or frame.demosaiced:
        return noise
    # What a calibration of raw frames corrects of demosaicing is not missing from images that came with colours.
    return msgspec.structs.replace(noise, blur_px=min(noise.blur_px, BLUR_PX), raw_blur_px=0.0)


def sharpened(height: HeightMap, noise: SlopeNoise | None) -> HeightMap:
    """Return heights without the camera's blur."""
    return height if noise is None else without_blur(height, noise.blur_px)
