"""What a verification found, as values, a document and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from loopcal.document.accuracy import Distances
from loopcal.document.tables import distances_shown
from loopcal.document.verdict import Answer, answer_lines
from loopcal.lazy import cached_property
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import by_sd, chance, size, unit_shown, with_unit
from loopcal.presentation.text_table import columns
from loopcal.statistics.changed import WhatChanged
from loopcal.statistics.gain import Gain
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.tolerance import Quantile, judged


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
    keep; unplaced: why the nominal machine cannot be placed, None where it can.
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

    @cached_property
    def verdict(self) -> Mapping[str, Answer]:
        """The answers by question: "consistent", "better" and "tolerance"."""
        return {
            "consistent": self._consistent(),
            "better": self._better(),
            "tolerance": judged(self.quantile, self.tolerance, self.unit, "of this file"),
        }

    @property
    def failed(self) -> tuple[Answer, ...]:
        """Why this machine must not be used as calibrated: inconsistent, or out of tolerance."""
        asked = (self.verdict["consistent"], self.verdict["tolerance"])
        return tuple(answer for answer in asked if answer.passed is False)

    def _consistent(self) -> Answer:
        its, changes = self.innovation, self.changes
        if its.p_value is None or changes is None:
            return Answer(
                None,
                "no-redundancy",
                None,
                "These poses only determine what was placed anew.",
                "Measure more poses.",
            )
        if changes.verdict == "unchanged":
            words = f"The machine is as calibrated: {self._statistic()}."
            return Answer(True, "unchanged", its.p_value, words, None)
        found = changes.found
        told = "; ".join(change.words for change in found) if found else self._statistic()
        words = f"The machine is not as calibrated: {told}."
        p_value = min(its.p_value, *(change.p_value for change in found), 1.0)
        if changes.verdict == "re-master":
            return Answer(False, "re-master", p_value, words, changes.next)
        return Answer(False, "changed", p_value, words, changes.next)

    def _statistic(self) -> str:
        its = self.innovation
        if its.learnt_freedom is None:
            size = significant(its.value, 4)
            of = f"{its.degrees_of_freedom} degrees of freedom"
            return f"chi-squared {size} at {of} (p = {chance(its.p_value)})"
        ratio = significant(its.value / its.degrees_of_freedom, 3)
        both = f"{its.degrees_of_freedom} and {significant(its.learnt_freedom, 3)}"
        return f"F = {ratio} at {both} degrees of freedom (p = {chance(its.p_value)})"

    def _better(self) -> Answer:
        mine, drawn, gain = self.calibrated, self.nominal, self.gain
        if self.unplaced is not None:
            words = f"The nominal machine cannot be placed: {self.unplaced}."
            return Answer(None, "nominal-not-placed", None, words, None)
        if mine is None or drawn is None or gain is None:
            words = "The accuracy is unknown: too few of these poses have measured outputs."
            return Answer(None, "unknown-accuracy", None, words, None)
        both = f"{with_unit(mine.rms, self.unit)} rms instead of {with_unit(drawn.rms, self.unit)}"
        difference, sd = with_unit(gain.difference, self.unit), with_unit(gain.sd, self.unit, 2)
        said = f"{both} (difference {difference}, sd {sd})."
        if gain.better is None:
            words = (
                f"The calibrated machine predicts these poses about as well as the drawing: {said}"
            )
            remedy = "Measure more poses to decide."
            return Answer(None, "like-nominal", gain.difference, words, remedy)
        if gain.better:
            words = f"The calibrated machine predicts these poses better than the drawing: {said}"
            return Answer(True, "better-than-nominal", gain.difference, words, None)
        words = f"The calibrated machine predicts these poses worse than the drawing: {said}"
        remedy = "Do not use the calibration at poses like these. Calibrate with such poses."
        return Answer(False, "worse-than-nominal", gain.difference, words, remedy)

    @property
    def headline(self) -> str:
        """The worst answer in words: what failed, then what is open, else the test."""
        answers = [a for a in self.verdict.values() if a.code != "no-tolerance"]
        return min(answers, key=lambda a: {False: 0, None: 1, True: 2}[a.passed]).words

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known."""
        its = self.innovation
        answers = {name: asdict(answer) for name, answer in self.verdict.items()}
        told = {"calibrated": self.calibrated, "nominal": self.nominal, "expected": self.expected}
        distances = {name: None if d is None else asdict(d) for name, d in told.items()}
        return {
            "verdict": {**answers, "headline": self.headline},
            "accuracy": {"unit": self.unit, **distances},
            "chi_squared": {
                "value": its.value,
                "degrees_of_freedom": its.degrees_of_freedom,
                "learnt_freedom": its.learnt_freedom,
                "p_value": its.p_value,
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
        lines += ["", *self._accuracy_table()]
        if self.placed:
            lines += ["", *self._placed_table()]
        lines += ["", *self._worst_table()]
        return "\n".join(lines)

    def _accuracy_table(self) -> list[str]:
        shown = unit_shown(self.unit)
        rows = [["accuracy", f"mean [{shown}]", "rms", "95 %", "max"]]
        told = {"nominal": self.nominal, "calibrated": self.calibrated, "expected": self.expected}
        rows += [[n, *distances_shown(d, self.unit)] for n, d in told.items() if d is not None]
        return columns(rows) if len(rows) > 1 else ["accuracy unknown: no measured outputs"]

    def _placed_table(self) -> list[str]:
        rows = [["placed anew", "value", "sd", "unit"]]
        for one in self.placed:
            sd = "unknown" if one.sd is None else size(one.sd, one.unit, 2)
            value = by_sd(one.value, one.sd, one.unit)
            rows.append([one.name, value, sd, unit_shown(one.unit)])
        return columns(rows)

    def _worst_table(self) -> list[str]:
        rows = [["worst poses", f"distance [{unit_shown(self.unit)}]", "chi-squared"]]
        rows += [
            [one.pose, size(one.distance, self.unit), significant(one.chi_squared, 3)]
            for one in self.worst
        ]
        return columns(rows)
