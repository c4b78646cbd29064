from hal.simulator.bench import Timeline


def test_a_value_holds_until_the_next() -> None:
    line = Timeline(10, "a")
    line.change(20, "b")
    line.change(20, "c")
    line.change(30, "d")
    assert [line.value_at(t) for t in (0, 10, 19, 20, 29, 30, 99)] == ["a", "a", "a", "c", "c", "d", "d"]
    assert line.latest == "d"


def test_spans_cover_the_interval_exactly() -> None:
    line = Timeline(10, "a")
    line.change(20, "b")
    line.change(30, "c")
    assert list(line.spans(5, 35)) == [(15, "a"), (10, "b"), (5, "c")]
    assert list(line.spans(21, 29)) == [(8, "b")]
    assert list(line.spans(40, 50)) == [(10, "c")]


def test_a_long_life_forgets_its_youth_but_not_the_last_minute() -> None:
    line = Timeline(0, 0)
    second = 1_000_000_000
    for n in range(1, 1000):
        line.change(n * second, n)
    assert line.value_at(950 * second) == 950
    assert line.value_at(0) > 900
