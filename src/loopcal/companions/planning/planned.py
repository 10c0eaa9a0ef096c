"""A plan: the chosen poses in an order to measure them, what they promise, and how good it is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.planning.information import Information
from loopcal.companions.planning.search import (
    Criterion,
    Search,
    criterion_value,
    inverse,
    test_variances,
)
from loopcal.document.plain import finite, plain
from loopcal.measurements.dataset import Dataset
from loopcal.presentation.shown import SHOWN, columns, significant, with_unit
from loopcal.units import from_si

CRITERIA = {
    "I": "mean variance of the end point",
    "G": "largest variance of the end point",
    "D": "determinant of the covariance of the parameters",
    "A": "mean relative variance of the parameters",
}
VALIDATE, CALIBRATE, REPEAT = "validate", "calibrate", "repeat"


@dataclass(frozen=True)
class Expected:
    """What so many poses promise, those already measured besides.

    end_point: rms over the test poses of the sd of the end point [SI], with the model error of
    single poses where one was learnt; largest: the largest of them; None where the poses do not
    determine all parameters yet, or nothing predicts an end point; parameters: sd by name [SI],
    None where undetermined.
    """

    poses: int
    end_point: float | None
    largest: float | None
    parameters: Mapping[str, float | None]


@dataclass(frozen=True)
class RandomSets:
    """What random choices of the same candidates promise instead.

    end_point: rms sd [SI] of as many random poses, in the mean over draws; equivalent: how many
    random poses promise as much as the plan, None where more than were tried.
    """

    poses: tuple[int, ...]
    end_point: tuple[float | None, ...]
    equivalent: int | None


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to measure, in the order of `poses`, which has short joint travel.

    poses: readings to set [SI] with their ids; closed: the same with everything that would be
    read; use: "calibrate", "validate" or "repeat" for each; existing: poses measured before;
    candidates: how many were allowed, considered: of how many, refused: by which rule; efficiency:
    no choice of as many of these candidates has less than this share of the criterion (D: per
    parameter);
    curve: by number of poses, the most telling first; fitted: what those marked "calibrate" alone
    promise; random: random choices beside it; travel: length of the way, shortened: over that in
    the order of choice; draws: of the parameters that the criterion is averaged over; unit: of the
    end point; units: parameter -> SI unit; rigid: what all poses promise of a machine that is as
    its geometry says, None where nothing beside geometry was assumed, or where it was learnt;
    serves: the instruments of each pose, none where all serve every one; idle: those of the
    mechanism that no pose serves.
    """

    poses: Dataset
    closed: Dataset
    use: tuple[str, ...]
    existing: int
    candidates: int
    considered: int
    refused: Mapping[str, int]
    criterion: str
    efficiency: float
    curve: tuple[Expected, ...]
    fitted: Expected
    random: RandomSets | None
    travel: float
    shortened: float
    draws: int
    unit: str
    units: Mapping[str, str]
    remarks: tuple[str, ...] = ()
    rigid: Expected | None = None
    serves: tuple[tuple[str, ...], ...] = ()
    idle: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Plan: {self.count} poses, criterion {self.criterion}>"

    @property
    def count(self) -> int:
        """How many poses were chosen; repeats are none of them."""
        return len(self.use) - self.use.count(REPEAT)

    @property
    def expected(self) -> Expected:
        """What all poses promise."""
        return self.curve[-1]

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known."""
        readings = {q: v.tolist() for q, v in self.poses.readings.items()}
        return {
            "schema": 1,
            "criterion": self.criterion,
            "efficiency": self.efficiency,
            "existing": self.existing,
            "candidates": {
                "allowed": self.candidates,
                "considered": self.considered,
                "refused": dict(self.refused),
            },
            "poses": [
                {
                    "pose": pose,
                    "use": self.use[i],
                    "readings": {q: finite(values[i]) for q, values in readings.items()},
                    **({"serves": list(self.serves[i])} if self.serves else {}),
                }
                for i, pose in enumerate(self.poses.poses)
            ],
            "unit": self.unit,
            "units": dict(self.units),
            "expected": plain(self.curve),
            "expected_without_validation": plain(self.fitted),
            "expected_if_rigid": plain(self.rigid),
            "random": plain(self.random),
            "travel": {"length": self.travel, "over_order_of_choice": self.shortened},
            "draws": self.draws,
            "remarks": list(self.remarks),
        }

    def summary(self) -> list[str]:
        """What was chosen, how good it is, and what it promises, one sentence a line."""
        marked, again = self.use.count(VALIDATE), self.use.count(REPEAT)
        lines = [
            f"{self.count} poses of {self.candidates} candidates, {marked} of them to validate"
            + (f", beside {self.existing} already measured" if self.existing else "")
        ]
        if again:
            lines.append(f"the first pose {again} times more, which shows a drift")
        kinds = Counter(
            " and ".join(map(repr, kind))
            for kind, use in zip(self.serves, self.use, strict=False)
            if use != REPEAT
        )
        kinds.update(dict.fromkeys(map(repr, self.idle), 0))
        if kinds:
            lines += [", ".join(f"{n or 'none'} for {kind}" for kind, n in kinds.items())]
        lines += [f"{count} of {self.considered} excluded: {rule}" for rule, count in self._lost()]
        lines += [
            f"criterion {self.criterion} ({CRITERIA[self.criterion]}): at least "
            f"{100.0 * self.efficiency:.0f} % of the best possible choice"
        ]
        return [*lines, *self._end_point(), *self.remarks]

    def __str__(self) -> str:
        return "\n".join([*self.summary(), "", *self._table()])

    def _lost(self) -> list[tuple[str, int]]:
        return [(rule, count) for rule, count in self.refused.items() if count]

    def _end_point(self) -> list[str]:
        last = self.expected
        if last.end_point is None or last.largest is None:
            return []
        rms, most = (with_unit(v, self.unit) for v in (last.end_point, last.largest))
        lines = [f"expected sd of the end point: {rms} rms, {most} at most"]
        if self.rigid is not None and self.rigid.end_point is not None:
            stiff = with_unit(self.rigid.end_point, self.unit)
            lines += [f"of a machine without any model error: {stiff} rms"]
        if self.fitted.end_point is not None:
            without = with_unit(self.fitted.end_point, self.unit)
            lines += [f"without the poses to validate: {without} rms"]
        if self.random is not None:
            sds_by_number = dict(zip(self.random.poses, self.random.end_point, strict=True))
            same = sds_by_number.get(self.count)
            worth = self.random.equivalent
            prefix = "" if same is None else f"{with_unit(same, self.unit)} rms; "
            count = f"{worth}" if worth is not None else f"more than {self.random.poses[-1]}"
            lines += [f"as many random poses: {prefix}{count} random poses are worth this plan"]
        return lines

    def _table(self) -> list[str]:
        marks = sorted({*np.linspace(1, len(self.curve), 5).round().astype(int).tolist()})
        points = [self.curve[m - 1] for m in marks]
        rows = [["expected sd after", *(str(p.poses) for p in points), "unit"]]
        if self.expected.end_point is not None:
            shown = SHOWN.get(self.unit, self.unit)
            for name, values in (
                ("end point, rms", [p.end_point for p in points]),
                ("end point, largest", [p.largest for p in points]),
            ):
                rows.append([name, *(_cell(v, self.unit) for v in values), shown])
        for name, unit in self.units.items():
            cells = [_cell(p.parameters[name], unit) for p in points]
            rows.append([name, *cells, SHOWN.get(unit, unit)])
        return columns(rows)


def _cell(value: float | None, unit: str) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return significant(float(from_si(value, SHOWN.get(unit, unit))), 3)


# What poses promise: the sds of the end point and of every parameter, by their number.

SHARE = 0.2
"""Of the chosen poses, to validate."""
_LOOSE = 1e3
"""Times the ridge: directions with less information are not determined."""
# Twelve sets, up to five times as many poses, at sixteen sizes: a curve to compare with.
_SETS, _TIMES, _SIZES = 12, 5.0, 16


def expected_of(draw: Information, names: Sequence[str], total: Array, poses: int) -> Expected:
    """What an information (k, k) promises."""
    values, vectors = np.linalg.eigh(total)
    loose = values < _LOOSE * draw.ridge
    C = inverse(total)
    sds = np.sqrt(np.maximum(np.einsum("nk,nk->n", draw.root @ C, draw.root), 0.0))
    # a parameter is loose where most of its variance lies along loose directions
    along = np.square(draw.root @ (vectors[:, loose] / np.sqrt(values[loose]))).sum(axis=1)
    bad = along > 0.5 * np.square(sds)
    parameters = {
        n: None if b or not s > 0.0 else float(s)
        for n, s, b in zip(names, sds.tolist(), bad.tolist(), strict=True)
    }
    end_point = largest = None
    if len(draw.tests):
        v = test_variances(draw, C) + draw.white**2
        seen = draw.tests.reshape(-1, draw.tests.shape[2]) @ vectors[:, loose]
        lost = np.square(seen / np.sqrt(values[loose])).sum() / len(v)
        if lost <= 0.5 * v.mean():
            end_point, largest = float(np.sqrt(v.mean())), float(np.sqrt(v.max()))
    return Expected(poses, end_point, largest, parameters)


def expected_curve(
    draw: Information, names: Sequence[str], chosen: Sequence[int], how: Criterion
) -> tuple[Expected, ...]:
    """After 1, 2, ... of the chosen poses, the one that lowers the criterion most always next."""
    sub = replace(draw, rows=draw.rows[list(chosen)])
    search = Search([sub], how)
    curve = []
    for count in range(1, len(chosen) + 1):
        search.add(int(np.argmax(search.gains())))
        total = sub.of(search.chosen)
        curve.append(expected_of(draw, names, total, count))
    return tuple(curve)


def to_validate(
    draws: Sequence[Information], chosen: Sequence[int], how: Criterion
) -> frozenset[int]:
    """About a fifth of the chosen poses: those without which the others promise most.

    None where the others would not determine the parameters.
    """
    marked: list[int] = []
    subs = [replace(d, rows=d.rows[list(chosen)]) for d in draws]
    left = list(range(len(chosen)))
    for _ in range(round(SHARE * len(chosen))):
        costs = [
            np.mean([criterion_value(d, d.of([j for j in left if j != i]), how) for d in subs])
            for i in left
        ]
        best = left[int(np.argmin(costs))]
        left.remove(best)
        marked.append(chosen[best])
    return frozenset(marked)


def random_sets(
    draw: Information, names: Sequence[str], even: NDArray[np.intp], plan: Expected
) -> RandomSets | None:
    """Rms sds of growing random sets of the candidates at `even`, in the mean over several."""
    N, number = len(even), plan.poses
    most = min(N, math.ceil(_TIMES * number))
    if most <= number or plan.end_point is None:
        return None
    sizes = np.unique(np.geomspace(max(number // 3, 1), most, _SIZES).round().astype(int))
    sizes = np.unique(np.append(sizes, number))
    rng = np.random.default_rng(1)
    squares: dict[int, list[float]] = {int(s): [] for s in sizes}
    for _ in range(_SETS):
        order = rng.permutation(even)
        for size in squares:
            sd = expected_of(draw, names, draw.of(order[:size]), size).end_point
            squares[size].append(math.inf if sd is None else sd**2)
    means = [math.sqrt(float(np.mean(squares[int(s)]))) for s in sizes]
    shown = tuple(m if math.isfinite(m) else None for m in means)
    return RandomSets(
        tuple(int(s) for s in sizes), shown, _equivalent(sizes, means, plan.end_point)
    )


def _equivalent(sizes: Array, means: list[float], target: float) -> int | None:
    """The size at which random sets promise the same, between sizes by a power law."""
    for i, mean in enumerate(means):
        if mean <= target:
            if i == 0 or not math.isfinite(means[i - 1]):
                return int(sizes[i])
            # Sds fall as a power of the number of poses, nearly n^-1/2: linear in the logarithms.
            share = math.log(means[i - 1] / target) / math.log(means[i - 1] / mean)
            return round(float(sizes[i - 1] * (sizes[i] / sizes[i - 1]) ** share))
    return None
