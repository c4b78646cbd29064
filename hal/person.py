"""The operator of a real board: a person, who reads the words on the screen."""

from __future__ import annotations

from hal.interfaces import OperatorRequest


class Person:
    """See `hal.interfaces.Operator`: a person is asked in words by whoever asks, and answers with the button."""

    def ask(self, request: OperatorRequest) -> None:
        """Nothing to carry out: the words were shown."""
