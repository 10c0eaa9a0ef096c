"""Change points: what moved between two poses, by how much, and the lines that model it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from loopcal.document.findings import DelayEntry, JointErrorEntry, ScaleEntry
from loopcal.document.plain import Count, Probability, Size
from loopcal.mechanisms.effects.effect import LENGTHS, LOAD
from loopcal.presentation.shown import (
    brief,
    enumerated,
    p_words,
    percent,
    significant,
    with_unit,
    wrapped,
)

Moved = Literal["target", "station", "lens", "joint", "reading", "load", "expansion", "link"]
_WORDS = {
    "target": ("the target {names}", "moved", "on the body"),
    "station": ("the place of {of}", "changed", "({names})"),
    "lens": ("the focal length {names}", "changed", ""),
    "joint": ("the zero of the joint {names}", "changed", ""),
    "reading": ("the zero of {names}", "changed", ""),
    "load": ("the load on the tool", "changed", ""),
    "expansion": ("{names}", "changed", "as when it warms up"),
    "link": ("a link of the machine", "changed", "({names})"),
}
"""Of what moved: what it is, the verb of a step, and what follows."""
_FEW = 6
"""Parts that fit a line: those of a place in space."""


@dataclass(frozen=True)
class Change:
    """By how much one parameter or reading changed."""

    size: float
    """[unit]"""
    sd: Size
    unit: str


@dataclass(frozen=True)
class ChangePoint:
    """Something changed between two poses that follow each other, and stayed so."""

    shape: Literal["step", "ramp"]
    """Whether it changed at once, or all along the poses in which it was seen."""
    pose: str
    """The first pose after the change; of a ramp the first in which it was seen."""
    after: str
    """The last pose before it; of a ramp the last in which it was seen."""
    number: Count
    """Of that first pose in the order of the poses, from 1."""
    moved: Moved
    changes: Mapping[str, Change]
    """Parameter or reading -> its change."""
    gain: Size
    """What chi-squared falls by, in units of the scatter of the residuals."""
    p_value: Probability
    """Of a gain at least so large in independent errors, corrected for the search."""
    alternatives: tuple[str, ...] = ()
    """Parameters or readings whose change would explain it about as well."""
    moves: Size | None = None
    """Rms distance [unit] over the poses by which all of it moves the end point; null: unknown."""
    unit: str = ""
    """Of moves."""
    modelled: bool = False
    """Whether the result has it as an effect, as the method "auto" gives it where it is certain."""
    imitated: bool = False
    """Whether it is a ramp in an order that the joints show, as an error of the machine is."""
    until: Count | None = None
    """Of a ramp, the number of the last pose in which it was seen; null: a step."""
    bends: Count = 0
    """Of a ramp, terms of the smooth curve that the readings show beside a straight line."""
    of: str = ""
    """Whose place it is, where images see it: a camera or a board; empty: another target or
    instrument."""

    @property
    def names(self) -> tuple[str, ...]:
        """What changed: parameters or readings."""
        return tuple(self.changes)

    @property
    def changing(self) -> tuple[str, ...]:
        """What an effect that models it states as changing."""
        return {"expansion": (LENGTHS,), "load": (LOAD,)}.get(self.moved, self.names)

    @property
    def effect(self) -> str:
        """The name of the effect that models it."""
        if self.shape == "ramp":
            return f"drift of {', '.join(self.names)}"
        return f"shift of {', '.join(self.changing)}"

    @property
    def what(self) -> str:
        """When it changed, and what."""
        subject, verb, more = _WORDS["station" if self.of else self.moved]
        if self.shape == "ramp":
            verb = "drifted along a curve" if self.bends else "drifted"
        names = ", ".join(self.names)
        subject, more = (
            subject.format(names=names, of=self.of or "the instrument"),
            more.format(names=names),
        )
        text = " ".join(part for part in (when([self]), subject, verb, more) if part)
        return f"{text} (or else {'; '.join(self.alternatives)})" if self.alternatives else text

    @property
    def sizes(self) -> str:
        """By how much, and how sure."""
        # Parts within their noise would read as moves; a few are shown where none is clear.
        clear = {n: c for n, c in self.changes.items() if abs(c.size) >= 3.0 * c.sd}
        moved = clear or (self.changes if len(self.changes) <= _FEW else {})
        sizes = ", ".join(f"{name} by {self._by(c)}" for name, c in moved.items())
        sizes = sizes or f"no part of {len(self.changes)} is sure by itself"
        return f"{sizes}, {p_words(self.p_value)}"

    def _by(self, change: Change) -> str:
        if self.moved == "expansion":
            return f"{significant(1e6 * change.size, 3)} ppm"
        return with_unit(change.size, change.unit)

    def __str__(self) -> str:
        return f"{self.what}: {self.sizes}"


@dataclass(frozen=True)
class ChangePoints:
    """What a search for change points found."""

    found: tuple[ChangePoint, ...]
    """In the order of the poses."""
    level: Probability
    """Of finding any in independent errors."""
    poses: Count
    """Poses that were searched; 0: too many or too few."""
    toml: str = ""
    """The lines of a project or mechanism file that model them."""
    unsure: tuple[ChangePoint, ...] = ()
    """Steps without a sharp edge: a slow drift or a smooth model error explains them as well."""


@dataclass(frozen=True)
class Shifts:
    """What a search along the run found.

    found: change points in order; level: probability of finding any in independent errors; tested:
    poses that were searched, 0 where there are too many or too few; explained: ids of the poses
    that fit once the shifts are modelled, empty where none was found; unsure: steps without a sharp
    edge, which slow changes over the run explain as well; told_apart: those found that an error of
    the machine model cannot imitate: steps with an edge sharper than the path of the joints, and
    drifts of an instrument in an order that the joints do not follow; scales, delay, joint_error:
    of what was read, and of what the machine does, beside what was found.
    """

    found: tuple[ChangePoint, ...]
    level: float
    tested: int
    explained: frozenset[str] = frozenset()
    unsure: tuple[ChangePoint, ...] = ()
    told_apart: tuple[ChangePoint, ...] = ()
    scales: tuple[ScaleEntry, ...] = ()
    delay: DelayEntry | None = None
    joint_error: JointErrorEntry | None = None

    def __len__(self) -> int:
        return len(self.found)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self) -> list[str]:
        """In words."""
        if not self.tested:
            return ["shifts: not searched (too few or too many poses)"]
        rule = f"{self.tested} poses in order, family-wise level {100 * self.level:g} %"
        if not self.found:
            return [f"shifts: none ({rule})"]
        points = [line for point in self.found for line in wrapped(str(point), "  ", "    ")]
        return [f"shifts: {len(self.found)} ({rule})", *points]


# The level is that of the search, 1 % family-wise (record 0051).
NOT_SEARCHED = Shifts((), 0.01, 0)


def when(points: Sequence[ChangePoint]) -> str:
    """When these changes happened."""
    steps = [point.pose for point in points if point.shape == "step"]
    words = [f"from pose{'s' if len(steps) > 1 else ''} {enumerated(steps)} on"] if steps else []
    ramps = dict.fromkeys((p.pose, p.after) for p in points if p.shape == "ramp")
    return " and ".join([*words, *(f"all along poses {a} to {b}" for a, b in ramps)])


def hold(points: Sequence[ChangePoint]) -> str:
    """For which state of a machine with these changes predictions hold."""
    if any(point.shape == "ramp" for point in points):
        return "Predictions hold for the end of the run."
    return "Predictions hold after the last change."


# What single readings can hide: the smallest error that the tests find, and what it does.


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

    __repr__ = brief

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


# Whether the residuals of an instrument depend on each other, in pose order and in joint space.


@dataclass(frozen=True)
class Likeness:
    """How alike the residuals of neighbouring poses are."""

    correlation: float
    """Of neighbours; 0 in independent errors."""
    p_value: Probability
    """Of a correlation at least so large in independent errors."""


@dataclass(frozen=True)
class InstrumentDependence:
    """One instrument."""

    instrument: str
    serial: Likeness | None
    """Poses that follow each other (von Neumann's ratio); null: too few, or no noise at all."""
    spatial: Likeness | None
    """Poses that are near in joint space (Moran's I); null: too few, or no noise at all."""


@dataclass(frozen=True)
class Dependence:
    """The tests of all instruments, and what was learnt of a drift.

    Serial dependence makes the covariance of the result the sandwich of a learnt drift.
    """

    instruments: tuple[InstrumentDependence, ...]
    level: Probability
    """Of rejecting any instrument in independent errors, serial and spatial each."""
    drift_share: Size | None = None
    """Share of the drift in the variance of a reading; null: no serial dependence."""
    drift_poses: Size | None = None
    """Poses over which the drift forgets to 1/e."""
    shared: Likeness | None = None
    """The largest canonical correlation of two instruments' residuals in one pose; null: there is
    one instrument, or the sds of the joints explain what instruments share."""

    @property
    def serial(self) -> tuple[InstrumentDependence, ...]:
        """The instruments that depend on the pose order."""
        # The level is family-wise: the instruments share it (Bonferroni; record 0050).
        limit = self.level / max(len(self.instruments), 1)
        return tuple(i for i in self.instruments if i.serial and i.serial.p_value < limit)

    @property
    def spatial(self) -> tuple[InstrumentDependence, ...]:
        """The instruments that depend on the place in joint space."""
        limit = self.level / max(len(self.instruments), 1)
        return tuple(i for i in self.instruments if i.spatial and i.spatial.p_value < limit)

    @property
    def errors_shared(self) -> bool:
        """Whether instruments share errors that the fit takes as independent."""
        return self.shared is not None and self.shared.p_value < self.level

    def warnings(self) -> tuple[str, ...]:
        """What it means, and what to do."""
        lines = []
        for one in self.serial:
            assert one.serial is not None
            lines.append(
                f"Residuals of {one.instrument!r} depend on the pose order (correlation of "
                f"consecutive poses {significant(one.serial.correlation, 2)}, "
                f"{p_words(one.serial.p_value)}): it drifts, was moved, or lacks a term of the "
                f"model along the path. Standard deviations and intervals by covariance allow "
                f"for a drift over about {significant(self.drift_poses or 0.0, 2)} poses. Look for "
                f"shifts, or measure the poses in random order."
            )
        for one in self.spatial:
            assert one.spatial is not None
            lines.append(
                f"Residuals of {one.instrument!r} depend on the place in joint space (correlation "
                f"of neighbours {significant(one.spatial.correlation, 2)}, "
                f"{p_words(one.spatial.p_value)}): the machine model lacks a term, such as sag or "
                f"a gear error. Standard deviations do not allow for it. Add effects, or fit "
                f"with model error."
            )
        return tuple(lines)
