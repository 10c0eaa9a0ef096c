"""Readings simulated as a project says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.files.atomic import write_files
from loopcal.files.project.project_file import Project
from loopcal.files.project.readings_file import readings_tables
from loopcal.files.project.stream import load_sample
from loopcal.files.result.truth_file import truth_json
from loopcal.files.tables.writer import check_ending
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import resolve_noise
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.workflow.projects import named_project

if TYPE_CHECKING:
    from loopcal.statistics.repeats import Repeats


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


# Sensor sds from repeated readings.


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """What repeated readings say of the sensors; text and document tell it, SI in the latter."""

    repeats: Repeats
    text: str
    document: dict[str, Any]


def sensor_noise(
    files: Sequence[str | Path],
    *,
    project: str | Path | None = None,
    columns: str | None = None,
    pose: str | None = None,
    function: str | None = None,
) -> SensorNoise:
    """Sensor sds from files of repeated readings, one pose each.

    project: whose columns, units and loops are used, to tell joints from instrument; columns:
    "S=rad,x=m" instead, else every column of numbers; pose: column of the ids.
    Raises InputError for what cannot be read or used, UsageError for options that clash.
    """
    from loopcal.files.tables.repeats import read_repeats
    from loopcal.statistics import repeats_summary
    from loopcal.statistics.repeats import repeated_readings
    from loopcal.statistics.separation import separate

    read = None if project is None else named_project(project, function)
    series = read_repeats(files, project=read, columns=columns, pose=pose)
    repeats = repeated_readings(series)
    if read is not None and _all_read(read, series):
        try:
            elsewhere = load_sample(read).dataset if read.fit.settings.start != "nominal" else None
        except InputError:
            elsewhere = None  # its readings are not here; the series may place the machine
        raw = {sensor.name: sensor.about_mean.sd for sensor in repeats.sensors}
        try:
            separation = separate(read.mechanism, series, raw, elsewhere=elsewhere)
        except InputError as error:
            raise error.at(read.name) from None
        repeats = replace(repeats, separation=separation)
    return SensorNoise(repeats, repeats_summary.summary(repeats), repeats_summary.document(repeats))


def _all_read(project: Project, series: Sequence[Dataset]) -> bool:
    """Whether joints can be told from instrument: machines with unread quantities cannot."""
    return all(q in one.readings for one in series for q in project.mechanism.tape.quantities)
