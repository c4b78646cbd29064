"""By how much a map errs more on a ball that it did not see than on its training balls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.calibration.cross_validation import angle_between_deg
from device.calibration.fit import MIN_PIXELS, InverseFit, SlopeBand

LONE_BALL_INFLATION: Final = 2.0
"""For a map trained on one ball alone, so that none is left to hold out."""

MAX_SAMPLES: Final = 20_000

MEAN_OF_TWO: Final = float(np.sqrt(np.pi / 2.0))
"""Mean angle of the normal when each of its two components errs by a standard deviation of 1 (Rayleigh)."""

MIN_SHARE: Final = 0.1
"""Whatever its noise, this share of the fitted error's square counts as the map's."""


@dataclass(frozen=True, slots=True)
class BandErrors:
    """Mean angular errors of the normal between two tilts, all in degrees."""

    from_deg: float
    to_deg: float
    held_out_deg: float
    fitted_deg: float

    def inflation(self, pixel_deg: float) -> float:
        """Return held-out over fitted error, 1 at least, without the noise that both hold.

        pixel_deg : standard deviation of a component from pixel to pixel
        """
        noise = (MEAN_OF_TWO * pixel_deg) ** 2
        fitted = max(self.fitted_deg**2 - noise, MIN_SHARE * self.fitted_deg**2)
        return float(np.sqrt(max((self.held_out_deg**2 - self.fitted_deg**2) / fitted, 0.0) + 1.0))


@dataclass(frozen=True, slots=True)
class Inflation:
    """The errors over all pixels and band by band; no errors where no ball was held out."""

    overall: BandErrors | None
    bands: tuple[BandErrors, ...] = ()

    def at(self, tilt_deg: float, pixel_deg: float) -> float:
        """Return the factor at a tilt, that of all pixels where no band holds it."""
        band = next((band for band in self.bands if band.from_deg <= tilt_deg < band.to_deg), self.overall)
        return LONE_BALL_INFLATION if band is None else band.inflation(pixel_deg)

    def throughout(self, pixel_deg: float) -> float:
        """Return the factor over all tilts."""
        return LONE_BALL_INFLATION if self.overall is None else self.overall.inflation(pixel_deg)


def held_out_inflation(samples: BallSamples, fit: InverseFit) -> Inflation:
    """Return the inflation of a fit, by its training samples."""
    if fit.held_out_deg is None:
        return Inflation(None)
    step = max(1, len(samples.p) // MAX_SAMPLES)
    read = fit.map.predict(samples.intensity[::step], samples.column[::step], samples.row[::step])
    truth = np.stack([samples.p[::step], samples.q[::step]], axis=-1).astype(np.float64)
    error = angle_between_deg(read, truth)
    tilt = np.degrees(np.arctan(np.linalg.norm(truth, axis=1)))

    def errors(band: SlopeBand) -> BandErrors | None:
        rows = (tilt >= band.from_deg) & (tilt < band.to_deg)
        if min(int(rows.sum()), band.pixels) < MIN_PIXELS:
            return None
        return BandErrors(band.from_deg, band.to_deg, band.error_deg, float(error[rows].mean()))

    overall = BandErrors(0.0, 90.0, fit.held_out_deg, float(error.mean()))
    return Inflation(overall, tuple(found for band in fit.bands if (found := errors(band))))
