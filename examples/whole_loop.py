"""The whole loop of one simulated arm: plan, measure, calibrate, verify, export, correct, measure.

The true arm differs from its drawing in lengths and angles, gives way under its weight, and its
gears are out of round. Only `Cell` knows it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.presentation.shown import significant

Array = NDArray[np.float64]
HERE = Path(__file__).parent
TITLE = "A sagging arm, from planned poses to a corrected program"
JOINTS = tuple(f"theta_{i}" for i in range(1, 7))
SDS = {"theta_*": 5e-5, **dict.fromkeys("xyz", 2e-5)}
OFF = {"m": 4e-4, "rad": 5e-4, "rad/m": 2e-4}
"""Sds of the true arm about its drawing."""
RANGE, CANDIDATES, PLANNED, CHECKED, TARGETS = 1.2, 150, 40, 30, 50
ANOTHER_DAY = {"base_x": 1.8, "base_y": -0.9, "base_rz": 0.8}
"""Where the tracker stands when the calibration is verified."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The true arm and its tracker; machine: with all that the truth states."""

    machine: lc.Mechanism
    truth: Mapping[str, float]

    @classmethod
    def of(cls, drawn: lc.Mechanism) -> Cell:
        """A cell whose arm differs from the drawing."""
        machine = lc.structured(drawn)
        rng = np.random.default_rng(2026)
        off = {p.name: OFF[p.unit] * rng.standard_normal() for p in machine.parameters}
        return cls(machine, {p.name: p.nominal + off[p.name] for p in machine.parameters})

    def measured(self, poses: Mapping[str, Array], seed: int, **tracker: float) -> lc.Dataset:
        """What encoders and tracker read at these joints."""
        truth = {**self.truth, **tracker}
        made = lc.simulate(self.machine, poses, noise=lc.Noise(SDS), seed=seed, truth=truth)
        return made.dataset

    def points(self, joints: Array) -> Array:
        """(N, 3) points [m] that the tracker sees at these joints (N, 6)."""
        read = self.measured(dict(zip(JOINTS, joints.T, strict=True)), seed=3)
        return np.array([read[axis] for axis in "xyz"]).T


@dataclass(frozen=True, eq=False)
class Loop:
    """Rms distances [mm] of the end point from the targets, before and after the correction;
    steps: what each step found, in a line; report: of the calibration."""

    before: float
    after: float
    steps: tuple[str, ...]
    report: Path

    @property
    def shown(self) -> list[str]:
        """Both distances [mm], rounded."""
        return [significant(size, 2 if size < 1.0 else 3) for size in (self.before, self.after)]

    @property
    def line(self) -> str:
        """Both distances in a line."""
        before, after = self.shown
        return (
            f"distance from the targets, rms: {before} mm before, {after} mm after the correction"
        )


def whole_loop(out: Path) -> Loop:
    """Run the loop; its results lie in the folder out."""
    drawn = lc.read_mechanism(HERE / "six_axis" / "mechanism.toml")
    cell = Cell.of(drawn)

    able = _random(CANDIDATES, seed=5)
    planned = lc.plan(drawn, PLANNED, candidates=able, noise=SDS)
    data = cell.measured({q: np.array(planned.poses[q]) for q in JOINTS}, seed=1)

    result = lc.calibrate(drawn, data, noise=SDS)
    written = lc.write_result(result, out / "whole_loop", title=TITLE, report=True)

    check = cell.measured(_random(CHECKED, seed=7), seed=2, **ANOTHER_DAY)
    verified = lc.verify(result, check)
    exported = lc.export(result, "zeros")

    program = _random(TARGETS, seed=9)
    done = lc.correct(result, program)
    base = done.arms.machine.base  # where the calibration places the arm
    wanted = (base @ done.corrected.targets.poses)[:, :3, 3]
    before = cell.points(np.array([program[q] for q in JOINTS]).T)
    after = cell.points(done.corrected.joints)
    left = {one.model: one.from_full for one in exported.machine.accuracy}["zeros and tool"]
    assert left is not None
    chosen = result.chosen.words.split(";")[0] if result.chosen else ""
    steps = (
        f"plan: {PLANNED} poses of the {CANDIDATES} that the cell allows",
        f"calibrate: {chosen}",
        f"verify, {CHECKED} poses of another day: {verified.headline}",
        f"export: zeros and tool alone would leave {significant(1e3 * left.rms, 2)} mm",
        f"correct: {int(done.corrected.done.sum())} of {TARGETS} targets of a program",
    )
    return Loop(_rms(before - wanted), _rms(after - wanted), steps, written.folder / "report.html")


def main() -> None:
    """Run the loop, and say how far the arm is from its targets before and after."""
    done = whole_loop(HERE.parent / "build" / "demo")
    print(f"\n{TITLE}\n  {done.line}")
    for step in done.steps:
        print(f"  {step}")
    print(f"\nIts report: {done.report.relative_to(HERE.parent)}")


def _random(count: int, seed: int) -> dict[str, Array]:
    return dict(lc.random_poses(dict.fromkeys(JOINTS, (-RANGE, RANGE)), count, seed=seed))


def _rms(off: Array) -> float:
    """Rms length [mm] of vectors (N, 3) [m]."""
    return float(1e3 * np.sqrt(np.square(off).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
