"""What single readings can hide: the smallest error that the tests find, and what it does."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.bounds import Count, Probability, Size
from loopcal.presentation.shown import percent, with_unit


@dataclass(frozen=True)
class SensorReliability:
    """The readings of one quantity."""

    quantity: str
    unit: str
    readings: Count
    """How many were tested."""
    uncontrolled: Count
    """How many more the other readings do not control: an error of any size stays hidden."""
    redundancy: Probability | None
    """Median redundancy number: the share of an error that shows in the reading's own correction;
    null: the method takes the readings as exact."""
    detectable: Size | None
    """Median of the smallest detectable error of a reading [unit]; null: none was tested."""
    largest: Size | None
    """The largest of them [unit]."""
    effect: Size | None
    """What the worst undetected error of this size does to the result: rms displacement of the
    predicted outputs over the measured poses; null: not known."""
    pose: str | None
    """The pose of that reading."""


@dataclass(frozen=True)
class Reliability:
    """Internal and external reliability of single readings (Baarda 1968)."""

    alpha: Probability
    """Level of the test of each reading."""
    power: Probability
    """Probability of finding an error of the stated size."""
    noncentrality: Size
    """Such an error in sds of its test statistic."""
    unit: str | None
    """SI unit of the effects; null: the mechanism has no outputs."""
    sensors: tuple[SensorReliability, ...]

    @property
    def worst(self) -> SensorReliability | None:
        """The sensor whose undetected errors move the result most."""
        with_effect = [one for one in self.sensors if one.effect is not None]
        return max(with_effect, key=lambda one: one.effect or 0.0, default=None)

    def lines(self) -> list[str]:
        """For the summary: one line."""
        worst = self.worst
        if worst is None or self.unit is None:
            return []
        moved = with_unit(worst.effect, self.unit, 2)
        return [
            f"reliability: an undetected error of {worst.quantity} moves predictions by up to "
            f"{moved} rms (pose {worst.pose}; test at {100 * self.alpha:g} %, "
            f"power {percent(self.power)})"
        ]
