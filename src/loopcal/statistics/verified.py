"""What a verification found, as values, a document and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from loopcal.document.accuracy import Distances
from loopcal.document.catalogue import findings
from loopcal.document.tables import machine_table
from loopcal.document.verdict import (
    Answer,
    Fact,
    Figure,
    Finding,
    Question,
    Where,
    answer_lines,
    fact,
)
from loopcal.lazy import cached_property
from loopcal.presentation.shown import Table, by_sd, chance, significant, size, unit_shown
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.gain import Gain
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.verdict import Quantile, kept

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
    what was found anew; worst: poses, the farthest first; quantile: the distance that 95 % of poses
    keep; unplaced: why the nominal machine cannot be placed, None where it can; files: names of
    result and readings, for command lines.
    """

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
    files: Mapping[str, str] = field(default_factory=dict)

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
        facts = [self._consistent(), self._better()]
        if self.tolerance is not None:
            facts.append(kept(self.quantile, self.tolerance, self.unit, "of this file"))
        return findings(facts, self.files)

    def _consistent(self) -> Fact:
        innovation, changes = self.innovation, self.changes
        if innovation.p_value is None or changes is None:
            return fact("no-redundancy")
        place = Where(parameters=tuple(change.name for change in changes.found))
        words = "; ".join(change.words for change in changes.found) or self._statistic()
        p_value = min(innovation.p_value, *(change.p_value for change in changes.found), 1.0)
        return fact(
            changes.code,
            place,
            {"p_value": innovation.p_value if changes.code == "unchanged" else p_value},
            statistic=self._statistic(),
            changes=words,
            joints=", ".join(changes.joints),
        )

    def _statistic(self) -> str:
        innovation = self.innovation
        if innovation.learnt_freedom is None:
            size = significant(innovation.value, 4)
            of = f"{innovation.degrees_of_freedom} degrees of freedom"
            return f"chi-squared {size} at {of} (p = {chance(innovation.p_value)})"
        ratio = significant(innovation.value / innovation.degrees_of_freedom, 3)
        both = f"{innovation.degrees_of_freedom} and {significant(innovation.learnt_freedom, 3)}"
        return f"F = {ratio} at {both} degrees of freedom (p = {chance(innovation.p_value)})"

    def _better(self) -> Fact:
        mine, drawn, gain = self.calibrated, self.nominal, self.gain
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
        """The worst answer in words: what failed, then what is open, else the test."""
        answers = [a for a in self.verdict.values() if a.asked]
        return min(answers, key=lambda a: {False: 0, None: 1, True: 2}[a.passed]).words

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
            "quantile": None if self.quantile is None else asdict(self.quantile),
            "tolerance": self.tolerance,
        }

    def __str__(self) -> str:
        lines = [self.headline, *answer_lines(self.verdict)]
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
