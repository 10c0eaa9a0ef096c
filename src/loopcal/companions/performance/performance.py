"""All figures of pose performance from attained poses, one payload and speed after the other.

Formulas of ISO 9283:1998 as secondary sources give them, such as Slamani, Nubiola and Bonev,
Assessment of the positioning performance of an industrial robot, Industrial Robot 39 (2012):

    AP = |p - p_c|,  RP = l + 3 S_l,  l_j = |p_j - p|;   about each axis AP_a = mean, RP_a = +-3 S_a
    vAP = max |p_h - p_k| of directions of approach,  AD = |D - D_c|,  RD = +-3 S_D
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.performance.accuracy import (
    FittedBase,
    Group,
    Means,
    covariance_of_mean,
    fitted_base,
)
from loopcal.companions.performance.instrument import Figures, MeasuringErrors, tracker_of
from loopcal.companions.performance.intervals import (
    LEVEL,
    Estimate,
    NormalScatter,
    length_interval,
    repeatability,
    size_interval,
    spread_interval,
)
from loopcal.companions.performance.parts import (
    AxisPerformance,
    ConditionPerformance,
    DirectionVariation,
    DistancePerformance,
    Drift,
    PosePerformance,
    blocks_of,
    drift,
)
from loopcal.companions.performance.summary import Performance
from loopcal.errors import InputError, UsageError, unknown_name
from loopcal.files.atomic import write_atomic
from loopcal.files.project.new_project import write_new_files
from loopcal.files.tables.attained import TEMPLATE, read_attained, template
from loopcal.measurements.attained import AttainedPoses
from loopcal.mechanisms.rotations import rotation_vector
from loopcal.presentation.shown import p_words
from loopcal.small_samples import t_quantile
from loopcal.statistics.repeats import CLEAR, FEWEST, slow_p_value

if TYPE_CHECKING:
    from loopcal.companions.performance.summary import Performance


AXES = ("x", "y", "z")
# ISO 9283 measures five poses, P1 to P5.
EVERY_PAIR = 5
"""Poses up to which the distance of every pair is given; beyond, those of successive poses."""
USUAL_CYCLES = 30
OTHER_FRAME = 30.0
"""Ratio of AP before and after the fit above which another frame was measured in."""


def pose_performance(
    attained: AttainedPoses,
    errors: MeasuringErrors | None = None,
    *,
    distances: Sequence[tuple[str, str]] = (),
) -> Performance:
    """The figures of attained poses.

    distances: pairs of poses; by default every pair of up to five poses, beyond that successive
    ones. Raises InputError for a pose that is not there, and for units that cannot be right.
    """
    errors = replace(errors or MeasuringErrors(), planar=attained.planar)
    names = list(dict.fromkeys(attained.pose))
    for name in (name for pair in distances for name in pair):
        if name not in names:
            raise unknown_name(f"there is no pose {name!r}", name, names, attained.file)
    for one, other in distances:
        if one == other:
            raise InputError(
                f"the pose {one!r} has no distance from itself",
                code="invalid-value",
                place=attained.file,
                remedy="name two poses",
            )
    columns = attained.conditions or {}
    conditions = _rows_by(
        range(len(attained)), lambda i: tuple(values[i] for values in columns.values())
    )
    parts = [
        _Part(attained, dict(zip(columns, key, strict=True)), rows, errors).figures(distances)
        for key, rows in conditions.items()
    ]
    notes = (*attained.notes, *errors.words())
    return Performance(attained.file, len(attained), tuple(parts), notes)


def _rows_by(
    rows: Iterable[int], key: Callable[[int], tuple[str | None, ...]]
) -> dict[tuple[Any, ...], NDArray[np.intp]]:
    """The rows of each key, in the order in which the keys come."""
    grouped: dict[tuple[Any, ...], list[int]] = {}
    for i in rows:
        grouped.setdefault(key(i), []).append(i)
    return {key: np.array(indices) for key, indices in grouped.items()}


class _Part:
    """The rows of one condition, in groups of one pose and direction."""

    def __init__(
        self,
        attained: AttainedPoses,
        condition: dict[str, str],
        rows: NDArray[np.intp],
        errors: MeasuringErrors,
    ) -> None:
        self.all, self.condition, self.errors = attained, condition, errors
        directions = attained.direction or (None,) * len(attained)
        groups = _rows_by(rows, lambda i: (attained.pose[i], directions[i]))
        self.groups = [Group(pose, way, rows) for (pose, way), rows in groups.items()]
        self.missing: list[str] = []

    def figures(self, distances: Sequence[tuple[str, str]]) -> ConditionPerformance:
        means = Means.of(self.groups, self.all.measured, self.all.commanded, self.errors)
        base = fitted_base(means)
        fitted = None if isinstance(base, str) else base
        if isinstance(base, str):
            self.missing.append(f"AP after fitting: {base}.")
        poses = tuple(self._pose(i, means, fitted) for i in range(len(self.groups)))
        single = [pose.name for pose in poses if pose.cycles < 2]
        if single:
            self.missing.append(
                f"RP and intervals of {', '.join(single)}: one cycle shows no scatter."
            )
        if self.all.measured_turns is None:
            self.missing.append("Orientation: the table has no measured orientation.")
        return ConditionPerformance(
            self.condition,
            poses,
            tuple(self._variations()),
            tuple(self._distances(distances)),
            tuple(self._drifts(means, fitted)),
            tuple(self.missing),
            (
                *_remarks(poses, fitted is not None and _other_frame(means, fitted)),
                *self._dependence(),
            ),
        )

    def _dependence(self) -> Iterable[str]:
        """Whether successive cycles resemble each other, by von Neumann's ratio of all groups."""
        series = []
        for group in self.groups:
            rows = group.rows
            if self.all.time is not None:
                rows = rows[np.argsort(self.all.time[rows], kind="stable")]
            if len(rows) >= FEWEST:
                series.append(self.all.measured[rows])
        if not series:
            return
        counts = np.array([len(part) for part in series])
        square = np.sum(
            [np.square(part - part.mean(axis=0)).sum(axis=0) for part in series], axis=0
        )
        steps = np.sum([np.square(np.diff(part, axis=0)).sum(axis=0) for part in series], axis=0)
        p_values = [
            slow_p_value(float(a), float(b), counts) for a, b in zip(square, steps, strict=True)
        ]
        least = min((p for p in p_values if p is not None), default=1.0)
        # Three coordinates are tested at once (Bonferroni).
        if least < CLEAR / 3.0:
            yield (
                f"Successive cycles resemble each other ({p_words(least)}): robot or instrument "
                "drifts. The drift is part of RP, and the intervals take cycles as independent."
            )

    def _pose(self, i: int, means: Means, base: FittedBase | None) -> PosePerformance:
        group = self.groups[i]
        readings = self.all.measured[group.rows]
        rp_estimate = repeatability(readings) if len(readings) > 1 else None
        alone = self.errors.of_reading(means.positions[i])
        instrument = None if alone is None else NormalScatter.of(alone).repeatability
        share = None
        if instrument is not None and rp_estimate is not None and rp_estimate.value > 0.0:
            share = (instrument / rp_estimate.value) ** 2
        return PosePerformance(
            group.pose,
            group.direction,
            len(readings),
            means.accuracy(i),
            None if base is None else base.accuracy(i, means),
            tuple((means.positions[i] - means.commanded[i]).tolist()),
            rp_estimate,
            instrument,
            share,
            tuple(self._axes(group, base)),
        )

    def _axes(self, group: Group, base: FittedBase | None) -> Iterable[AxisPerformance]:
        """Turns from the commanded to the attained orientation about the axes of the base."""
        if self.all.measured_turns is None or self.all.commanded_turns is None:
            return
        asked = self.all.commanded_turns[group.rows]
        attained = self.all.measured_turns[group.rows]
        n = len(group.rows)
        turns = rotation_vector(attained @ asked.transpose(0, 2, 1))
        after = None
        if base is not None:
            after = rotation_vector(base.rotation @ attained @ asked.transpose(0, 2, 1))
        frame = (self.errors.frame.angle or 0.0) ** 2
        for k, axis in enumerate(AXES):
            sd = float(turns[:, k].std(ddof=1)) if n > 1 else 0.0
            fitted = None
            if base is not None and after is not None:
                fitted = _mean(after[:, k], float(base.turn[k, k]))
            yield AxisPerformance(
                axis, _mean(turns[:, k], frame), fitted, spread_interval(sd, n - 1.0, 3.0)
            )

    def _variations(self) -> Iterable[DirectionVariation]:
        """vAP; with several pairs of directions the bounds hold for all of them (Bonferroni)."""
        by_pose: dict[str, list[Group]] = {}
        for group in self.groups:
            by_pose.setdefault(group.pose, []).append(group)
        if all(len(groups) < 2 for groups in by_pose.values()):
            why = (
                "the table has no column of directions"
                if self.all.direction is None
                else "every pose was approached from one direction"
            )
            self.missing.append(f"vAP: {why}.")
        for pose, groups in by_pose.items():
            if len(groups) < 2:
                continue
            pairs = [*combinations(groups, 2)]
            distances = [self._between(a, b, 1.0 - (1.0 - LEVEL) / len(pairs)) for a, b in pairs]
            lows = [e.low for e in distances if e.low is not None]
            highs = [e.high for e in distances if e.high is not None]
            whole = len(highs) == len(distances)
            yield DirectionVariation(
                pose,
                tuple(str(g.direction) for g in groups),
                Estimate(
                    max(e.value for e in distances),
                    max(lows) if whole else None,
                    max(highs) if whole else None,
                ),
            )

    def _between(self, a: Group, b: Group, level: float) -> Estimate:
        """Distance of two means; errors that all readings of the pose share cancel."""
        readings = [self.all.measured[g.rows] for g in (a, b)]
        scatter = sum((covariance_of_mean(r) for r in readings), np.zeros((3, 3)))
        difference = readings[0].mean(axis=0) - readings[1].mean(axis=0)
        degrees = min(len(r) for r in readings) - 1.0
        return length_interval(difference, scatter, scatter, degrees, level)

    def _distances(self, asked: Sequence[tuple[str, str]]) -> Iterable[DistancePerformance]:
        """AD and RD from cycles in which both poses were measured."""
        rows: dict[str, dict[tuple[str, ...], int]] = {}
        for group in self.groups:
            row_of_cycle = rows.setdefault(group.pose, {})
            for i in group.rows:
                block = self.all.block[i] if self.all.block else ""
                row_of_cycle[(self.all.cycle[i], group.direction or "", block)] = int(i)
        pairs = [*asked]
        if not asked:
            pairs = [*(combinations(rows, 2) if len(rows) <= EVERY_PAIR else pairwise(rows))]
        if not pairs:
            self.missing.append("AD and RD: there is only one pose.")
        for one, other in pairs:
            at = rows.get(one, {}), rows.get(other, {})
            both = [key for key in at[0] if key in at[1]]
            if not both:
                self.missing.append(f"AD and RD of {one} to {other}: no cycle has both.")
                continue
            i, k = (np.array([row_of[key] for key in both]) for row_of in at)
            yield self._distance((one, other), i, k)

    def _distance(
        self, poses: tuple[str, str], i: NDArray[np.intp], k: NDArray[np.intp]
    ) -> DistancePerformance:
        apart = np.linalg.norm(self.all.measured[i] - self.all.measured[k], axis=1)
        commanded = float(np.linalg.norm(self.all.commanded[i[0]] - self.all.commanded[k[0]]))
        n = len(apart)
        sd = float(apart.std(ddof=1)) if n > 1 else 0.0
        ends = [self.all.measured[at].mean(axis=0) for at in (i, k)]
        # Only errors along the line between the poses change their distance.
        along = (ends[0] - ends[1]) / max(float(np.linalg.norm(ends[0] - ends[1])), 1e-300)
        common = sum(float(along @ self.errors.of_point(end) @ along) for end in ends)
        by_scatter = sd**2 / n
        difference = float(apart.mean()) - commanded
        accuracy = size_interval(difference, by_scatter, by_scatter + common, n - 1.0)
        return DistancePerformance(poses, n, commanded, accuracy, spread_interval(sd, n - 1.0, 3.0))

    def _drifts(self, means: Means, base: FittedBase | None) -> Iterable[Drift]:
        """dAP and dRP; in the fitted frame only where the instrument's is another one."""
        if self.all.time is None and self.all.block is None:
            self.missing.append("Drift: the table has neither a time nor a block column.")
            return
        measured, frame = self.all.measured, means.frame
        if base is not None and _other_frame(means, base):
            measured, frame = measured @ base.rotation.T + base.shift, np.zeros_like(frame)
        offsets = measured - self.all.commanded
        seen = self.all.block, self.all.time
        drifting = False
        for i, group in enumerate(self.groups):
            blocks = [b for b in blocks_of(group.rows, *seen) if len(b) > 1]
            if len(blocks) < 2:
                continue
            drifting = True
            common = means.shared[i] + frame[i]
            yield drift(group.name, blocks, offsets, common, seen)
        if not drifting:
            self.missing.append("Drift: it takes two blocks of cycles (20 cycles) of a pose.")


def _mean(values: Array, common: float) -> Estimate:
    """A mean with its 95 % interval; common: variance of what all values share."""
    n, value = len(values), float(values.mean())
    if n < 2:
        return Estimate(value, None, None)
    by_scatter = float(values.var(ddof=1)) / n
    if by_scatter + common == 0.0:
        return Estimate(value, value, value)
    # Welch-Satterthwaite: the common part is stated, so its degrees of freedom are infinite.
    degrees = np.inf if by_scatter == 0.0 else (n - 1.0) * ((by_scatter + common) / by_scatter) ** 2
    reach = t_quantile(LEVEL, float(degrees)) * float(np.sqrt(by_scatter + common))
    return Estimate(value, value - reach, value + reach)


def _other_frame(means: Means, base: FittedBase) -> bool:
    """Whether the instrument measured in another frame than that of the commanded poses."""
    before = np.linalg.norm(means.positions - means.commanded, axis=1)
    after = np.linalg.norm(base.offsets, axis=1)
    return bool(np.median(before) > OTHER_FRAME * np.median(after))


def _remarks(poses: Sequence[PosePerformance], other_frame: bool) -> Iterable[str]:
    few = [pose.name for pose in poses if pose.cycles < USUAL_CYCLES]
    if few:
        least = min(pose.cycles for pose in poses)
        yield f"ISO 9283 asks for {USUAL_CYCLES} cycles; the fewest here are {least}."
    if other_frame:
        yield (
            "The measured positions seem to be in another frame than the commanded ones: use AP "
            "after fitting."
        )
    # At a quarter of the variance the instrument's sd is half of the one that was measured.
    doubtful = [pose.name for pose in poses if (pose.instrument_share or 0.0) > 0.25]
    if doubtful:
        yield (
            "The instrument is too coarse to judge the repeatability of "
            f"{', '.join(doubtful)}: more than a quarter of the variance may be its own."
        )


# Pose performance from tables of measured poses, and the page of it.


def performance(
    data: str | Path | AttainedPoses,
    *,
    commanded: str | Path | None = None,
    units: str | None = None,
    angles: str | None = None,
    instrument_sd: str | None = None,
    frame_sd: str | None = None,
    tracker: str | None = None,
    distances: Sequence[tuple[str, str]] = (),
) -> Performance:
    """Pose accuracy, repeatability, variation, distances and drift, computed after ISO 9283.

    data: a table with a row per measurement, as `loopcal new NAME --performance` writes an example
    of; commanded: a table of the commanded poses, if they are not in it; units: "mm,deg" where the
    headers state none; angles: what columns a, b, c or rx, ry, rz mean ("rpy", "zyx", "rotvec").
    instrument_sd: sd of one reading, "5 um" or "5 um, 20 urad"; frame_sd: of the base frame;
    tracker: its name or "RANGE, TRANSVERSE" from the data sheet, measuring from the origin of the
    readings; distances: pairs of poses.

    AP = ``|mean - commanded|``, RP = mean distance from the mean + 3 sd; see
    `loopcal.companions.performance.performance` for all formulas and their sources.
    Raises InputError with file, row and column.
    """
    attained = data if isinstance(data, AttainedPoses) else read_attained(
        data, commanded=commanded, units=units, angles=angles
    )  # fmt: skip
    errors = MeasuringErrors(Figures.of(instrument_sd), tracker_of(tracker), Figures.of(frame_sd))
    return pose_performance(attained, errors, distances=distances)


def run_performance(
    attained: AttainedPoses,
    errors: MeasuringErrors,
    *,
    distances: Sequence[str] = (),
    out: str | Path | None = None,
) -> Performance:
    """The figures, and their page where a file is named for it; distances: "P2,P4"."""
    figures = pose_performance(attained, errors, distances=[_pair(text) for text in distances])
    if out is not None:
        from loopcal.companions.performance.page import performance_html

        write_atomic(out, performance_html(figures, attained))
    return figures


def new_performance(name: str | Path) -> tuple[Path, ...]:
    """Write an example table of commanded poses, to be filled in; nothing is overwritten."""
    return write_new_files(Path(name), {TEMPLATE: template()})


def _pair(text: str) -> tuple[str, str]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise UsageError(f"{text!r} is not a pair of poses", remedy="write --distance P2,P4")
    return parts[0], parts[1]
