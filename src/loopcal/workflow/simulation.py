"""Readings simulated as a project says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopcal.errors import InputError
from loopcal.files.atomic import write_files
from loopcal.files.project.project_file import Project
from loopcal.files.project.readings_file import readings_tables
from loopcal.files.result.truth_file import truth_json
from loopcal.files.tables.writer import check_ending
from loopcal.measurements.noise import resolve_noise
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.workflow.projects import named_project


@dataclass(frozen=True, eq=False)
class Simulated:
    """Readings that were simulated and written, their truth beside them."""

    simulation: Simulation
    file: Path
    truth_file: Path


def run_simulation(
    project: str | Path, *, out: str | Path, seed: int, function: str | None = None
) -> Simulated:
    """Make readings as the [simulation] of a project says, with the noise of a seed.

    Writes the readings to `out` (.csv, .tsv or .parquet) under the column names and units in
    which the project reads them. The truth comes beside them: NAME.truth.json for NAME.csv.
    Raises InputError for what cannot be used.
    """
    out = Path(out)
    check_ending(out)
    read = named_project(project, function)
    made = simulated(read, seed)
    assert read.simulation is not None
    noise = read.simulation.noise.noise()
    quantities = read.mechanism.tape.quantities
    resolved = resolve_noise(noise, made.dataset, quantities, read.mechanism.quantity_group)
    shape = (len(quantities), len(made.dataset))
    sds = dict(zip(quantities, np.broadcast_to(resolved.sd, shape), strict=True))
    truth_file = out.with_name(f"{out.stem}.truth.json")
    tables = readings_tables(made.dataset, read.data, sds, out)
    write_files(out.parent, {**tables, truth_file.name: truth_json(made, read.mechanism, tables)})
    return Simulated(made, out, truth_file)


def simulated(project: Project, seed: int) -> Simulation:
    """Readings as the [simulation] of a project says. Raises InputError where there is none."""
    if project.simulation is None:
        raise InputError(
            "the project has no simulation",
            code="missing-key",
            place=project.name,
            remedy="add [simulation.ranges], one line per driven quantity",
        )
    project.simulation.refuse_missing()
    try:
        return simulate(
            project.mechanism,
            project.simulation.driven(seed),
            noise=project.simulation.noise.noise(),
            seed=seed,
            truth=project.simulation.machine(project.mechanism.parameters, seed),
        )
    except InputError as error:
        raise error.at(project.name) from None
