"""What a comparison of two calibrations found, as values, a document and words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.catalogue import findings
from loopcal.document.plain import finite
from loopcal.document.verdict import Fact, Finding, Where, fact
from loopcal.lazy import cached_property
from loopcal.presentation.shown import SHOWN, brief, columns, percent, rounded_by_sd, significant
from loopcal.small_samples import f_tail, t_quantile
from loopcal.units import from_si

# The level that the pages state (docs/explanation/comparison.md, `analyses.compared`).
SIGNIFICANT = 0.05
# Chosen, not derived: beyond, what one calibration holds where the other measured rests on its
# prior.
FAR = 2.0
"""Regions differ where one calibration is so many times less certain in that of the other."""
# Chosen, not derived: what fits a line.
_NAMED = 3


@dataclass(frozen=True)
class ParameterDifference:
    """One parameter [SI]: of A, of B brought to A, B minus A with its sd, and their ratio z.

    sd: None where one of the calibrations does not determine the parameter; placement: whether
    it says where the machine stands: what the machines differ in turns up there too, because
    they were brought together as wholes; degrees_of_freedom: of Student's t of z, None where it is
    normal.
    """

    name: str
    unit: str
    a: float
    b: float
    difference: float
    sd: float | None
    z: float | None
    placement: bool = False
    degrees_of_freedom: float | None = None

    @property
    def significant(self) -> bool:
        """Whether the difference alone is beyond its 95 % interval."""
        freedom = math.inf if self.degrees_of_freedom is None else self.degrees_of_freedom
        return self.z is not None and abs(self.z) > t_quantile(1.0 - SIGNIFICANT, freedom)


@dataclass(frozen=True, eq=False)
class PointDifference:
    """B minus A at common poses: difference (N, o) and covariance (N, o, o) [SI].

    rms, max: of the distances, of an image rms over its corners; worst: the pose of the largest,
    sd: of that distance; inside: share of the poses whose difference lies in the 95 % region of
    its covariance; unit: of the distances.
    """

    poses: tuple[str, ...]
    difference: Array
    covariance: Array
    rms: float
    max: float
    worst: str
    sd: float
    inside: float
    unit: str = "m"

    @classmethod
    def of(
        cls,
        ids: tuple[str, ...],
        delta: Array,
        covariance: Array,
        within: NDArray[np.bool_],
        unit: str = "m",
    ) -> PointDifference:
        """From differences and whether each lies within its 95 % region."""
        corners = delta.shape[1] / 2 if unit == "px" else 1.0
        distance = np.linalg.norm(delta, axis=1) / math.sqrt(corners)
        worst = int(np.argmax(distance))
        # To first order a distance changes by what its ends move along it.
        direction = delta[worst] / max(float(distance[worst]), 1e-300) / corners
        return cls(
            ids,
            delta,
            covariance,
            float(np.sqrt(np.square(distance).mean())),
            float(distance[worst]),
            ids[worst],
            float(np.sqrt(max(direction @ covariance[worst] @ direction, 0.0))),
            float(within.mean()),
            unit,
        )


@dataclass(frozen=True)
class ContrastTest:
    """chi^2 of all that both calibrations determine, its degrees of freedom, and those of the
    denominator of F where sds were learnt, else inf."""

    value: float
    freedom: int
    denominator: float

    @property
    def p_value(self) -> float | None:
        """Probability of a difference at least this large between two right calibrations."""
        return f_tail(self.value, self.freedom, self.denominator) if self.freedom else None


@dataclass(frozen=True, eq=False)
class Compared:
    """The comparison of calibrations A and B.

    aligned: whether B was brought to A; points: None without outputs; test: of the difference
    between the machines; reach: how many times less certain one is at the poses of the other than
    at its own, None where learnt terms carry the error of both models or the poses are not known;
    remarks: what must be known besides.
    """

    __repr__ = brief

    a: str
    b: str
    aligned: bool
    parameters: tuple[ParameterDifference, ...]
    points: PointDifference | None
    test: ContrastTest
    reach: float | None
    remarks: tuple[Fact, ...]

    @property
    def p_value(self) -> float | None:
        """Probability of a difference at least this large between two right calibrations."""
        return self.test.p_value

    @property
    def chi_squared(self) -> float:
        """Of all that both calibrations determine."""
        return self.test.value

    @property
    def degrees_of_freedom(self) -> int:
        """Of that chi-squared."""
        return self.test.freedom

    @property
    def differ(self) -> bool | None:
        """Whether the machines differ at the 5 % level; None where that cannot be decided."""
        p = self.p_value
        # Elsewhere an error of the model moves parameters as no residual shows (record 0066).
        if p is None or (p < SIGNIFICANT and (self.reach or 0.0) > FAR):
            return None
        return p < SIGNIFICANT

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Whether the two machines differ, and the remarks, the gravest first."""
        return findings([self._difference(), *self.remarks])

    def _difference(self) -> Fact:
        tested = [q for q in self.parameters if not (self.aligned and q.placement)]
        tested = [q for q in tested if q.significant]
        place = Where(parameters=tuple(q.name for q in tested))
        if self.p_value is None:
            return fact("nothing-common", place)
        most = sorted(tested, key=lambda q: -abs(q.z or 0.0))[:_NAMED]
        named = ", ".join(f"{q.name} (z = {q.z:+.1f})" for q in most)
        code = {True: "machines-differ", False: "machines-agree", None: "undecided"}[self.differ]
        together = "No single parameter differs significantly; together they do."
        blame = f"Most: {named}." if named else together
        where = "" if self.points is None else _where(self.points)
        return fact(code, place, {"p_value": self.p_value}, where=where, blame=blame)

    def verdict(self) -> str:
        """The answer in a sentence or two, and what to do."""
        one = next(one for one in self.findings if one.question == "consistent")
        return one.words if one.next is None else f"{one.words} {one.next.words}"

    @property
    def notes(self) -> tuple[str, ...]:
        """What must be known besides."""
        return tuple(one.words for one in self.findings if one.question is None)

    def document(self) -> dict[str, Any]:
        """Plain values, SI, for JSON."""
        points = self.points
        return {
            "a": self.a,
            "b": self.b,
            "aligned": self.aligned,
            "words": self.verdict(),
            "findings": [asdict(one) for one in self.findings],
            "chi_squared": {
                "value": self.test.value,
                "degrees_of_freedom": self.test.freedom,
                "denominator_degrees_of_freedom": finite(self.test.denominator),
                "p_value": self.p_value,
            },
            "reach": self.reach,
            "differ": self.differ,
            "common_poses": points
            and {
                "poses": len(points.poses),
                "unit": points.unit,
                "rms": points.rms,
                "max": points.max,
                "worst_pose": points.worst,
                "sd_of_max": points.sd,
                "inside_95": points.inside,
            },
            "parameters": [asdict(parameter) for parameter in self.parameters],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        head = f"A: {self.a}\nB: {self.b}"
        head += ", moved to where it agrees best with A" if self.aligned else ""
        fit = (
            f"chi-squared of the difference {significant(self.test.value, 4)} at "
            f"{self.test.freedom} degrees of freedom"
        )
        if math.isfinite(self.test.denominator):
            fit += f" (F with {significant(self.test.denominator, 3)} for the learnt sds)"
        lines = [head, "", self.verdict(), fit]
        if self.points is not None:
            lines.append(
                f"{percent(self.points.inside)} of {len(self.points.poses)} common poses differ by "
                "no more than their own 95 % region"
            )
        lines += ["", *_table(self.parameters)]
        for note in self.notes:
            lines += ["", f"NOTE  {note}"]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(str(self))}</pre>"


def _where(points: PointDifference) -> str:
    # outputs of several units have no one distance; those of an arm are all lengths
    unit = SHOWN.get(points.unit, points.unit)
    most, sd, rms = (significant(from_si(v, unit), 3) for v in (points.max, points.sd, points.rms))
    return (
        f"largest {most} {unit} (sd {sd} {unit}, pose {points.worst}), rms {rms} {unit} at "
        f"{len(points.poses)} common poses, "
    )


def _table(parameters: Sequence[ParameterDifference]) -> list[str]:
    rows = [["parameter", "A", "B", "B - A", "sd", "z", "unit"]]
    for p in parameters:
        unit = SHOWN.get(p.unit, p.unit)
        a, b, change = (from_si(v, unit) for v in (p.a, p.b, p.difference))
        if p.sd:
            sd = from_si(p.sd, unit)
            cells = [
                rounded_by_sd(a, sd),
                rounded_by_sd(b, sd),
                rounded_by_sd(change, sd, sign=True),
            ]
            rows.append([p.name, *cells, significant(sd, 2), f"{p.z:+z.1f}", unit])
        else:
            cells = [rounded_by_sd(v, math.inf) for v in (a, b)] + [significant(change, 3)]
            sd_words = "unknown" if p.sd is None else "none"
            rows.append([p.name, *cells, sd_words, "", unit])
    return columns(rows)
