"""What a verification found, as values, a document and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from loopcal.document.accuracy import Distances
from loopcal.document.catalogue import findings
from loopcal.document.change_points import NOT_SEARCHED, Shifts
from loopcal.document.findings import ColumnFault
from loopcal.document.tables import machine_table
from loopcal.document.verdict import (
    Answer,
    Fact,
    Figure,
    Finding,
    Named,
    Question,
    Where,
    answer_lines,
    fact,
)
from loopcal.lazy import cached_property
from loopcal.presentation.shown import Table, brief, by_sd, p_words, significant, size, unit_shown
from loopcal.statistics.changed import LARGER, LEVEL, WhatChanged
from loopcal.statistics.gain import Gain
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.other_conditions import MEASURE
from loopcal.statistics.sound import along_the_run
from loopcal.statistics.verdict import Quantile, kept

MOVED = "moved-in-run"
_OR_ELSE = ", or else it is an error that the machine model lacks"
_OR_POSES = ", or else the robot states other poses than it did, as after a joint was mastered anew"
_PLACES = ("camera-moved", "mounting-changed", "machine-changed", "changed")
"""Codes of changes that stated poses may have made: a zero of the first joint moves a camera beside
the robot, one of the last joint what it carries, and others nearly so."""
_AGAINST = (MOVED, "errors-larger", "misfit-larger", "joints-scatter", "readings-scatter")
_QUESTIONS: tuple[Question, ...] = ("consistent", "better", "tolerance")


@dataclass(frozen=True)
class Placed:
    """A parameter that was found anew [SI].

    sd: with what is not known of the machine; None where these poses do not determine it.
    """

    name: str
    value: float
    sd: float | None
    unit: str


@dataclass(frozen=True)
class WorstPose:
    """A pose with its distance [unit; None without outputs] and its chi-squared."""

    pose: str
    distance: float | None
    chi_squared: float


@dataclass(frozen=True, eq=False)
class Verification:
    """A calibrated machine on another day.

    unit: SI unit of the distances; calibrated, nominal: accuracy of the machine as calibrated and
    as drawn, both placed anew by these poses; expected: what the stated covariance leads one to
    expect of the calibrated one; gain: of calibrated over nominal; innovation: the test of the
    machine; changes: of single parameters and zeros of joints, None without redundancy; placed:
    what was found anew; worst: poses, outliers ahead, the farthest first; quantile: the distance
    that 95 % of all poses keep; unplaced: why the nominal machine cannot be placed, None where it
    can; faults: of the file; shifts: what moved along the run; outliers: poses
    that do not fit the others; rare: probability of an rms at least so large, if the stated
    covariance holds; copied: rows that copy others; repeated: poses of the calibration itself;
    unlike: a sentence for each temperature or load outside the range of the calibration;
    read_as: how other columns than those of the first day were read, and repeats; sound: the
    answer of the calibration's own verdict, None where it was not judged; flange: whether a
    robot states poses, and no joints, so that an error of a joint is none of what is tested;
    files: names of result and readings, for commands.
    """

    __repr__ = brief

    poses: tuple[str, ...]
    unit: str
    calibrated: Distances | None
    nominal: Distances | None
    expected: Distances | None
    gain: Gain | None
    innovation: Innovation
    changes: WhatChanged | None
    placed: tuple[Placed, ...]
    worst: tuple[WorstPose, ...]
    quantile: Quantile | None
    tolerance: float | None = None
    unplaced: str | None = None
    faults: tuple[ColumnFault, ...] = ()
    shifts: Shifts = NOT_SEARCHED
    outliers: tuple[str, ...] = ()
    rare: float = 1.0
    copied: int = 0
    repeated: int = 0
    unlike: tuple[str, ...] = ()
    read_as: str = ""
    sound: Answer | None = None
    flange: bool = False
    files: Mapping[str, Named] = field(default_factory=dict)

    @cached_property
    def verdict(self) -> Mapping[Question, Answer]:
        """The answers by question: "consistent", "better" and "tolerance"."""
        return {question: Answer.of(self.findings, question) for question in _QUESTIONS}

    @property
    def failed(self) -> tuple[Answer, ...]:
        """Why this machine must not be used as calibrated: inconsistent, or out of tolerance."""
        asked = (self.verdict["consistent"], self.verdict["tolerance"])
        return tuple(answer for answer in asked if answer.passed is False)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What was found out, the gravest first."""
        facts = [*self._consistent(), self._better()]
        if self.tolerance is not None:
            facts.append(kept(self.quantile, self.tolerance, self.unit, "of this file"))
        return findings(facts, self.files)

    def _consistent(self) -> list[Fact]:
        if self.faults:
            readings = tuple(dict.fromkeys(q for one in self.faults for q in one.quantities))
            words = "; ".join(one.words for one in self.faults)
            return [fact("day-at-fault", Where(readings=readings), faults=words)]
        if self.innovation.p_value is None or self.changes is None:
            return [fact("no-redundancy")]
        stated = (self._moved(), *self._larger(), self._unlike(), self._unsound(), *self._rows())
        facts = [one for one in stated if one is not None]
        if self.changes.code != "unchanged" or not any(one.code in _AGAINST for one in facts):
            facts.append(self._changed(self.changes))
        return facts

    def _changed(self, changes: WhatChanged) -> Fact:
        place = Where(parameters=tuple(change.name for change in changes.found))
        words = "; ".join(change.among for change in changes.found) or self._statistic()
        if changes.found and self.sound is not None and self.sound.code == "sds-too-small":
            words += _OR_ELSE
        # A slide of another scale looks like a print and a lens that changed at once.
        several = changes.code == "images-changed" and len(changes.found) > 1
        if self.flange and (changes.code in _PLACES or several):
            words += _OR_POSES
        whole = 0.0 if self.innovation.p_value is None else self.innovation.p_value
        p_value = min(whole, *(change.p_value for change in changes.found), 1.0)
        return fact(
            changes.code,
            place,
            {"p_value": whole if changes.code == "unchanged" else p_value},
            statistic=self._statistic(),
            changes=words,
            joints=", ".join(changes.joints),
            camera=changes.exchanged or (changes.found[0].name if changes.found else ""),
        )

    def _moved(self) -> Fact | None:
        """What moved during the run, or may have, where an error of the machine looks the same."""
        if clear := self.shifts.told_apart:
            return along_the_run(MOVED, clear, changes=len(clear))
        open_ = (*self.shifts.found, *self.shifts.unsure)
        return along_the_run("moved-or-machine", open_, changes=len(open_)) if open_ else None

    def _larger(self) -> Iterator[Fact]:
        """Errors that are larger than stated by half, whatever explains them."""
        changes, mine, expected = self.changes, self.calibrated, self.expected
        if changes is None:
            return
        sizes = dict[str, Figure]()
        if mine is not None and expected is not None and expected.rms and self.rare < LEVEL:
            pair = {"rms": mine.rms, "expected": expected.rms}
            sizes = {name: Figure(value, self.unit) for name, value in pair.items()}
        if changes.scatter:
            yield from self._scatter(changes.scatter, sizes)
            return
        spread = math.sqrt(changes.spread)
        times = sizes["rms"].value / sizes["expected"].value if sizes else 0.0
        if times > max(LARGER, spread):
            yield fact("errors-larger", numbers={"times": times, **sizes})
        elif spread > LARGER:
            yield fact("misfit-larger", numbers={"times": spread})

    def _scatter(self, scatter: Mapping[str, float], sizes: Mapping[str, Figure]) -> Iterator[Fact]:
        """Readings that scatter more than stated."""
        joints = "The poses that the robot states" if self.flange else "The joints"
        images = self.unit == "px"
        what = {
            "joints": joints,
            "readings": "The corners" if images else "The readings of the instruments",
        }
        shown = f": {sizes['rms']:3} rms instead of {sizes['expected']:3}" if sizes else ""
        for name, times in scatter.items():
            numbers: dict[str, float | Figure] = {"times": times, **sizes}
            yield fact(f"{name}-scatter", numbers=numbers, what=what[name], sizes=shown)

    def _unlike(self) -> Fact | None:
        bad = self.outliers
        if not bad:
            return None
        named = ", ".join(bad[:5]) + (", ..." if len(bad) > 5 else "")
        count, them = (f"{len(bad)} poses do", "them") if len(bad) > 1 else ("1 pose does", "it")
        words = {"named": named, "count": count, "them": them}
        return fact("poses-unlike", Where(poses=bad), {"poses": len(bad)}, **words)

    def _unsound(self) -> Fact | None:
        """What the calibration's own verdict holds against it, or leaves open."""
        if self.sound is None or self.sound.passed:
            return None
        code = "calibration-open" if self.sound.passed is None else "calibration-not-sound"
        return fact(code, why=self.sound.words)

    def _rows(self) -> Iterator[Fact]:
        if self.copied:
            yield fact("day-copied", numbers={"rows": self.copied}, copied=str(self.copied))
        if self.repeated:
            numbers = {"poses": self.repeated}
            yield fact("own-poses", numbers=numbers, repeated=str(self.repeated))

    def _statistic(self) -> str:
        innovation = self.innovation
        if innovation.learnt_freedom is None:
            size = significant(innovation.value, 4)
            of = f"{innovation.degrees_of_freedom} degrees of freedom"
            return f"chi-squared {size} at {of} ({p_words(innovation.p_value)})"
        ratio = significant(innovation.value / innovation.degrees_of_freedom, 3)
        both = f"{innovation.degrees_of_freedom} and {significant(innovation.learnt_freedom, 3)}"
        return f"F = {ratio} at {both} degrees of freedom ({p_words(innovation.p_value)})"

    def _better(self) -> Fact:
        mine, drawn, gain = self.calibrated, self.nominal, self.gain
        if self.faults:
            return fact("accuracy-of-faulty-file")
        if self.unplaced is not None:
            return fact("nominal-not-placed", reason=self.unplaced)
        if mine is None or drawn is None or gain is None:
            return fact("unknown-accuracy")
        code = {None: "like-nominal", True: "better-than-nominal", False: "worse-than-nominal"}
        sizes = {"difference": gain.difference, "sd": gain.sd}
        sizes |= {"rms": mine.rms, "nominal_rms": drawn.rms}
        return fact(code[gain.better], numbers={n: Figure(v, self.unit) for n, v in sizes.items()})

    @property
    def headline(self) -> str:
        """The worst answer in a sentence: what failed, then what is open, else the test.

        What is open beside a machine that is as calibrated follows that answer.
        """
        asked = {q: a for q, a in self.verdict.items() if a.asked}
        worst = min(asked, key=lambda q: {False: 0, None: 1, True: 2}[asked[q].passed])
        both = asked["consistent"].passed and asked[worst].passed is None
        shown = ("consistent", worst) if both else (worst,)
        return " ".join(
            next(one.words for one in self.findings if one.question == question)
            for question in shown
        )

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known."""
        innovation = self.innovation
        answers = {name: asdict(answer) for name, answer in self.verdict.items()}
        accuracies = {
            "calibrated": self.calibrated,
            "nominal": self.nominal,
            "expected": self.expected,
        }
        distances = {name: None if d is None else asdict(d) for name, d in accuracies.items()}
        return {
            "verdict": {**answers, "headline": self.headline},
            "findings": [asdict(one) for one in self.findings],
            "accuracy": {"unit": self.unit, **distances},
            "chi_squared": {
                "value": innovation.value,
                "degrees_of_freedom": innovation.degrees_of_freedom,
                "learnt_freedom": innovation.learnt_freedom,
                "p_value": innovation.p_value,
            },
            "changes": None if self.changes is None else self.changes.document(),
            "placed": [asdict(one) for one in self.placed],
            "poses": len(self.poses),
            "worst": [asdict(one) for one in self.worst],
            "along_the_run": [asdict(one) for one in self.shifts.found],
            "outliers": list(self.outliers),
            "other_conditions": list(self.unlike),
            "read_as": self.read_as,
            "quantile": None if self.quantile is None else asdict(self.quantile),
            "tolerance": self.tolerance,
        }

    def __str__(self) -> str:
        lines = [self.headline, *answer_lines(self.verdict)]
        lines += self.remarks
        if self.changes is not None:
            lines += ["", *self.changes.lines()]
        accuracy, placed, worst = self.tables
        unknown = ["accuracy unknown: too few of these poses have measured outputs"]
        lines += ["", *(accuracy.lines() if accuracy.rows else unknown)]
        if placed.rows:
            lines += ["", *placed.lines()]
        lines += ["", *worst.lines()]
        return "\n".join(lines)

    @property
    def remarks(self) -> list[str]:
        """What the user should know beside the answers."""
        return [*filter(None, [self.read_as]), *(f"{words} {MEASURE}" for words in self.unlike)]

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Accuracy, what was placed anew, and the worst poses."""
        unit = self.unit
        accuracies = {
            "nominal": self.nominal,
            "calibrated": self.calibrated,
            "expected": self.expected,
        }
        placed = tuple(
            (
                one.name,
                by_sd(one.value, one.sd, one.unit),
                "unknown" if one.sd is None else size(one.sd, one.unit, 2),
                unit_shown(one.unit),
            )
            for one in self.placed
        )
        worst = tuple(
            (one.pose, size(one.distance, unit), significant(one.chi_squared, 3))
            for one in self.worst
        )
        return (
            machine_table("Accuracy", unit, accuracies),
            Table("Placed anew", ("parameter", "value", "sd", "unit"), placed),
            Table("Worst poses", ("pose", f"distance [{unit_shown(unit)}]", "chi-squared"), worst),
        )
