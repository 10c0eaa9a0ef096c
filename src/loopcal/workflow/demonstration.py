"""A simulated arm, calibrated: what loopcal does, without any file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from shlex import quote

import numpy as np

from loopcal.files.project.new_project import has_project
from loopcal.presentation.shown import with_unit
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.statistics.prediction import predict
from loopcal.workflow.calibration import Calibration, Request, run_calibration
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import named_project, new_project


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A calibration of a machine whose truth is known.

    nominal: rms distance [m] of the nominal machine from the readings, placed as well as can be;
    after: of the calibrated end point from the true one, at poses that were not measured.
    """

    project: Path
    calibration: Calibration
    nominal: float
    after: float

    @property
    def report(self) -> Path:
        """The page to open."""
        return self.calibration.written.folder / "report.html"

    def __str__(self) -> str:
        verdict = self.calibration.typed.verdict
        assert verdict is not None
        nominal, after = (with_unit(v, "m", 2) for v in (self.nominal, self.after))
        project, result = quote(str(self.project)), quote(str(self.report.parent))
        return "\n".join(
            [
                "A six-axis arm, simulated: its dimensions differ from the drawing, and encoders",
                "and tracker err. loopcal calibrated it from 100 poses and says:",
                "",
                *verdict.lines(),
                "",
                f"By its drawing the arm misses the readings by {nominal} rms. Only a simulation",
                "knows the truth: at 100 poses that were not measured, and exact joint angles, the",
                f"end point of the calibrated arm is off by {after} rms.",
                "",
                f"report: {self.report}",
                "next:",
                f"  loopcal calibrate {project} --full",
                f"  loopcal export {result} --to dh",
                "  loopcal init joints.csv tracker.csv --urdf robot.urdf --run   (your own files)",
            ]
        )


def run_demonstration(folder: str | Path) -> Demonstration:
    """Write a project, simulate its readings, and calibrate. Raises InputError where files are in
    the way."""
    project = Path(folder) / "project.toml"
    if not has_project(str(folder)):
        new_project(str(folder), "serial")
    made = run_simulation(project, out=project.with_name("poses.csv"), seed=1).simulation
    done = run_calibration(project, Request(report=True))
    accuracy = done.written.document.accuracy
    assert accuracy is not None
    assert accuracy.nominal is not None
    return Demonstration(project, done, accuracy.nominal.rms, _true_error(project, made, done))


def _true_error(project: Path, made: Simulation, done: Calibration) -> float:
    """Rms distance [m] of predicted from true end points at fresh poses."""
    read = named_project(project, None)
    simulation = read.simulation
    assert simulation is not None
    fresh = simulation.driven(made.seed + 1)
    exact = simulate(read.mechanism, fresh, noise={"*": 0.0}, seed=0, truth=made.parameters).dataset
    predicted = predict(done.result, fresh).outputs
    apart = [exact[q] - predicted[q] for q in read.mechanism.outputs]
    return float(np.sqrt(np.sum(np.square(apart), axis=0).mean()))
