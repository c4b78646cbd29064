"""All of the instrument's hardware: camera, lights, button, indicator, power, operator and clock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Self

from hal.board_profile import BoardProfile
from hal.errors import IndicatorError, LightError
from hal.interfaces import Button, Camera, Clock, Indicator, Lights, Operator, OperatorRequest, Power


@dataclass(frozen=True, slots=True)
class Hardware:
    """All devices of the instrument; entering acquires them, leaving releases them.

    The lights are switched off before anything else on entry and first on exit; the indicator may use their chip. A
    failing indicator does not block the other devices; the self-test reports it.
    """

    profile: BoardProfile
    camera: Camera
    lights: Lights
    button: Button
    indicator: Indicator
    power: Power
    operator: Operator
    clock: Clock
    _held: ExitStack = field(default_factory=ExitStack, init=False, repr=False, compare=False)

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self.button)
            stack.enter_context(self.power)
            stack.enter_context(self.lights)
            stack.enter_context(_if_it_works(self.indicator))
            stack.enter_context(self.camera)
            stack.callback(self.lights.off)
            self._held.push(stack.pop_all())
        return self

    def __exit__(self, *exc: object) -> None:
        self._held.close()


@contextmanager
def _if_it_works(indicator: Indicator) -> Iterator[None]:
    """Enter and leave the indicator; ignore its errors."""
    with ExitStack() as stack:
        with suppress(IndicatorError, LightError):
            stack.enter_context(indicator)
        try:
            yield
        finally:
            with suppress(IndicatorError, LightError):
                stack.close()


class ManualOperator:
    """Operator of a real board (see `hal.interfaces.Operator`): a person who reads the prompt on the screen."""

    def ask(self, request: OperatorRequest) -> None:
        """No-op: the prompt is already on the screen."""
