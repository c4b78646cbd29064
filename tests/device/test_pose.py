"""Poses: composition, inverse and units."""

import numpy as np
import pytest

from device.align import Pose

ONE, OTHER = Pose(3.0, -2.0, 0.3), Pose(-1.0, 5.0, -0.7)
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [-4.0, 7.0]])


def test_a_quarter_turn_clockwise_leads_from_right_to_down() -> None:
    assert Pose(turn=0.5 * np.pi).of((0.0, 1.0)) == pytest.approx((1.0, 0.0))
    assert Pose(turn=0.5 * np.pi).of((1.0, 0.0)) == pytest.approx((0.0, -1.0))


def test_one_pose_after_another_and_back() -> None:
    assert np.allclose(ONE.then(OTHER).of(PLACES), OTHER.of(ONE.of(PLACES)))
    assert np.allclose(ONE.back().of(ONE.of(PLACES)), PLACES)
    assert ONE.then(ONE.back()).distance(Pose(), 100.0) == pytest.approx(0.0, abs=1e-12)


def test_the_same_pose_in_another_unit() -> None:
    assert np.allclose(4.0 * ONE.in_units_of(4.0).of(PLACES / 4.0), ONE.of(PLACES))


def test_distances_of_poses() -> None:
    turned = ONE.moved_by(0.0, 0.0, 0.01)
    assert turned.distance(ONE, 0.0) == 0.0
    assert turned.distance(ONE, 50.0) == pytest.approx(0.5)
    assert turned.distance_at(ONE, (0.0, 50.0)) == pytest.approx(0.5, rel=1e-3)
    assert Pose(turn=np.pi - 0.01).distance(Pose(turn=0.01 - np.pi), 50.0) == pytest.approx(1.0)
    assert ONE.moved_by(3.0, 4.0).distance(ONE, 50.0) == 5.0
