"""What can be told before a fit, and from a result: checks and predictions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from loopcal.errors import InputError
from loopcal.estimation.plausible import refuse_other_units
from loopcal.files.atomic import write_files
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import load_sample
from loopcal.files.tables.writer import check_ending, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.statistics.check import Check, check
from loopcal.statistics.prediction import Prediction, predict
from loopcal.workflow.projects import named_project, project_files
from loopcal.workflow.readings import Files, new_readings
from loopcal.workflow.saved_result import read_result


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
    done = predict(read.predictor, new_readings(readings, read.inputs, read.mechanism))
    if out is not None:
        path = Path(out)
        write_files(path.parent, {path.name: table_bytes(done.columns(), path.suffix)})
    return done


def prediction_table(prediction: Prediction) -> str:
    """The table that `run_prediction` writes, as CSV text."""
    return table_bytes(prediction.columns()).decode("utf-8")
