import numpy as np
import pytest

from hal.errors import OperatorError
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import gallery_names, specimen
from hal.simulator.surfaces import Block, FloatArray, Groove, Plane, Sinusoid, Sphere, SphereGrid, Step, smooth_step


def grid() -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[-6.5:6.5:261j, -8.0:8.0:321j]
    return x, y


def test_the_gallery_has_what_the_twin_promises() -> None:
    wanted = {"sphere", "sphere-grid", "plane", "sinusoid", "groove", "step", "coin", "pebbles", "texture"}
    assert set(gallery_names()) == wanted


@pytest.mark.parametrize("name", gallery_names())
def test_every_exhibit_stands_at_zero_and_ends_inside_the_field(name: str) -> None:
    x, y = grid()
    height = specimen(name).surface.height_mm(x, y)
    assert height.shape == x.shape
    assert -0.03 < np.nanmax(height) <= 1e-12
    border = np.concatenate([height[0], height[-1], height[:, 0], height[:, -1]])
    assert np.isnan(border).all() or name == "pebbles"  # which is larger than a field, to be covered by scans


@pytest.mark.parametrize("name", gallery_names())
def test_every_exhibit_can_be_asked_for_and_touches_the_skin(
    name: str, hardware: Hardware, bench: SimulatedScene
) -> None:
    hardware.operator.ask(PressObject(name))
    truth = bench.truth()
    assert truth.contact.mean() > 0.01
    assert 200.0 < truth.z_um.max() <= specimen(name).indentation_mm * 1e3 + 0.01


def test_an_unknown_object_lists_the_gallery(hardware: Hardware) -> None:
    with pytest.raises(OperatorError, match=r"'unicorn'.*sphere-grid.*coin"):
        hardware.operator.ask(PressObject("unicorn"))


def test_sphere_and_lattice_are_round() -> None:
    x = np.array([0.0, 1.0, 2.0, 3.0])
    expected = [0.0, np.sqrt(3.0) - 2.0, -2.0, np.nan]
    np.testing.assert_allclose(Sphere(2.0).height_mm(x, np.zeros(4)), expected)
    lattice = SphereGrid(0.5, 2.0, 1)
    np.testing.assert_allclose(lattice.height_mm(x, np.zeros(4)), [0.0, np.nan, 0.0, np.nan])


def test_plane_has_its_slopes() -> None:
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21))
    q, p = np.gradient(Plane(Block(3.0, 2.0), 0.05, -0.03).height_mm(x, y), 0.1)
    np.testing.assert_allclose(p, 0.05)
    np.testing.assert_allclose(q, -0.03)


def test_profiles_across_sinusoid_groove_and_step() -> None:
    body, rest = Block(4.0, 3.0), np.zeros(3)
    wave = Sinusoid(body, 2.0, 0.1).height_mm(np.array([0.0, 0.5, 1.0]), rest)
    np.testing.assert_allclose(wave, [0.0, -0.1, -0.2], atol=1e-12)
    groove = Groove(body, 0.8, 0.2, 0.1).height_mm(np.array([0.0, 0.45, 0.5]), rest)
    np.testing.assert_allclose(groove, [-0.2, -0.1, 0.0], atol=1e-12)
    step = Step(body, 0.1, 0.2).height_mm(np.array([-0.1, 0.0, 0.1]), rest)
    np.testing.assert_allclose(step, [-0.1, -0.05, 0.0], atol=1e-12)


def test_smooth_step_has_no_kinks_at_its_ends() -> None:
    share = np.array([-1.0, 0.0, 1e-4, 0.5, 1.0 - 1e-4, 1.0, 2.0])
    np.testing.assert_allclose(smooth_step(share), [0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0], atol=1e-7)
