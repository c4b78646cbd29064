"""Names of the reconstruction's methods, for commands: where they are implemented, numerics are loaded."""

from __future__ import annotations

from typing import Literal

MethodName = Literal["direct", "paper"]
