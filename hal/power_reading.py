"""What is known of supply and battery at one moment."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class PowerReading:
    """Supply and battery; None is "not measured", never 0.

    under_voltage : the supply is too low now
    was_under_voltage : it was, at some time since boot
    throttled : the processor is slowed down now
    battery_mv, battery_share : cell voltage (mV) and charge (0 to 1)
    complaints : a sentence for each part that the board has and that did not answer
    """

    under_voltage: bool | None = None
    was_under_voltage: bool | None = None
    throttled: bool | None = None
    battery_mv: float | None = None
    battery_share: float | None = None
    complaints: tuple[str, ...] = ()

    def with_earlier(self, earlier: PowerReading) -> PowerReading:
        """This reading, with the troubles of an earlier one: a supply that sagged then has sagged."""

        def either(one: bool | None, other: bool | None) -> bool | None:
            return one if other is None else other if one is None else one or other

        return replace(
            self,
            under_voltage=either(self.under_voltage, earlier.under_voltage),
            was_under_voltage=either(self.was_under_voltage, earlier.was_under_voltage),
            throttled=either(self.throttled, earlier.throttled),
            complaints=tuple(dict.fromkeys((*earlier.complaints, *self.complaints))),
        )
