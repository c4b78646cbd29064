"""Our numbers against those of surfalize and Gwyddion, both GPL and only called; each skips where it is absent."""

import numpy as np
import pytest

from host_sync.filters.form import PolynomialForm
from host_sync.filters.gaussian_regression import ALPHA, gaussian_mean
from host_sync.profile.profile_line import Profile, profile_parameters
from tests.benchmarks.measurement import compare, gwyddion_oracle, surfaces

NAMES = ("sine", "tilt and noise", "grooves", "spheres", "fractal")

LOOSE = {
    # Of a correlation that is one pixel wide the way between pixels counts.
    ("tilt and noise", "Sal"): 0.03,
    ("tilt and noise", "Str"): 0.06,
    # A wave of 40 columns has forty heights: classes of equal share cut through ties that sorting keeps together.
    **{("sine", name): 0.08 for name in ("Sk", "Svk", "Smr2", "Vmp", "Vmc", "Vvc", "Vvv", "Sxp")},
    # The peaks stand on a plateau of one height, whose edge is a jump in the curve.
    ("spheres", "Spk"): 0.07,
}
UNDEFINED = {("sine", "Smr1"), ("sine", "Ssk")}
"""Zero but for rounding: there is no ratio to compare."""


@pytest.fixture(scope="module")
def gwyddion():
    try:
        return gwyddion_oracle.Gwyddion()
    except OSError as error:
        pytest.skip(f"Gwyddion's library is not installed (Debian: libgwyddion2-0): {error}")


def levelled(name: str) -> np.ndarray:
    z_um = surfaces.surfaces()[name].astype(np.float32)
    return PolynomialForm(np.ones(z_um.shape, np.bool_), 1).remove(z_um).astype(np.float64)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore")
def test_areal_parameters_are_surfalizes(name: str) -> None:
    pytest.importorskip("surfalize", reason="surfalize is not installed")
    z_um = levelled(name)
    own = compare.ours(z_um)
    compared = 0
    for parameter, value in compare.by_surfalize(z_um).items():
        if (name, parameter) in UNDEFINED or not np.isfinite(value):
            continue
        tolerance = LOOSE.get((name, parameter), 2e-3)
        assert own[parameter] == pytest.approx(value, rel=tolerance, abs=2e-4), parameter
        compared += 1
    assert compared >= 17


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_heights_and_slopes_are_gwyddions(gwyddion, name: str, masked: bool) -> None:
    z_um = levelled(name)
    if masked:
        z_um = surfaces.torn(z_um)
    own = compare.ours(z_um)
    found = gwyddion.heights(z_um, surfaces.PITCH_UM)
    for parameter in ("Sa", "Sq", "Ssk", "Sku", "Sz", "Sdq"):
        assert own[parameter] == pytest.approx(found[parameter], rel=1e-3, abs=1e-4), parameter
    if not masked:
        # Gwyddion cuts a cell into four triangles around its mean, which is smoother: noise has less area.
        assert own["Sdr"] == pytest.approx(found["Sdr"], rel=0.35 if name == "tilt and noise" else 0.07)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_forms_under_a_mask_are_gwyddions(gwyddion, degree: int) -> None:
    z_um = surfaces.torn(surfaces.surfaces()["fractal"])
    own = PolynomialForm(np.isfinite(z_um), degree).remove(z_um.astype(np.float32))
    np.testing.assert_allclose(own, gwyddion.levelled(z_um, degree), atol=2e-4)


def test_the_filter_inside_is_gwyddions(gwyddion) -> None:
    z_um = surfaces.surfaces()["fractal"]
    for cutoff_px in (8.0, 60.0):
        sigma_px = ALPHA * cutoff_px / np.sqrt(2.0 * np.pi)
        own = gaussian_mean(z_um.astype(np.float32), cutoff_px)
        inner = slice(int(5.0 * sigma_px) + 2, -int(5.0 * sigma_px) - 2)
        theirs = gwyddion.filtered(z_um, sigma_px)
        np.testing.assert_allclose(own[inner, inner], theirs[inner, inner], atol=2e-3)


def test_a_profiles_parameters_are_gwyddions(gwyddion) -> None:
    for z_um in surfaces.surfaces().values():
        line = z_um[100] - z_um[100].mean()
        own = profile_parameters(Profile(line, surfaces.PITCH_UM))
        for parameter, value in gwyddion.profile(line, surfaces.PITCH_UM).items():
            # A line's skewness and kurtosis are corrected there for the number of its samples.
            tolerance = 5e-3 if parameter in {"Psk", "Pku"} else 1e-6
            assert own[parameter] == pytest.approx(value, rel=tolerance, abs=1e-9), parameter
