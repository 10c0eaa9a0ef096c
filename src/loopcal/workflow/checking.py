"""The commands check, predict, verify, simulate and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.plausible import refuse_other_units
from loopcal.files.atomic import Data, write_all, write_files
from loopcal.files.project.project_file import Project
from loopcal.files.project.readings_file import readings_tables
from loopcal.files.project.stream import load_sample
from loopcal.files.result.deployed import VERIFICATION, note_deployed, project_beside
from loopcal.files.result.truth_file import truth_json
from loopcal.files.tables.writer import check_ending, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, resolve_noise
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.statistics.check import Check, check
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.replacing import freed, mounted
from loopcal.statistics.verification import verify
from loopcal.statistics.verified import Verification
from loopcal.workflow.keeping import Keeper, Writer
from loopcal.workflow.projects import named_project, project_files, refuse_tolerance
from loopcal.workflow.readings import (
    Files,
    first_of,
    later_readings,
    new_readings,
    refuse_other_angles,
)
from loopcal.workflow.saved_result import read_result

if TYPE_CHECKING:
    from loopcal.statistics.repeats import Repeats


@dataclass(frozen=True, eq=False)
class Checked:
    """A project that was looked at before any fit; warnings: about its readings.

    data, noise: the readings of it that were looked at, and their sds, None where they are not
    needed.
    """

    check: Check
    project: Project
    data: Dataset
    noise: Noise | None
    warnings: tuple[str, ...]


def run_check(project: str | Path, *, function: str | None = None) -> Checked:
    """What a project's readings can determine; nothing is fitted and nothing written.

    Of a stream some are looked at, as a warning says.
    Raises InputError for what cannot be used.
    """
    read = named_project(project, function)
    loaded = load_sample(read)
    noise: Noise | None = loaded.noise
    # A method without noise needs no sds; stated ones are used where they are there.
    if read.fit.settings.method.exact and not loaded.noise.entries:
        noise = None
    try:
        refuse_other_units(read.mechanism, loaded.dataset, noise)
        done = check(read.mechanism, loaded.dataset, noise=noise, start=read.fit.settings.start)
    except InputError as error:
        raise error.at(read.name) from None
    done = replace(done, files=project_files(read, function))
    warnings = tuple(str(warning) for warning in loaded.warnings)
    return Checked(done, read, loaded.dataset, noise, warnings)


def run_prediction(
    result: str | Path, readings: Files, *, out: str | Path | None, function: str | None = None
) -> Prediction:
    """Predict outputs from a result on the disk and readings in the columns of its project.

    out: a table to write (.csv, .tsv or .parquet). Raises InputError for what cannot be used.
    """
    if out is not None:
        # Refused ahead of the work, not after it.
        check_ending(out)
    read = read_result(result, mechanism=function)
    made = new_readings(readings, read.inputs, read.mechanism)
    refuse_other_angles(made, read)
    done = predict(read.predictor, made)
    if out is not None:
        path = Path(out)
        write_files(path.parent, {path.name: table_bytes(done.columns(), path.suffix)})
    return done


def prediction_table(prediction: Prediction) -> str:
    """The table that `run_prediction` writes, as CSV text."""
    return table_bytes(prediction.columns()).decode("utf-8")


def run_verification(
    result: str | Path,
    readings: Files,
    *,
    remounted: bool = False,
    anew: Sequence[str] = (),
    tolerance: float | None = None,
    out: str | Path | None = None,
    keeper: Keeper | None = None,
    function: str | None = None,
) -> Verification:
    """Check a result against readings in the columns of its project, or those of another result.

    readings: one file, or several in the layout of the project's first ones;
    remounted: everything that instruments look at; anew: further instruments, targets or
    parameters; tolerance: [m]; out: file of a page with figures; keeper: keeps this too.
    Raises InputError for what cannot be used.
    """
    if keeper is not None:
        keeper.refuse()
    read = read_result(result, mechanism=function)
    refuse_tolerance(read.mechanism, tolerance)
    changed = (*mounted(read.mechanism, remounted), *anew)
    freed(read.mechanism, changed)  # raises for a name that is not there
    data, first = later_readings(read, readings, None, whole=True), first_of(readings)
    try:
        verification = verify(read.calibrated, data, remounted=changed, tolerance=tolerance)
    except InputError as error:
        raise error.at(str(first)) from None
    every = [readings] if isinstance(readings, str | Path) else readings
    typed = {"result": str(result), **project_beside(read.path.parent)}
    day = [str(file) for file in every]
    verification = replace(verification, files={**typed, "readings": day})
    files: dict[Path, Data] = {}
    if out is not None:
        from loopcal.report.verification_page import verification_html

        names = f"{read.path.parent.name}, {Path(first).name}"
        files[Path(out)] = verification_html(verification, read.mechanism.name, names)
    write: Writer = write_all
    if keeper is not None:
        write = keeper.of_verification(verification, result, first, data.source.measured)
    write(files)
    if keeper is not None:
        keeper.note(result)
    name = Path(first)
    document = {"readings": name.name, **verification.document()}
    note_deployed(read.path, VERIFICATION, name.stem, document)
    return verification


# Readings simulated as a project says.


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
    """Whether all quantities are read. Otherwise joints and instrument cannot be told apart."""
    return all(q in one.readings for one in series for q in project.mechanism.tape.quantities)
