"""The light drivers on register models: every fault, and the resulting currents."""

import msgspec
import pytest
from emulated_board import LED_CHANNELS, LIGHTS_AT, SPARE_CHANNEL, EmulatedBoard, emulated_hardware
from fake_i2c import FakeI2cBus

from hal.drivers.chip_lights import ChipLights
from hal.drivers.i2c_bus import I2cChip
from hal.drivers.lights_pca9955b import Pca9955b
from hal.errors import LightError
from hal.interfaces import LightFault
from hal.simulator.bench import SimulatedScene
from hal.simulator.led_chips import Pca9955bModel

CURRENTS_MA = {"red": 6.4, "green": 4.9, "blue": 4.9}


@pytest.fixture(params=["PCA9955B", "TLC59116"])
def emulated(bench: SimulatedScene, request: pytest.FixtureRequest) -> EmulatedBoard:
    return emulated_hardware(bench, request.param)


def test_each_led_carries_what_was_granted_and_no_other_channel_any(emulated: EmulatedBoard) -> None:
    lights = emulated.hardware.lights
    granted = lights.granted_ma(CURRENTS_MA)
    with lights:
        lights.switch_on(CURRENTS_MA)
        flowing = emulated.leds.currents_ma()
    expected = dict(zip(CURRENTS_MA, LED_CHANNELS, strict=True))
    lit = {channel for channels in expected.values() for channel in channels}
    for name, channels in expected.items():
        assert granted[name] == pytest.approx(CURRENTS_MA[name], abs=0.12)
        assert [flowing[channel] for channel in channels] == pytest.approx([granted[name]] * len(channels))
    assert not any(current for channel, current in enumerate(flowing) if channel not in lit)
    assert not any(emulated.leds.currents_ma())


def test_what_is_granted_is_granted_again_unchanged(emulated: EmulatedBoard) -> None:
    granted = emulated.hardware.lights.granted_ma(CURRENTS_MA)
    assert emulated.hardware.lights.granted_ma(granted) == granted
    tiny = emulated.hardware.lights.granted_ma({"red": 1e-6, "green": 0.0})
    assert tiny["red"] > 0.0
    assert tiny["green"] == 0.0


def test_pca9955b_is_fully_on_so_that_no_row_sees_a_pulse(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.registers[0x02:0x06] == [0b0101, 0b0101, 0b0100, 0]


def test_tlc59116_never_uses_its_slow_group_dimming(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "TLC59116")
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.registers[0x14:0x18] == [0b1010, 0b1010, 0b1000, 0]


def test_a_chip_that_lost_its_supply_for_a_moment_is_noticed(emulated: EmulatedBoard) -> None:
    class Forgetful(type(emulated.leds)):  # type: ignore[misc]
        def write(self, control: int, data: object) -> None:
            super().write(control, data)
            if control & 0x7F in {0x02, 0x14}:
                self.power_cycle()

    emulated.leds.__class__ = Forgetful
    with pytest.raises(LightError, match=r"did not keep its .*supply for dips"), emulated.hardware.lights:
        emulated.hardware.lights.switch_on(CURRENTS_MA)


def test_absent_chip_stuck_bus_and_lost_bus_are_named_and_heal(emulated: EmulatedBoard) -> None:
    faults, lights = emulated.wire.faults, emulated.hardware.lights
    with lights:
        faults.unplugged.add(LIGHTS_AT)
        with pytest.raises(LightError, match=r"no chip answers at 0x15 on bus 1: .*pins 3 and 5"):
            lights.switch_on(CURRENTS_MA)
        faults.unplugged.clear()
        faults.stuck = True
        with pytest.raises(LightError, match=r"bus 1 is stuck: .*pull-up"):
            lights.switch_on(CURRENTS_MA)
        faults.stuck, faults.gone = False, True
        with pytest.raises(LightError, match=r"I2C bus 1 .* cannot be opened"):
            lights.switch_on(CURRENTS_MA)
        faults.gone = False
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.currents_ma()[0] > 6.0
    assert emulated.wire.opened == 0


def test_two_refused_transfers_are_not_even_noticed(emulated: EmulatedBoard) -> None:
    with emulated.hardware.lights as lights:
        for _ in range(5):
            emulated.wire.faults.refused = 2
            lights.switch_on(CURRENTS_MA)
        assert emulated.leds.currents_ma()[0] > 6.0


def test_open_leds_are_flagged_by_light_and_the_flag_goes_with_the_fault(emulated: EmulatedBoard) -> None:
    emulated.leds.open_channels.add(5)
    with emulated.hardware.lights as lights:
        assert lights.faults() == ()
        lights.switch_on(CURRENTS_MA)
        assert lights.faults() == (LightFault("green", "open"),)
        emulated.leds.open_channels.clear()
        lights.switch_on(CURRENTS_MA)
        assert lights.faults() == ()


def test_a_shorted_led_is_dark(emulated: EmulatedBoard) -> None:
    emulated.leds.shorted_channels.update({4, 5})
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.driven_ma()[4] > 4.0
        assert emulated.leds.currents_ma()[4] == 0.0
        assert set(emulated.bench.currents_ma) == {"red", "blue"}


def test_tlc59116_shows_faults_only_of_outputs_without_pwm_and_a_0_is_a_fault(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "TLC59116")
    emulated.leds.open_channels.add(5)
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        duties = emulated.leds.read(0x94, 4)
        assert emulated.leds.read(0x9D, 2) == [0, 0]
        emulated.leds.write(0x94, [0b0101, 0b0101, 0b0100, 0])
        assert emulated.leds.read(0x9D, 2) == [0b0001_0011, 0b0000_0010]
        emulated.leds.write(0x94, duties)
        assert lights.faults() == (LightFault("green", "open"),)
        assert emulated.leds.read(0x94, 4) == duties
        emulated.leds.hot = True
        assert [fault.light for fault in lights.faults()] == ["red", "green", "blue"]
        lights.off()
        assert lights.faults() == ()
        assert not any(emulated.leds.driven_ma())


def test_short_and_overtemperature_of_the_pca9955b(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.leds.shorted_channels.add(9)
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert lights.faults() == (LightFault("blue", "short"),)
        emulated.leds.hot = True
        assert lights.faults() == tuple(LightFault(name, "hot") for name in lights.names)
        assert not any(emulated.leds.currents_ma())


def test_the_indicator_on_a_spare_channel_lives_beside_the_lights_and_dies_with_them(emulated: EmulatedBoard) -> None:
    hardware = emulated.hardware
    with hardware.lights, hardware.indicator:
        hardware.indicator.show("busy")
        hardware.lights.switch_on(CURRENTS_MA)
        assert emulated.leds.currents_ma()[SPARE_CHANNEL] > 1.0
        hardware.lights.off()
        assert emulated.leds.currents_ma()[SPARE_CHANNEL] > 1.0
        hardware.indicator.show("good")
        assert not any(emulated.leds.currents_ma())
        hardware.indicator.show("busy")
    assert not any(emulated.leds.currents_ma())


def test_half_the_resistance_is_twice_the_current() -> None:
    assert Pca9955b(None, 500.0).max_ma == pytest.approx(2.0 * 57.375)  # type: ignore[arg-type]


def test_no_request_exceeds_the_limit_of_a_light(bench: SimulatedScene) -> None:
    """For every caller: the chip alone could drive 57 mA with 1 kΩ at REXT."""
    lights = tuple(
        msgspec.structs.replace(light, channels=channels, max_ma=5.0)
        for light, channels in zip(bench.profile.lights, LED_CHANNELS, strict=True)
    )
    model = Pca9955bModel()
    bus = FakeI2cBus({LIGHTS_AT: model}, bench.clock)
    chip = I2cChip(bus.open, 1, LIGHTS_AT, "light driver", LightError, bench.clock)
    driver = ChipLights(lights, Pca9955b(chip, 1000.0))
    assert driver.max_ma == 5.0
    with driver:
        with pytest.raises(LightError, match=r"light 'red' cannot be driven with 5\.1 mA: choose 0 to 5 mA"):
            driver.switch_on({"red": 5.1})
        driver.switch_on({"red": 5.0})
        assert 4.7 < max(model.currents_ma()) <= 5.0


def test_error_flags_are_read_one_by_one_as_increments_end_before_them(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.leds.open_channels = {LED_CHANNELS[1][0]}
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.read(0x46 | 0x80, 4) == [emulated.leds.read(0x46, 1)[0]] * 4
        assert lights.faults() == (LightFault("green", "open"),)
    assert emulated.leds.read(0x42 | 0x80, 3)[2] == emulated.leds.read(0x00, 1)[0]


def test_outputs_are_let_through_only_while_something_shines(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    assert not emulated.leds.enabled
    with emulated.hardware.lights as lights:
        assert not emulated.leds.enabled
        lights.switch_on(CURRENTS_MA)
        assert emulated.leds.enabled
        lights.off()
        assert not emulated.leds.enabled
        emulated.hardware.indicator.show("busy")
        assert emulated.leds.enabled
        emulated.hardware.indicator.show("idle")
        assert not emulated.leds.enabled


def test_a_pull_makes_dark_whatever_the_registers_say(emulated: EmulatedBoard) -> None:
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        assert emulated.bench.currents_ma
        # The program is gone without a word: its line is left to the pull, the chip holds its registers.
        emulated.gate.release()
        assert not emulated.bench.currents_ma
        assert not any(emulated.leds.currents_ma())


def test_a_line_that_cannot_be_driven_is_an_error_and_the_registers_make_dark(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    with emulated.hardware.lights as lights:
        lights.switch_on(CURRENTS_MA)
        emulated.gate.broken = True
        with pytest.raises(LightError, match=r"check light_driver\.enable_line"):
            lights.off()
        assert emulated.leds.enabled
        assert not any(emulated.leds.currents_ma())
        emulated.gate.broken = False


def test_a_line_that_is_not_there_refuses_the_lights_and_the_registers_make_dark(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.leds.registers[0x02:0x06] = [0x55] * 4
    emulated.gate.broken = True
    with pytest.raises(LightError, match=r"check light_driver\.enable_line"), emulated.hardware.lights:
        pass
    assert emulated.leds.registers[0x02:0x06] == [0] * 4
    assert emulated.wire.opened == 0


def test_without_a_line_the_outputs_follow_the_registers(bench: SimulatedScene) -> None:
    leds = Pca9955bModel(2400.0)
    wire = FakeI2cBus({LIGHTS_AT: leds}, bench.clock)
    chip = I2cChip(wire.open, 1, LIGHTS_AT, "light driver", LightError, bench.clock)
    lights = [msgspec.structs.replace(one, channels=(n,)) for n, one in enumerate(bench.profile.lights)]
    with ChipLights(lights, Pca9955b(chip, 2400.0)) as driver:
        driver.switch_on(CURRENTS_MA)
        assert any(leds.currents_ma())
