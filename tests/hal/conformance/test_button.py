"""Promises of `hal.interfaces.Button` and `Operator`, for every driver."""

from hal.hardware import Hardware
from hal.interfaces import LiftOff


def test_no_press_is_none_after_the_timeout(driver: Hardware) -> None:
    with driver:
        asked_ns = driver.clock.monotonic_ns()
        assert driver.button.wait_for_press(1.5) is None
        assert driver.clock.monotonic_ns() - asked_ns >= 1_500_000_000


def test_a_request_is_answered_by_one_press(driver: Hardware) -> None:
    with driver:
        asked_ns = driver.clock.monotonic_ns()
        driver.operator.ask(LiftOff())
        press = driver.button.wait_for_press(None)
        assert press is not None
        assert asked_ns < press.began_ns < driver.clock.monotonic_ns()
        assert 0.0 < press.held_s < 1.0
        assert driver.button.wait_for_press(1.0) is None


def test_a_push_is_reported_while_the_button_is_down_and_within_a_tenth_of_a_second(driver: Hardware) -> None:
    with driver:
        driver.operator.ask(LiftOff())
        began_ns = driver.button.wait_for_push(None)
        assert began_ns is not None
        assert 0 <= driver.clock.monotonic_ns() - began_ns <= 100_000_000
        assert driver.button.is_down()
        press = driver.button.wait_for_press(10.0)
        assert press is not None
        assert press.began_ns == began_ns
        assert driver.button.wait_for_push(1.0) is None


def test_a_push_that_was_reported_is_no_push_while_busy(driver: Hardware) -> None:
    with driver:
        driver.operator.ask(LiftOff())
        assert driver.button.wait_for_push(0.01) is None
        assert driver.button.wait_for_push(10.0) is not None
        assert driver.button.clear_presses() == 0
        assert driver.button.wait_for_press(1.0) is None
        driver.operator.ask(LiftOff())
        assert driver.button.wait_for_push(10.0) is not None


def test_a_short_wait_does_not_swallow_the_press(driver: Hardware) -> None:
    with driver:
        driver.operator.ask(LiftOff())
        assert driver.button.wait_for_press(0.01) is None
        assert driver.button.wait_for_press(10.0) is not None


def test_presses_while_busy_are_forgotten_and_counted(driver: Hardware) -> None:
    with driver:
        assert driver.button.clear_presses() == 0
        driver.operator.ask(LiftOff())
        driver.clock.sleep(5.0)
        assert driver.button.clear_presses() == 1
        assert driver.button.wait_for_press(1.0) is None


def test_a_button_is_down_only_while_it_is_pushed(driver: Hardware) -> None:
    with driver:
        assert not driver.button.is_down()
        driver.operator.ask(LiftOff())
        assert driver.button.wait_for_press(None) is not None
        driver.clock.sleep(0.1)
        assert not driver.button.is_down()
