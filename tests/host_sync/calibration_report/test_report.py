"""The calibration report: coverage, ± of the scale, rejected labels, and figures that show all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from device.balls.detector import BallSearch, RejectedBall
from device.balls.sphere import Ball, BallSamples, gather_samples
from device.calibration.acceptance import measure_coverage
from device.imaging.flat_field import LinearFrame, NormalizedImage
from host_sync.calibration.assessment import checks, moved_note
from host_sync.calibration.balls import (
    MAX_WIDENING,
    GridSpacing,
    PressFrame,
    UsedPress,
    add_detections,
    relocate_labels,
)
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.calibration.preparation import MAX_SHOWN, training_presses
from host_sync.calibration.scale import scale_uncertainty, with_stated_pitch
from host_sync.calibration_report.overview import balls_figure

SHAPE = (90, 120)
RADIUS_PX = 12.0


def flat() -> NormalizedImage:
    nowhere = np.zeros(SHAPE, np.bool_)
    return NormalizedImage(np.ones((*SHAPE, 3), np.float32), ~nowhere, nowhere)


def ball(column: float, row: float) -> Ball:
    return Ball(column, row, 0.6 * RADIUS_PX, RADIUS_PX)


def press(number: int, *balls: Ball, rejected: tuple[RejectedBall, ...] = ()) -> UsedPress:
    return UsedPress(f"press-{number:02d}", flat(), balls, rejected)


def samples(*balls: Ball) -> BallSamples:
    return gather_samples([(flat(), balls)])


def everywhere() -> list[Ball]:
    return [ball(column, row) for row in (15.0, 45.0, 75.0) for column in (20.0, 60.0, 100.0)]


def test_balls_everywhere_leave_nothing_to_press() -> None:
    coverage = measure_coverage(samples(*everywhere()), SHAPE, steepest=0.75)
    assert all(coverage.sectors.values())
    assert all(coverage.directions.values())
    assert coverage.steepest_deg == pytest.approx(36.87, abs=0.01)
    assert coverage.next_presses() == ()


def test_an_empty_corner_and_a_shallow_press_are_what_to_press_next() -> None:
    coverage = measure_coverage(samples(*everywhere()[1:]), SHAPE, steepest=0.3)
    assert [name for name, covered in coverage.sectors.items() if not covered] == ["upper left corner"]
    assert coverage.next_presses() == (
        "upper left corner uncovered: press a ball there",
        "slopes beyond 17 degrees uncovered: press deeper, to 25 degrees at least",
    )


def test_a_sector_whose_balls_the_model_gets_wrong_is_not_covered() -> None:
    cut = RejectedBall(20.0, 15.0, "cut by the frame's border")
    wrong = RejectedBall(100.0, 75.0, "does not follow the sphere (held-out error 7.0 degrees)", 7.0)
    coverage = measure_coverage(samples(*everywhere()), SHAPE, 0.75, [cut, wrong])
    assert coverage.uncovered == ("lower right corner",)
    twice = [*everywhere(), ball(100.0, 75.0)]
    assert measure_coverage(samples(*twice), SHAPE, 0.75, [cut, wrong]).uncovered == ()


def test_a_slope_direction_that_no_ball_shows_is_named() -> None:
    training = samples(*everywhere())
    seen = training.p > -0.05  # nothing falls to the right
    training = BallSamples(
        *(getattr(training, name)[seen] for name in ("intensity", "p", "q", "column", "row", "ball")),
    )
    (sentence,) = measure_coverage(training, SHAPE, steepest=0.75).next_presses()
    assert sentence.startswith("slopes that fall to the right, lower right, upper right uncovered")


def frame_of(radius_tolerance: float | None = None) -> PressFrame:
    dark = LinearFrame(np.zeros((*SHAPE, 3), np.float32), np.zeros(SHAPE, np.bool_))
    return PressFrame("press-00", dark, RADIUS_PX, grid=GridSpacing(1.0), radius_tolerance=radius_tolerance)


@pytest.mark.parametrize(("away_px", "is_noted"), [(1.0, False), (4.0, True)])
def test_a_ball_that_is_used_far_from_its_stated_place_is_named(away_px: float, is_noted: bool) -> None:
    stated = replace(frame_of(), balls=(ball(40.0, 40.0), ball(80.0, 60.0)))
    used = press(0, ball(40.0, 40.0), ball(80.0, 60.0 + away_px))
    notes = moved_note([stated], [used])
    assert [note.startswith("press-00: a ball is used more than 0.3") for note in notes] == [True] * is_noted
    assert moved_note([frame_of()], [used]) == []  # found, not stated


def test_a_scale_that_nothing_measures_has_no_uncertainty_rather_than_none() -> None:
    scale = scale_uncertainty(None, [frame_of()], np.array([1.0, 1.02, 0.99]), np.full(3, RADIUS_PX))
    assert (scale.pixel_pitch_sigma_um, scale.ball_radius_share, scale.height_share) == (None, None, None)
    assert scale.not_measured == ("pixel pitch", "ball radius")
    stated = with_stated_pitch(scale, 20.0, 0.05)
    assert stated.pixel_pitch_sigma_um == pytest.approx(1.0 / np.sqrt(3.0))
    assert (stated.height_share, stated.not_measured) == (None, ("ball radius",))


def test_heights_feel_the_pitch_twice_and_the_radius_once() -> None:
    pitch = PixelPitch(stated_um=10.0, pitch_um=10.0, sigma_um=0.03, readings=())
    scale = scale_uncertainty(pitch, [frame_of(0.01)], np.ones(3), np.full(3, RADIUS_PX))
    assert scale.pixel_pitch_share == pytest.approx(0.003)
    assert scale.ball_radius_share == pytest.approx(0.01 / np.sqrt(3.0))
    assert scale.height_share == pytest.approx(np.hypot(0.006, 0.01 / np.sqrt(3.0)))
    assert scale.not_measured == ()
    assert with_stated_pitch(scale, 20.0, 0.05) is scale


def test_balls_of_two_sizes_show_how_far_their_radii_agree() -> None:
    shares, radii = np.array([1.01, 1.03, 1.02, 0.98, 0.98]), np.array([12.0, 12.0, 12.0, 20.0, 20.0])
    scale = scale_uncertainty(None, [frame_of()], shares, radii)
    assert scale.ball_radius_share == pytest.approx(0.04 / np.sqrt(2.0))
    assert scale.height_share is None


def test_a_label_at_which_nothing_is_seen_teaches_as_it_was_set() -> None:
    right = press(0, ball(20.0, 15.0), ball(100.0, 75.0))
    labelled = replace(right, seen=BallSearch((ball(21.0, 15.5),), ()))
    assert [(b.column, b.row) for b in relocate_labels(labelled).balls] == [(21.0, 15.5), (100.0, 75.0)]
    blind = replace(right, seen=BallSearch((), ()))
    assert add_detections(blind).balls == right.balls


def test_labelled_balls_move_to_what_is_seen_and_others_follow_them() -> None:
    seen = BallSearch((ball(60.0, 45.0), ball(21.0, 15.5)), ())
    labelled = replace(press(0, ball(20.0, 15.0)), seen=seen)
    assert [(b.column, b.row) for b in relocate_labels(labelled).balls] == [(21.0, 15.5)]
    assert [(b.column, b.row) for b in add_detections(labelled).balls] == [(21.0, 15.5), (60.0, 45.0)]


@pytest.mark.parametrize(("drawn", "factor"), [(0.9, 1.0), (1.03, 1.03), (1.3, MAX_WIDENING)])
def test_labels_that_draw_wider_contacts_widen_found_ones_a_little(drawn: float, factor: float) -> None:
    found, beyond = ball(21.0, 15.5), ball(60.0, 45.0)
    label = replace(ball(20.0, 15.0), contact_radius_px=drawn * found.contact_radius_px)
    labelled = replace(press(0, label), seen=BallSearch((beyond, found), ()))
    at_label, other = add_detections(labelled).balls
    assert at_label.contact_radius_px == pytest.approx(min(drawn, factor) * found.contact_radius_px)
    assert other.contact_radius_px == pytest.approx(factor * beyond.contact_radius_px)


def test_the_picture_of_balls_says_what_it_leaves_out_and_shows_every_rejection() -> None:
    spoilt = (RejectedBall(10.0, 10.0, "cut by the frame's border"),)
    presses = [press(i, ball(60.0, 45.0), rejected=spoilt if i in {1, 18} else ()) for i in range(MAX_SHOWN + 4)]
    figure = balls_figure(training_presses(presses))
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == MAX_SHOWN
    assert {"press-01", "press-18"} <= set(titles)
    assert f"{MAX_SHOWN} of {MAX_SHOWN + 4} presses shown" in figure.get_suptitle()
    assert "presses shown" not in balls_figure(training_presses(presses[:9])).get_suptitle()


def test_what_is_rejected_beside_the_ball_of_a_press_is_no_rejected_ball() -> None:
    beside = (RejectedBall(90.0, 20.0, "cut by the frame's border"),)
    rejected = {}
    for name, used in (
        ("one", press(0, ball(60.0, 45.0), rejected=beside)),
        ("none", press(0, rejected=beside)),
        ("two", press(0, ball(20.0, 45.0), ball(60.0, 45.0), rejected=beside)),
    ):
        coverage = measure_coverage(samples(*everywhere()), SHAPE, steepest=0.75)
        (rejected[name],) = [c.value for c in checks([used], 1.0, 0.01, coverage) if c.name.startswith("share of ba")]
    assert rejected == {"one": 0.0, "none": 1.0, "two": pytest.approx(1.0 / 3.0)}
