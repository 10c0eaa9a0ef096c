"""Do the intervals of pose performance hold? Coverage of every figure against simulated truth.

A robot with known mean offsets and normal scatter, measured by a tracker whose repeated errors and
whose frame are drawn anew in every draw. The truth of each figure is that of infinitely many
cycles. Cases: cycles, shape of the scatter, size of the offsets, drift.

    python -m analyses.pose_performance [--draws 2000]

Data sets of 15 groups count a tenth of the draws.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.companions.performance.accuracy import Group, Means, fitted_base
from loopcal.companions.performance.instrument import Figures, MeasuringErrors, tracker_of
from loopcal.companions.performance.intervals import Estimate, NormalScatter
from loopcal.companions.performance.parts import ConditionPerformance
from loopcal.companions.performance.performance import pose_performance
from loopcal.measurements.attained import AttainedPoses

Array = NDArray[np.float64]
CORNERS = np.array([(0, 0, 0), (1, 1, 1), (-1, 1, 1), (-1, -1, -1), (1, -1, -1)], dtype=float)
DIRECTIONS = ("+x", "+y", "+z")
TURN = 5e-5
"""Sd of an attained orientation about each axis [rad]."""


@dataclass(frozen=True)
class Case:
    """cycles; shape: sds of the scatter along x, y, z [m]; offset: size of mean offsets [m];
    common: whether tracker and frame err; growth: of the scatter from the first half of the cycles
    to the second, in which the offsets are others; 0 for a robot that does not drift; planar: only
    x and y are measured, and no orientation."""

    cycles: int = 30
    shape: tuple[float, float, float] = (2e-5, 2e-5, 2e-5)
    offset: float = 2e-4
    common: bool = True
    growth: float = 0.0
    planar: bool = False


CASES = {
    "usual": Case(),
    "ten cycles": Case(cycles=10),
    "four cycles": Case(cycles=4),
    "scatter along a line": Case(shape=(4e-5, 4e-6, 2e-6)),
    "hardly any offset": Case(offset=5e-6),
    "in a plane": Case(planar=True),
    "exact instrument": Case(common=False),
    "drift": Case(growth=1.0),
    "drift of twice RP": Case(growth=2.0),
}
ERRORS = MeasuringErrors(
    Figures.of("2 um"), tracker_of("10 um, 20 um + 5 um/m"), Figures.of("20 um, 20 urad")
)


def measured(case: Case, seed: int) -> tuple[AttainedPoses, dict[str, float]]:
    """A draw, and the true figures by name."""
    rng = np.random.default_rng(seed)
    errors = replace(ERRORS if case.common else MeasuringErrors(), planar=case.planar)
    there = np.array([1.0, 1.0, 0.0 if case.planar else 1.0])
    asked = (0.16 * CORNERS + [1.0, 0.0, 0.8]) * there
    offsets = rng.normal(0.0, case.offset, (5, 3))
    by_direction = rng.normal(0.0, 0.5 * case.offset, (5, 3, 3))
    spread = np.array(case.shape)
    blocks = 2 if case.growth else 1
    shift = rng.normal(0.0, case.offset, (5, 3)) * (np.arange(blocks) > 0)[:, None, None]
    repeated = [rng.multivariate_normal(np.zeros(3), errors.of_point(p)) for p in asked]
    sds = errors.frame.length or 0.0, errors.frame.angle or 0.0
    frame, tilt = rng.normal(0.0, sds[0], 3), rng.normal(0.0, sds[1], 3)
    tilt = tilt * [0.0, 0.0, 1.0] if case.planar else tilt
    turned = rng.normal(0.0, 1e-4, (5, 3))
    rows = [(i, d, k) for d in range(3) for k in range(case.cycles) for i in range(5)]
    block = [k * blocks // case.cycles for _, _, k in rows]
    true = np.array(
        [
            asked[i] + offsets[i] + by_direction[i, d] + shift[b, i]
            for (i, d, _), b in zip(rows, block, strict=True)
        ]
    )
    true = true * there
    grown = np.where(np.array(block) > 0, case.growth, 1.0)
    read = true + rng.normal(size=true.shape) * spread * grown[:, None]
    read += np.array([repeated[i] for i, _, _ in rows]) + frame + np.cross(tilt, read)
    read = read * there
    turns = np.array([turned[i] for i, _, _ in rows]) + rng.normal(0.0, TURN, true.shape)
    attained = AttainedPoses(
        "simulated",
        tuple(f"P{i + 1}" for i, _, _ in rows),
        tuple(str(k + 1) for _, _, k in rows),
        asked[[i for i, _, _ in rows]],
        read,
        np.broadcast_to(np.eye(3), (len(rows), 3, 3)),
        Rotation.from_rotvec(turns + tilt).as_matrix(),
        tuple(DIRECTIONS[d] for _, d, _ in rows),
        tuple(str(b) for b in block) if blocks > 1 else None,
        planar=case.planar,
    )
    if case.planar:
        attained = replace(attained, commanded_turns=None, measured_turns=None)
    return attained, _truth(case, attained, true, turned)


def _truth(case: Case, attained: AttainedPoses, true: Array, turned: Array) -> dict[str, float]:
    """The figures without noise, of as many cycles as one likes."""
    measured = 2 if case.planar else 3
    scatter = NormalScatter.of(np.diag(np.square(case.shape[:measured]))).repeatability
    found: dict[str, float] = {}
    groups: dict[tuple[str, str], list[int]] = {}
    assert attained.direction is not None
    for i, place in enumerate(zip(attained.pose, attained.direction, strict=True)):
        groups.setdefault(place, []).append(i)
    made = [Group(*place, np.array(rows)) for place, rows in groups.items()]
    means = Means.of(made, true, attained.commanded, MeasuringErrors(planar=case.planar))
    base = fitted_base(means)
    assert not isinstance(base, str)
    turn = Rotation.from_matrix(base.rotation)
    for i, group in enumerate(made):
        key = f"{group.pose}, {group.direction}"
        offset = true[group.rows] - attained.commanded[group.rows]
        found[f"AP {key}"] = float(np.linalg.norm(offset.mean(axis=0)))
        found[f"AP fitted {key}"] = float(np.linalg.norm(base.offsets[i]))
        for k, axis in enumerate("xyz"):
            about = turned[int(group.pose[1:]) - 1]
            found[f"APa {axis} {key}"] = float(about[k])
            after = (turn * Rotation.from_rotvec(about)).as_rotvec()
            found[f"APa fitted {axis} {key}"] = float(after[k])
            found[f"RPa {axis} {key}"] = 3.0 * TURN
        if attained.block is None:  # drift adds to the scatter otherwise
            found[f"RP {key}"] = scatter
        else:
            ends = np.linalg.norm(offset[[0, -1]], axis=1)
            found[f"shift {key}"] = float(np.linalg.norm(offset[-1] - offset[0]))
            found[f"dAP {key}"] = abs(float(ends[1] - ends[0]))
            found[f"dRP {key}"] = abs(case.growth - 1.0) * scatter
    for name in dict.fromkeys(attained.pose):
        at = [means.positions[i] for i, g in enumerate(made) if g.pose == name]
        found[f"vAP {name}"] = max(float(np.linalg.norm(a - b)) for a in at for b in at)
    return found


def figures(part: ConditionPerformance) -> Iterator[tuple[str, Estimate]]:
    """Name and estimate of every figure."""
    for pose in part.poses:
        yield f"AP {pose.name}", pose.accuracy
        if pose.accuracy_fitted is not None:
            yield f"AP fitted {pose.name}", pose.accuracy_fitted
        if pose.repeatability is not None:
            yield f"RP {pose.name}", pose.repeatability
        for axis in pose.orientation:
            yield f"APa {axis.axis} {pose.name}", axis.accuracy
            yield f"RPa {axis.axis} {pose.name}", axis.repeatability
            if axis.accuracy_fitted is not None:
                yield f"APa fitted {axis.axis} {pose.name}", axis.accuracy_fitted
    for variation in part.variations:
        yield f"vAP {variation.pose}", variation.variation
    for drift in part.drifts:
        yield f"shift {drift.pose}", drift.shift
        yield f"dAP {drift.pose}", drift.accuracy
        yield f"dRP {drift.pose}", drift.repeatability


KINDS = ("AP fitted", "AP", "APa fitted", "APa", "RPa", "RP", "vAP", "shift", "dAP", "dRP")


def coverage(case: Case, draws: int, first: int = 0) -> dict[str, float]:
    """Share of intervals that hold the truth, by kind of figure."""
    held: dict[str, list[bool]] = {}
    errors = ERRORS if case.common else MeasuringErrors()
    for seed in range(first, first + draws):
        attained, truth = measured(case, seed)
        _judge(held, pose_performance(attained, errors).conditions[0], truth)
    return {kind: float(np.mean(its)) for kind, its in held.items()}


def _judge(
    held: dict[str, list[bool]], part: ConditionPerformance, truth: Mapping[str, float]
) -> None:
    """Whether each interval of a condition holds the truth, noted by kind of figure."""
    for name, estimate in figures(part):
        if name in truth and estimate.low is not None and estimate.high is not None:
            kind = next(k for k in KINDS if name.startswith(f"{k} "))
            held.setdefault(kind, []).append(estimate.low <= truth[name] <= estimate.high)


CONDITIONS = {
    ("5", "50"): Case(),
    ("5", "100"): Case(shape=(4e-5, 3e-5, 2e-5)),
    ("10", "50"): Case(offset=6e-4),
    ("10", "100"): Case(shape=(6e-5, 6e-5, 6e-5), offset=8e-4),
}
"""Payload [kg] and speed [%]: a robot that is worse with both, all in one table."""


def condition_coverage(draws: int) -> dict[str, float]:
    """Share of intervals that hold the truth of their own payload and speed, by kind of figure."""
    held: dict[str, list[bool]] = {}
    for seed in range(draws):
        made = [measured(c, len(CONDITIONS) * seed + i) for i, c in enumerate(CONDITIONS.values())]
        tables = [attained for attained, _ in made]
        whole = AttainedPoses(
            "simulated",
            tuple(v for t in tables for v in t.pose),
            tuple(v for t in tables for v in t.cycle),
            np.vstack([t.commanded for t in tables]),
            np.vstack([t.measured for t in tables]),
            direction=tuple(d for t in tables for d in t.direction or ()),
            conditions={
                column: tuple(
                    key[i] for key, t in zip(CONDITIONS, tables, strict=True) for _ in t.pose
                )
                for i, column in enumerate(("payload", "speed"))
            },
        )
        done = pose_performance(whole, ERRORS)
        for part, (_, truth) in zip(done.conditions, made, strict=True):
            _judge(held, part, truth)
    return {kind: float(np.mean(its)) for kind, its in held.items()}


def distance_coverage(cycles: int, draws: int, *, common: bool) -> dict[str, float]:
    """Share of intervals of AD and RD of two poses that hold the truth."""
    held: dict[str, list[bool]] = {"AD": [], "RD": []}
    errors = ERRORS if common else MeasuringErrors()
    asked = np.array([[1.0, -0.2, 0.8], [1.0, 0.3, 0.9]])
    u = (asked[1] - asked[0]) / np.linalg.norm(asked[1] - asked[0])
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        offset = rng.normal(0.0, 1e-4)
        ends = asked + np.array([[0.0] * 3, u * offset])
        repeated = [rng.multivariate_normal(np.zeros(3), errors.of_point(p)) for p in ends]
        noise = rng.normal(0.0, 2e-5, (cycles, 2, 3))
        read = (ends + np.array(repeated) + noise).reshape(-1, 3)
        attained = AttainedPoses(
            "simulated",
            ("A", "B") * cycles,
            tuple(str(i // 2) for i in range(2 * cycles)),
            np.tile(asked, (cycles, 1)),
            read,
        )
        found = pose_performance(attained, errors).conditions[0].distances[0]
        truth = {"AD": abs(offset), "RD": 3.0 * 2e-5 * np.sqrt(2.0)}
        for name, estimate in (("AD", found.accuracy), ("RD", found.repeatability)):
            assert estimate.low is not None
            assert estimate.high is not None
            held[name].append(estimate.low <= truth[name] <= estimate.high)
    return {name: float(np.mean(its)) for name, its in held.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--draws", type=int, default=2000)
    draws = parser.parse_args().draws
    for name, case in CASES.items():
        found = coverage(case, draws // 10)
        shown = "  ".join(f"{k} {found[k]:.3f}" for k in KINDS if k in found)
        print(f"{name:22}", shown, flush=True)
    found = condition_coverage(draws // 40)
    shown = "  ".join(f"{k} {found[k]:.3f}" for k in KINDS if k in found)
    print(f"{'payloads and speeds':22}", shown, flush=True)
    for cycles in (4, 10, 30):
        for common in (False, True):
            found = distance_coverage(cycles, draws, common=common)
            words = "tracker" if common else "exact instrument"
            print(f"{cycles:2} cycles, {words:16}", *(f"{k} {v:.3f}" for k, v in found.items()))


if __name__ == "__main__":
    main()
