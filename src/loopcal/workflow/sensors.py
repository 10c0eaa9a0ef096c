"""Sensor sds from repeated readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import load_sample
from loopcal.measurements.dataset import Dataset

if TYPE_CHECKING:
    from loopcal.statistics.repeats import Repeats

from loopcal.workflow.projects import named_project


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
    from loopcal.statistics.repeats import repeated_readings, with_separation
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
            apart = separate(read.mechanism, series, raw, elsewhere=elsewhere)
        except InputError as error:
            raise error.at(read.name) from None
        repeats = with_separation(repeats, apart)
    return SensorNoise(repeats, repeats_summary.summary(repeats), repeats_summary.document(repeats))


def _all_read(project: Project, series: Sequence[Dataset]) -> bool:
    """Whether joints can be told from instrument: machines with unread quantities cannot."""
    return all(q in one.readings for one in series for q in project.mechanism.tape.quantities)
