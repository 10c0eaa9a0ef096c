"""What changed on a machine since its calibration, as values, a document and words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from loopcal.document.findings import DelayEntry
from loopcal.presentation.shown import (
    by_sd,
    p_words,
    percent,
    significant,
    size,
    unit_shown,
    with_unit,
)
from loopcal.small_samples import f_tail
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.judged_readings import RARE
from loopcal.statistics.run_order import WAYS

# Record 0053.
LEVEL = 0.015
"""p-value of either test, of the whole and of single changes. With the searches of the run for
slips and for poses that do not fit, at 1 % each, together 5 %."""
# Record 0053.
LARGER = 1.5
"""Error over what is expected from which on a machine is not as calibrated."""
# Record 0053.
SOUGHT = 3
"""Changes that are sought; with more the machine is calibrated anew."""
# Chosen, not derived: the usual power of a statement on what is missed.
POWER = 0.9
"""With which a change of the stated smallest size is seen."""
_WORDS = {
    "zero": "joint zeros",
    "angle": "angles",
    "length": "lengths",
    "mounting": "mountings",
    "camera": "cameras",
    "scale": "scales",
    "lens": "lenses",
    "print": "prints",
    "expansion": "scales",
    "slide": "scales of slides",
    "drift": "drifts along the run",
    "delay": "delays",
}
DRIFT_OR_CHANGE = "drift-or-change"
"""The verdict where a drift of the instrument along the run explains the changes."""
CONDITIONAL = ("load", "expansion")
"""Kinds of changes of what a machine is used under, not of itself."""
_OF_IMAGES = {"lens", "print"}
"""Kinds of changes of a camera and of what it sees."""
PLACED = ("mounting", "camera")
"""Kinds of changes of where something sits."""
PRINCIPAL_POINT = "the principal point of "
"""The name of its change begins so, and ends with that of the camera."""
_VERBS = {"zero": "moved", **dict.fromkeys(PLACED, "moved"), "slide": "changed"}
# Chosen, not derived: what fits a line.
_MOST_NAMED = 4
# Chosen, not derived: such a change would be of the size of the machine.
_HARDLY = 1000.0
"""A change that must be so many times as large as the smallest of its kind is not visible."""
# Chosen, not derived: sds that differ by less than a fifth change no decision.
_WIDER = 1.5
"""A ratio of variances from which it is told."""


@dataclass(frozen=True)
class Candidate:
    """What may have changed: the zero of a joint, a parameter, or several that change together.

    kind: "zero" of the joint `name`, "mounting", "camera" beside the machine, "load", "expansion"
    of the machine, "slide" of which the scale changed, "drift" of the instrument along the run, or
    the kind of the parameter `name`.
    p_value: of its test, adjusted for the others (Holm), None where these poses do not show it, and
    for a drift, which is tested with the run. smallest: the change [unit] that is seen with
    probability `POWER`, None where these poses do not show it. label: what a sentence calls it,
    where not by its name.
    """

    name: str
    kind: str
    unit: str
    p_value: float | None = None
    smallest: float | None = None
    label: str = ""

    @property
    def seen(self) -> str:
        """The smallest change that is seen."""
        if self.kind == "delay":
            return f"{significant(100.0 * (self.smallest or 0.0), 2)} % of the way"
        if self.unit == "1":
            return f"{significant(1e6 * (self.smallest or 0.0), 2)} ppm"
        return with_unit(self.smallest, self.unit, 2)

    @property
    def words(self) -> str:
        """The candidate in words."""
        what = {"zero": "the zero of ", "drift": "a drift of "}.get(self.kind, "")
        return what + self.name


@dataclass(frozen=True)
class Change:
    """A change that was found.

    value, low, high: [unit] how much, with its 95 % interval; p_value: adjusted for the search;
    alike: further candidates which explain these poses about as well; parts: how much of each [SI],
    where several change together; the value is then the length of those in its unit; hidden:
    parts that these poses do not determine; turn: of what moved as one, and half of its 95 %
    interval [rad]; label: as of a candidate.
    """

    name: str
    kind: str
    unit: str
    value: float
    sd: float
    low: float
    high: float
    p_value: float
    alike: tuple[Candidate, ...]
    parts: Mapping[str, float] = field(default_factory=dict)
    hidden: tuple[str, ...] = ()
    turn: tuple[float, float] | None = None
    label: str = ""

    @property
    def zeros(self) -> tuple[str, ...]:
        """The joints whose zero explains the change, where no mounting explains it better."""
        if self.kind in PLACED:
            return ()
        names = (self.name,) if self.kind == "zero" else ()
        return (*names, *(other.name for other in self.alike if other.kind == "zero"))

    @property
    def mounted(self) -> bool:
        """Whether something that was mounted anew explains the change."""
        return not self.kinds.isdisjoint(PLACED)

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of all that explains the change."""
        return frozenset({self.kind, *(other.kind for other in self.alike)})

    @property
    def conditional(self) -> bool:
        """Whether what the machine is used under explains the change."""
        return not self.kinds.isdisjoint(CONDITIONAL)

    @property
    def where(self) -> str:
        """What changed, in words."""
        what = {"zero": "the zero of ", "drift": "a drift of "}.get(self.kind, "")
        return what + (self.label or self.name)

    @property
    def words(self) -> str:
        """The change in a sentence without its end."""
        if self.kind == "delay":
            sure = significant(50.0 * (self.high - self.low), 2)
            delay = DelayEntry(WAYS[self.name] > 0, -self.value, self.sd, self.p_value)
            return delay.words(f" ± {sure} %")
        turned = self.kind in PLACED and self.unit == "rad"
        verb = "turned" if turned else _VERBS.get(self.kind, "changed")
        if self.kind == "load" and self.unit != "kg":
            return f"{self.where} {verb}"
        half = 0.5 * (self.high - self.low)
        if half >= abs(self.value):
            # A part that these poses do not show is as large as the sum of those that they show; a
            # load is only known beside what it weighs on.
            return f"{self.where} {verb}, by a size that these poses do not determine"
        if self.unit == "1":
            value, sure = (significant(1e6 * one, 3) for one in (self.value, half))
            return f"{self.where} {verb} by {value} ± {sure} ppm"
        moved, unit = by_sd(self.value, self.sd, self.unit), unit_shown(self.unit)
        words = f"{self.where} {verb} by {moved} {unit} ± {size(half, self.unit, 2)} {unit}"
        if self.turn and self.turn[0] > self.turn[1]:
            turn, sure = (with_unit(one, "rad", 2) for one in self.turn)
            words += f" and turned by {turn} ± {sure}"
        parts = [f"{n} {with_unit(v, self.unit)}" for n, v in self.parts.items()]
        parts += [f"{n} unknown" for n in self.hidden]
        return f"{words} ({', '.join(parts)})" if parts else words

    @property
    def among(self) -> str:
        """The change in words, with the others that explain it and ask for another remedy."""
        named = (*_VERBS, *CONDITIONAL, *_OF_IMAGES)
        names = [one.words for one in self.alike if one.kind in named]
        more = len(names) - _MOST_NAMED
        names = names[:_MOST_NAMED] + ([f"one of {more} more"] if more > 0 else [])
        *others, last = names or [""]
        either = f"{', '.join(others)} or {last}" if others else last
        return f"{self.words}, or else {either} changed" if names else self.words


@dataclass(frozen=True)
class WhatChanged:
    """The changes of a machine since its calibration, and what would not have been seen.

    verdict: unchanged, re-master, calibrate-anew or drift-or-change; found: the changes, in the
    order of the search; candidates: all that was tested; test: of the whole; spread: by how much
    these poses vary more than stated, where that is sure and no change; left: p-value of the whole
    after these changes, None without redundancy; moved: what the changes move [SI], by name;
    scatter: how many times as large as stated the sds of "joints", or of the poses that a robot
    states, and of all other "readings" are, where they scatter so.
    """

    verdict: str
    found: tuple[Change, ...]
    candidates: tuple[Candidate, ...]
    test: Innovation
    spread: float
    left: float | None
    moved: Mapping[str, float] = field(default_factory=dict)
    scatter: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_document(cls, entry: Mapping[str, Any], test: Mapping[str, Any]) -> WhatChanged:
        """From `document`, and the document of the test of the whole."""
        candidates = {one["name"]: Candidate(**one) for one in entry["candidates"]}
        return cls(
            entry["verdict"],
            tuple(
                Change(**{**one, "alike": tuple(candidates[name] for name in one["alike"])})
                for one in entry["found"]
            ),
            tuple(candidates.values()),
            Innovation(**test),
            entry["spread"],
            entry["left_p_value"],
            scatter=entry.get("scatter", {}),
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints to master again: for each change, the first whose zero explains it."""
        if self.verdict != "re-master":
            return ()
        return tuple(dict.fromkeys(change.zeros[0] for change in self.found))

    @property
    def exchanged(self) -> str:
        """The camera whose principal point changed, with its focal length or place, and nothing
        else: refocusing moves the one, a knock the other; "" for none."""
        names = {one.name for one in self.found if one.kind in ("lens", *PLACED)}
        points = [n for n in names if n.startswith(PRINCIPAL_POINT)]
        if len(points) != 1 or not 1 < len(names) == len(self.found):
            return ""
        eye = points[0].removeprefix(PRINCIPAL_POINT)
        return eye if names <= {eye, f"{eye}_f", points[0]} else ""

    @property
    def _half_a_pixel(self) -> bool:
        """Whether the principal point alone changed, and by half a pixel each way within its 95 %
        interval: the centre of the first pixel is 0 in some files and 0.5 in others."""
        if len(self.found) != 1 or not self.found[0].name.startswith(PRINCIPAL_POINT):
            return False
        (change,) = self.found
        half = 0.5 * (change.high - change.low)
        off = [*change.parts.values()]
        alike = len(off) == 2 and off[0] * off[1] > 0.0
        return alike and all(abs(abs(by) - 0.5) < half < 0.25 for by in off)

    @property
    def code(self) -> str:
        """Of the fact that these changes are."""
        if self.verdict in ("unchanged", DRIFT_OR_CHANGE):
            return self.verdict
        if self.exchanged:
            return "camera-exchanged"
        if len(self.found) == SOUGHT and self.left is not None and self.left < LEVEL:
            return "more-changed"
        if any(change.kind == "delay" for change in self.found):
            return "day-delayed"
        mounted = all(change.mounted for change in self.found)
        if self.verdict == "re-master":
            if not mounted and any(change.conditional for change in self.found):
                return "conditions-first"
            alone = all(change.kind == "zero" for change in self.found)
            if alone and any(change.unit == "m" for change in self.found):
                return "re-master-slides"
            return "re-master" if alone else "re-master-first"
        kinds = {change.kind for change in self.found}
        if len(kinds) == 1 and not kinds.isdisjoint(CONDITIONAL):
            return f"{kinds.pop()}-changed"
        if self.found and mounted:
            return "camera-moved" if kinds == {"camera"} else "mounting-changed"
        if kinds == {"slide"}:
            return "slide-changed"
        if kinds and kinds <= _OF_IMAGES:
            return "pixels-counted" if self._half_a_pixel else "images-changed"
        if any(change.conditional for change in self.found):
            return "conditions-first"
        stated = not any(one.kind == "mounting" for one in self.candidates)
        return "machine-changed" if stated else "changed"

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI."""
        return {
            "verdict": self.verdict,
            "joints": list(self.joints),
            "found": [
                {**asdict(one), "alike": [other.name for other in one.alike]} for one in self.found
            ],
            "left_p_value": self.left,
            "spread": self.spread,
            "scatter": dict(self.scatter),
            "power": POWER,
            "candidates": [asdict(one) for one in self.candidates],
        }

    def lines(self) -> list[str]:
        """For the summary."""
        return [*self._seen(), *self._unseen()]

    def _seen(self) -> list[str]:
        lines = ["what changed since the calibration"]
        for change in self.found:
            held = "" if self.code == "more-changed" else " (95 %)"
            lines.append(f"  {change.words}{held}, {p_words(change.p_value)}")
            if change.alike:
                names = _some([other.words for other in change.alike])
                lines.append(f"    not distinguishable at these poses: {names}")
        if self.found:
            lines.append(
                "  no other change is seen"
                if (self.left or 0.0) >= LEVEL
                else f"  these changes do not explain all differences ({p_words(self.left)})"
            )
        elif self.verdict == "unchanged":
            lines.append("  no change is seen")
        else:
            lines.append("  no single change explains the differences")
        if self.spread > _WIDER:
            ratio = f"{math.sqrt(self.spread):.1f} times"
            lines.append(f"  an error that no change explains is {ratio} as large as stated")
        return lines

    def _unseen(self) -> list[str]:
        seen: dict[str, list[Candidate]] = {}
        for one in self.candidates:
            # A load is of no size that a user knows: it is seen by what it does to each joint.
            if one.smallest is not None and one.kind != "load":
                seen.setdefault(f"{one.kind} {one.unit}", []).append(one)
        lines = [f"smaller changes are not always seen (seen with {percent(POWER)})"]
        hidden = [one.words for one in self.candidates if one.smallest is None]
        for every in seen.values():
            least = min(one.smallest or 0.0 for one in every)
            near_least = [one for one in every if (one.smallest or 0.0) <= _HARDLY * least]
            hidden += [one.words for one in every if one not in near_least]
            near_least = sorted(near_least, key=lambda one: one.smallest or 0.0)
            kind = _WORDS.get(near_least[0].kind, near_least[0].kind)
            first, most = near_least[0], near_least[-1]
            line = f"  {kind}: from {first.seen} ({first.name})"
            if most is not first:
                line += f" to {most.seen} ({most.name})"
            lines.append(line)
        if hidden:
            lines.append(f"  not visible at these poses: {_some(hidden)}")
        return lines


def verdict_of(p_value: float | None, changes: Sequence[Change], left: float | None) -> str:
    """Of `WhatChanged`, by the p-values of the whole and of what these changes leave."""
    if not changes and (p_value is None or p_value >= LEVEL):
        return "unchanged"
    explained = left is None or left >= LEVEL
    if changes and explained and all(change.zeros for change in changes):
        return "re-master"
    return "calibrate-anew"


def _some(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    shown = ", ".join(names[:_MOST_NAMED])
    return f"{shown} and {more} more" if more > 0 else shown


def larger(scale: float, freedom: int, learnt: float) -> float:
    """A scale of variances from so many degrees of freedom, or 1 where it may be chance."""
    return scale if f_tail(scale * freedom, freedom, learnt) < RARE else 1.0
