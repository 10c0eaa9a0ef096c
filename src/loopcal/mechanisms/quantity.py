"""What varies by pose in the loops of a mechanism, and what part it plays there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Role = Literal["reading", "known", "disturbance"]


@dataclass(frozen=True)
class Quantity:
    """A name, its SI unit and its role.

    role: "reading" of a sensor, "known" constant of a pose, which carries no error, or
    "disturbance" of the machine model, which is read as 0; first: of a row with two poses, the
    quantity of the first pose that this one is in the second.
    """

    name: str
    unit: str
    role: Role = "reading"
    first: str | None = None
