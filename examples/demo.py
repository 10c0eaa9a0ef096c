"""Calibrate three simulated arms and print each one's true error where nothing was measured.

The true end point is known at 2,000 fresh poses, so the printed errors are those of the calibrated
machine, not residuals. The third arm is the second one again; its reflector slips during the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.files.result.truth_file import read_truth
from loopcal.presentation.shown import significant

HERE = Path(__file__).parent
RESULTS = HERE.parent / "build" / "demo"
FRESH = 2000
SLIP = 1.5e-3
EXACT = lc.Noise({"*": 0.0})
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    """A simulated arm: what was read, and what is true after the last reading."""

    key: str
    title: str
    project: lc.Project
    data: lc.Dataset
    truth: Mapping[str, float]
    method: str

    def errors(self, result: lc.Result) -> Array:
        """Distances [m] between true and predicted end point at fresh poses."""
        assert self.project.simulation is not None
        spans = self.project.simulation.ranges
        fresh = lc.random_poses({q: (s.start, s.stop) for q, s in spans.items()}, FRESH, seed=7)
        there = end_points(self.project.mechanism, fresh, self.truth)
        predicted = lc.predict(result, fresh).outputs
        found: Array = np.linalg.norm([there[q] - predicted[q] for q in there], axis=0)
        return found


@dataclass(frozen=True, eq=False)
class Outcome:
    """Rms true errors [mm] of both calibrations, and the report of loopcal's."""

    arm: Arm
    basic: float
    ours: float
    faults: tuple[str, ...]
    report: Path

    @property
    def line(self) -> str:
        """The comparison in one line."""
        basic, ours = self.shown
        times = f"{self.basic / self.ours:.0f} times better"
        return f"least squares {basic} mm, loopcal {ours} mm: {times}"

    @property
    def shown(self) -> list[str]:
        """Both errors [mm], rounded."""
        return [significant(v, 2 if v < 1.0 else 3) for v in (self.basic, self.ours)]


def main() -> None:
    """Calibrate every arm, and say which report to open."""
    print(f"True error of the end point, rms over {FRESH:,} fresh poses:\n")
    for arm in arms():
        done = calibrated(arm)
        print(f"{arm.title}\n  {done.line}")
        for fault in done.faults:
            print(f"  fault found: {fault}")
    print(f"\nOpen the last report in a browser: {done.report.relative_to(HERE.parent)}")


def arms() -> list[Arm]:
    """The examples that carry their truth, and one of them with a fault."""
    planar, six_axis = (_example(name) for name in ("planar", "six_axis"))
    return [planar, six_axis, _slipped(six_axis)]


def calibrated(arm: Arm, out: Path = RESULTS) -> Outcome:
    """Both calibrations of an arm, loopcal's written with its report."""
    basic, ours = (
        lc.calibrate(
            arm.project.mechanism,
            arm.data,
            noise=lc.load_dataset(arm.project).noise,
            fit=arm.project.fit.settings,
            method=method,
        )
        for method in ("least-squares", arm.method)
    )
    written = lc.write_result(ours, out / arm.key, title=arm.title, report=True)
    moved = written.document.change_points
    return Outcome(
        arm,
        1e3 * rms(arm.errors(basic)),
        1e3 * rms(arm.errors(ours)),
        tuple(str(point) for point in moved.found) if moved else (),
        written.folder / "report.html",
    )


def rms(errors: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(errors).mean()))


def end_points(
    mechanism: lc.Mechanism, driven: Mapping[str, Array], truth: Mapping[str, float]
) -> dict[str, Array]:
    """The true outputs [m] at these joint values."""
    exact = lc.simulate(mechanism, driven, truth=truth, noise=EXACT, seed=0).dataset
    return {q: np.array(exact[q]) for q in mechanism.outputs}


def _example(name: str) -> Arm:
    project = lc.read_project(HERE / name / "project.toml")
    data = lc.load_dataset(project).dataset
    truth = read_truth(HERE / name / "poses.truth.json", project.mechanism)
    return Arm(name, project.title or name, project, data, truth, "implicit-loop")


def _slipped(arm: Arm) -> Arm:
    """The same readings, but for a reflector that slips along tool_y after half of the poses."""
    joints = [q for q in arm.data.quantities if q not in arm.project.mechanism.outputs]
    driven = {q: np.array(arm.data[q]) for q in joints}
    after = {**arm.truth, "tool_y": arm.truth["tool_y"] + SLIP}
    before, then = (end_points(arm.project.mechanism, driven, t) for t in (arm.truth, after))
    late = np.arange(len(arm.data)) >= len(arm.data) // 2
    moved = {q: arm.data[q] + late * (then[q] - before[q]) for q in before}
    title = f"The same arm, its reflector slipping by {1e3 * SLIP:g} mm half-way"
    data = arm.data.with_readings(moved)
    return Arm("slipped_reflector", title, arm.project, data, after, "auto")


if __name__ == "__main__":
    main()
