from hal.clock import SystemClock, VirtualClock


def test_virtual_time_passes_only_in_sleep() -> None:
    clock = VirtualClock(start_ns=5, wall_start_s=100.0)
    assert clock.monotonic_ns() == clock.monotonic_ns() == 5
    clock.sleep(3600.0)
    assert clock.monotonic_ns() == 5 + 3_600_000_000_000
    assert clock.wall_time_s() == 3700.0


def test_virtual_sleep_never_goes_backwards_and_always_advances() -> None:
    clock = VirtualClock()
    clock.sleep(-1.0)
    assert clock.monotonic_ns() == 0
    clock.sleep(1e-12)
    assert clock.monotonic_ns() == 1


def test_system_clock_is_monotonic_and_takes_a_negative_sleep() -> None:
    clock = SystemClock()
    before = clock.monotonic_ns()
    clock.sleep(-1.0)
    assert clock.monotonic_ns() >= before
    assert clock.wall_time_s() > 0.0
