import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.calibration.cross_validation import angle_between_deg
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from host_sync.calibration_report.paper_figures import ambiguity_figure, most_ambiguous, reflectance_figure
from host_sync.johnson2009.lookup_table import slopes_of_bin
from host_sync.johnson2009.model import estimate_gradients, fit_paper_model
from host_sync.johnson2009.spherical_harmonics import reflectance_surface

SIZE = 220
NOISE = 0.01
LIGHTS = [np.array([np.cos(a), np.sin(a), np.tan(np.radians(40))]) for a in np.radians([90, 210, 330])]


def reflectance(p, q):
    """A skin half Lambertian, half a broad lobe, under three distant lights; it reads 1 where flat."""
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p * p + q * q)[..., None]
    channels = []
    for light in LIGHTS:
        towards = light / np.linalg.norm(light)
        half = towards + np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half)
        lobe = np.exp((normal @ half - 1.0) / (1.0 - np.cos(np.radians(25))))
        flat = 0.5 * towards[2] + 0.5 * np.exp((half[2] - 1.0) / (1.0 - np.cos(np.radians(25))))
        channels.append((0.5 * np.maximum(normal @ towards, 0.0) + 0.5 * lobe) / flat)
    return np.stack(channels, axis=-1)


def ball_slopes(ball):
    row, column = np.mgrid[:SIZE, :SIZE].astype(float)
    across, down = column - ball.column, row - ball.row
    height = np.sqrt(np.maximum(ball.radius_px**2 - across**2 - down**2, 1.0))
    inside = across**2 + down**2 < ball.contact_radius_px**2
    return np.where(inside, -across / height, 0.0), np.where(inside, -down / height, 0.0), inside


def rendered(ball, skin=reflectance, noise=NOISE, seed=0):
    p, q, _ = ball_slopes(ball)
    values = skin(p, q) + noise * np.random.default_rng(seed).standard_normal((SIZE, SIZE, 3))
    nowhere = np.zeros((SIZE, SIZE), bool)
    return NormalizedImage(values.astype(np.float32), ~nowhere, nowhere)


TRAINING = Ball(104.3, 110.6, 80.0, 110.0)
HELD_OUT = Ball(117.8, 101.2, 62.0, 90.0)


@pytest.fixture(scope="module")
def model():
    return fit_paper_model(gather_samples([(rendered(TRAINING), [TRAINING])]))


def error_deg(gradients, ball):
    p, q, inside = ball_slopes(ball)
    ok = inside & gradients.valid
    slope = np.stack([gradients.p[ok], gradients.q[ok]], axis=-1).astype(float)
    return angle_between_deg(slope, np.stack([p[ok], q[ok]], axis=-1)), ok.sum() / inside.sum()


def test_a_held_out_ball_is_measured(model):
    image = rendered(HELD_OUT, seed=1)
    error, kept = error_deg(estimate_gradients(model, image), HELD_OUT)
    assert error.mean() < 1.5
    assert kept > 0.999


def test_untouched_skin_is_flat(model):
    gradients = estimate_gradients(model, rendered(HELD_OUT, seed=2))
    outside = ~ball_slopes(HELD_OUT)[2]
    assert abs(gradients.p[outside].mean()) < 0.01
    assert abs(gradients.q[outside].mean()) < 0.01
    assert np.median(gradients.weight[outside]) > 0.5


def test_the_table_returns_a_samples_slope_within_quantisation(model):
    p, q = np.array([0.3, -0.5, 0.1, -0.2]), np.array([0.2, 0.3, -0.6, -0.1])
    for slope, intensity in zip(np.stack([p, q], axis=-1), reflectance(p, q), strict=True):
        candidates = model.table.candidates_of(intensity.astype(np.float32))
        jacobian = candidates[0, 5:11].reshape(3, 2)
        bin_in_slope = np.linalg.norm(model.table.step) / np.linalg.svd(jacobian)[1][-1]
        assert np.linalg.norm(candidates[:, :2] - slope, axis=1).min() < 1.5 * bin_in_slope


def test_refinement_is_finer_than_the_bins(model):
    p, q, inside = ball_slopes(HELD_OUT)
    image = rendered(HELD_OUT, noise=0.0)
    refined, _ = error_deg(estimate_gradients(model, image), HELD_OUT)
    indices = model.table.bin_indices(image.values[inside])
    coarse = model.table.candidates[model.table.first[model.table.bin_of[tuple(indices.T)]], :2]
    truth = np.stack([p[inside], q[inside]], axis=-1)
    assert refined.mean() < 0.6 * angle_between_deg(coarse.astype(float), truth).mean()


def test_clipped_pixels_keep_a_slope_and_little_weight_and_dark_ones_none(model):
    image = rendered(HELD_OUT)
    valid, clipped = image.valid.copy(), image.clipped.copy()
    valid[:50], clipped[60:80] = False, True
    gradients = estimate_gradients(model, NormalizedImage(image.values, valid, clipped))
    assert not gradients.valid[:50].any()
    assert not gradients.weight[:50].any()
    assert gradients.valid[60:80].all()
    assert gradients.weight[60:80].max() <= 0.03


def test_what_is_no_number_is_not_valid(model):
    image = rendered(HELD_OUT)
    image.values[10, 10] = np.nan
    image.values[20, 20, 1] = np.inf
    gradients = estimate_gradients(model, image)
    assert not gradients.valid[10, 10]
    assert not gradients.valid[20, 20]
    assert gradients.valid[11, 11]
    assert np.isfinite(gradients.p).all()
    assert np.isfinite(gradients.weight).all()


def test_colours_far_from_every_balls_lose_weight_then_validity(model):
    image = rendered(HELD_OUT, noise=0.0)
    image.values[5, :] += np.float32([0.3, 0.3, 0.3])
    image.values[15, :] += np.float32(50.0)
    gradients = estimate_gradients(model, image)
    assert gradients.weight[5, 100] < 0.8 * gradients.weight[1, 100]
    assert not gradients.valid[15].any()


def test_too_few_slopes_are_refused():
    nothing = BallSamples(*(np.zeros(shape, np.float32) for shape in ((0, 3), 0, 0, 0, 0)), np.zeros(0, np.intp))
    with pytest.raises(CalibrationError, match="no usable pixel"):
        fit_paper_model(nothing)
    small = Ball(100.0, 100.0, 3.0, 110.0)
    with pytest.raises(CalibrationError, match="different slopes"):
        fit_paper_model(gather_samples([(rendered(small), [small])]))


def test_reflectance_is_drawn_beside_both_fits_and_what_they_leave(model, tmp_path):
    figure = reflectance_figure(model)
    panels = [
        axes for axes in figure.axes if axes.get_subplotspec() and axes.get_subplotspec().get_gridspec().ncols == 5
    ]
    assert len(panels) == 15
    assert [axes.get_title().split("\n")[0] for axes in panels[:5]] == [
        "observed", "order 2", "order 5", "residual of order 2", "residual of order 5",
    ]  # fmt: skip
    residuals = [float(axes.get_title().split("rms ")[1]) for axes in panels if "rms" in axes.get_title()]
    assert residuals == pytest.approx(
        [r for pair in zip(model.residual_order_2, model.residual_order_5, strict=True) for r in pair], abs=1e-4
    )
    figure.savefig(tmp_path / "maps.png", dpi=40)


def test_ambiguity_is_drawn_in_colour_and_slope_and_counted(model, tmp_path):
    figure = ambiguity_figure(model)
    assert [axes.get_xlabel()[0] for axes in figure.axes] == ["a", "p", "s"]
    shares = [bar.get_height() for bar in figure.axes[2].patches]
    assert sum(shares) == pytest.approx(1.0)
    assert 1.0 - shares[0] == pytest.approx(model.table.ambiguous_fraction)
    figure.savefig(tmp_path / "ambiguity.png", dpi=40)


def folded(p, q):
    """Three slopes, 120 degrees apart, produce the same colour: intensity follows the cube of p + iq."""
    cube = (p + 1j * q) ** 3
    return np.stack([1.0 + cube.real, 1.0 + cube.imag, np.ones_like(p)], axis=-1)


def test_the_gate_picks_the_right_slope_where_three_make_one_colour():
    model = fit_paper_model(gather_samples([(rendered(TRAINING, folded, 0.002), [TRAINING])]))
    gradients = estimate_gradients(model, rendered(HELD_OUT, folded, 0.0))
    p, q, inside = ball_slopes(HELD_OUT)
    steep = np.hypot(p, q)
    judged = inside & (steep > 0.5) & (steep < 0.85)
    judged &= np.hypot(*np.mgrid[-HELD_OUT.row : SIZE - HELD_OUT.row, -HELD_OUT.column : SIZE - HELD_OUT.column]) < 60.0
    intensity = folded(p, q)[judged].astype(np.float32)
    counts = [len(model.table.candidates_of(colour)) for colour in intensity[::97]]
    assert np.median(counts) == 3
    assert model.table.ambiguous_fraction > 0.5
    wrong = np.hypot(gradients.p - p, gradients.q - q)[judged] > 0.2
    assert wrong.mean() < 0.02
    chosen = most_ambiguous(model)
    members = slopes_of_bin(reflectance_surface(model.maps, model.harmonics), model.table, chosen)
    centres = model.table.candidates[model.table.first[chosen] : model.table.first[chosen + 1], :2]
    assert np.hypot(*(members[:, None] - centres).transpose(2, 0, 1)).min(axis=1).max() < 0.3
    assert len(ambiguity_figure(model).axes[1].get_legend().get_texts()) == 3
