"""The Enter key as the button."""

import pytest

from hal.clock import VirtualClock
from hal.drivers.usb_hardware import KEY_HELD_S, KeyboardButton
from hal.errors import ButtonError
from hal.interfaces import ButtonPress


class Keys:
    """Enter keys at given times (s)."""

    def __init__(self, clock: VirtualClock, *at_s: float, closed: bool = False) -> None:
        self.clock = clock
        self.at_ns = [round(at * 1e9) for at in at_s]
        self.closed = closed

    def wait(self, timeout_s: float) -> int:
        if self.closed:
            raise OSError("the terminal was closed")
        now_ns = self.clock.monotonic_ns()
        next_ns = min([now_ns + round(timeout_s * 1e9), *self.at_ns])
        self.clock.sleep((next_ns - now_ns) * 1e-9)
        typed = [at for at in self.at_ns if at <= self.clock.monotonic_ns()]
        self.at_ns = self.at_ns[len(typed) :]
        return len(typed)


def button(*at_s: float) -> KeyboardButton:
    clock = VirtualClock()
    return KeyboardButton(Keys(clock, *at_s), clock)


def test_each_key_is_one_push_and_the_same_press() -> None:
    with button(1.0, 3.0) as keys:
        assert keys.wait_for_push(0.5) is None
        assert keys.wait_for_push(None) == 1_000_000_000
        assert not keys.is_down()
        assert keys.wait_for_press(1.0) == ButtonPress(1_000_000_000, KEY_HELD_S)
        assert keys.wait_for_press(0.5) is None
        assert keys.wait_for_press(None) == ButtonPress(3_000_000_000, KEY_HELD_S)


def test_keys_while_busy_are_dropped_and_counted() -> None:
    keys = button(1.0, 1.0, 2.0)
    assert keys.wait_for_push(None) == 1_000_000_000
    assert keys.clear_presses() == 1
    assert keys.wait_for_press(5.0) == ButtonPress(2_000_000_000, KEY_HELD_S)
    assert keys.wait_for_press(5.0) is None


def test_a_closed_terminal_is_said() -> None:
    clock = VirtualClock()
    keys = KeyboardButton(Keys(clock, closed=True), clock)
    with pytest.raises(ButtonError, match="the Enter key cannot be read"):
        keys.wait_for_push(1.0)
