"""Bouncing, chatter and long presses, in virtual time."""

import pytest
from emulated_board import EmulatedBoard, emulated_hardware
from fake_gpio import BOUNCES_MS

from hal.drivers.button_debounced import QUIET_NS, Debouncer
from hal.drivers.gpio_lines import Edge
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene

MS = 1_000_000


def bounce(debouncer: Debouncer, at_ns: int, down: bool) -> None:
    for number, ms in enumerate(BOUNCES_MS):
        debouncer.edge(at_ns + round(ms * MS), down == (number % 2 == 0))


@pytest.fixture
def emulated(bench: SimulatedScene) -> EmulatedBoard:
    return emulated_hardware(bench, "PCA9955B")


def test_a_bouncing_press_is_one_press_from_its_first_edge() -> None:
    debouncer = Debouncer(down=False)
    bounce(debouncer, 100 * MS, True)
    bounce(debouncer, 400 * MS, False)
    assert debouncer.next_press() is None
    debouncer.settle(500 * MS, False)
    press = debouncer.next_press()
    assert press is not None
    assert press.began_ns == 100 * MS
    assert press.held_s == pytest.approx(0.3)
    assert debouncer.next_press() is None


def test_chatter_that_never_rests_is_no_press() -> None:
    debouncer = Debouncer(down=False)
    for number in range(1000):
        debouncer.edge(number * QUIET_NS // 2, number % 2 == 0)
    debouncer.settle(600 * QUIET_NS, False)
    assert debouncer.next_press() is None


def test_a_glitch_shorter_than_the_quiet_is_no_press() -> None:
    debouncer = Debouncer(down=False)
    debouncer.edge(0, True)
    debouncer.edge(QUIET_NS // 3, False)
    debouncer.settle(5 * QUIET_NS, False)
    assert debouncer.next_press() is None


def test_a_bounce_within_a_long_press_does_not_split_it() -> None:
    debouncer = Debouncer(down=False)
    bounce(debouncer, 0, True)
    debouncer.edge(1_000 * MS, False)
    debouncer.edge(1_002 * MS, True)
    bounce(debouncer, 2_500 * MS, False)
    debouncer.settle(3_000 * MS, False)
    press = debouncer.next_press()
    assert press is not None
    assert press.held_s == pytest.approx(2.5)


def test_a_button_that_is_down_at_the_start_counts_from_its_next_press() -> None:
    debouncer = Debouncer(down=True)
    bounce(debouncer, 50 * MS, False)
    bounce(debouncer, 200 * MS, True)
    bounce(debouncer, 300 * MS, False)
    debouncer.settle(400 * MS, False)
    press = debouncer.next_press()
    assert press is not None
    assert press.began_ns == 200 * MS
    assert debouncer.next_press() is None


def test_a_lost_edge_is_made_up_for_by_the_real_level() -> None:
    debouncer = Debouncer(down=False)
    debouncer.edge(0, True)
    debouncer.settle(20 * MS, True)
    debouncer.edge(100 * MS, True)  # the release's edges were lost, all but one that says nothing new
    debouncer.settle(120 * MS, False)
    assert debouncer.next_press() is None
    debouncer.settle(131 * MS, False)
    assert debouncer.next_press() == ButtonPress(0, 0.1)


def test_a_press_whose_edges_were_all_lost_is_one_once_its_level_has_settled_level() -> None:
    debouncer = Debouncer(down=False)
    debouncer.settle(100 * MS, True)
    assert debouncer.next_push_ns() is None
    debouncer.settle(111 * MS, True)
    assert debouncer.next_push_ns() == 100 * MS
    debouncer.settle(300 * MS, False)
    debouncer.settle(311 * MS, False)
    assert debouncer.next_press() == ButtonPress(100 * MS, 0.2)


def test_a_push_is_reported_while_it_is_held_and_once() -> None:
    debouncer = Debouncer(down=False)
    bounce(debouncer, 100 * MS, True)
    debouncer.settle(120 * MS, True)
    assert debouncer.next_push_ns() == 100 * MS
    assert debouncer.next_push_ns() is None
    assert debouncer.next_press() is None
    bounce(debouncer, 300 * MS, False)
    bounce(debouncer, 500 * MS, True)
    debouncer.settle(520 * MS, True)
    assert debouncer.clear() == 1
    bounce(debouncer, 700 * MS, False)
    debouncer.settle(800 * MS, False)
    assert debouncer.next_push_ns() is None
    assert debouncer.next_press() is None


def test_a_press_that_begins_while_the_level_is_read_does_not_hide_the_one_before(emulated: EmulatedBoard) -> None:
    line = emulated.line
    with emulated.hardware.button as button:
        read = line.is_active
        emulated.bench.schedule_button(ButtonPress(1_000 * MS, 0.1))
        assert button.wait_for_push(5.0) == 1_000 * MS

        def read_late() -> bool:
            if emulated.bench.clock.monotonic_ns() >= 1_115 * MS and line.is_active is not read:
                line.is_active = read  # type: ignore[method-assign]
                emulated.bench.schedule_button(ButtonPress(emulated.bench.clock.monotonic_ns() + 1, 0.2))
                emulated.bench.clock.sleep(0.001)
            return read()

        line.is_active = read_late  # type: ignore[method-assign]
        first, second = button.wait_for_press(5.0), button.wait_for_press(5.0)
    assert first is not None
    assert second is not None
    assert first.held_s == pytest.approx(0.1)
    assert second.held_s == pytest.approx(0.2)


def test_several_presses_that_nobody_waited_for_come_in_order(emulated: EmulatedBoard) -> None:
    with emulated.hardware.button as button:
        for start_s in (1, 2, 3):
            emulated.bench.schedule_button(ButtonPress(start_s * 1_000 * MS, 0.05))
        emulated.bench.clock.sleep(10.0)
        assert button.clear_presses() == 3
        assert button.wait_for_press(1.0) is None


def test_a_press_that_is_held_when_presses_are_forgotten_is_forgotten_too(emulated: EmulatedBoard) -> None:
    with emulated.hardware.button as button:
        emulated.bench.schedule_button(ButtonPress(1_000 * MS, 3.0))
        assert button.wait_for_press(2.0) is None
        assert button.is_down()
        assert button.clear_presses() == 1
        assert button.wait_for_press(5.0) is None


@pytest.mark.parametrize("held_s", [0.06, 0.4, 2.5])
def test_a_press_on_the_line_is_as_long_as_the_finger_was(emulated: EmulatedBoard, held_s: float) -> None:
    with emulated.hardware.button as button:
        emulated.bench.schedule_button(ButtonPress(1_000 * MS, held_s))
        press = button.wait_for_press(10.0)
    assert press is not None
    assert press.began_ns == 1_000 * MS
    assert press.held_s == pytest.approx(held_s)


def test_chatter_on_the_line_ends_in_no_press_and_in_time(emulated: EmulatedBoard) -> None:
    emulated.line.chatter([Edge(number * 3 * MS, number % 2 == 0) for number in range(1, 1001)])
    with emulated.hardware.button as button:
        assert button.wait_for_press(2.0) is None
    assert 2.0 <= emulated.bench.clock.monotonic_ns() * 1e-9 < 2.02
