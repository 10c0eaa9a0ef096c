"""Files of repeated readings: which columns are sensors, by project, by request, or all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from loopcal.errors import InputError, UsageError
from loopcal.files.project.project_file import Project
from loopcal.files.recognition.headers import heading
from loopcal.files.tables.readers import Column, column_labels, read_dataset, read_once
from loopcal.measurements.dataset import Dataset
from loopcal.units import unit

_IDS = ("pose", "id", "point", "nr", "no", "row")


def columns_of(text: str) -> dict[str, Column]:
    """Columns and units from "S=rad,L=rad,x=m"; a unit may be left out.

    Raises UsageError for a text that says something else, InputError for a unit that is none.
    """
    columns: dict[str, Column] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, _, stated = (word.strip() for word in part.partition("="))
        if not name or name in columns:
            raise UsageError(
                f"{part!r} in --columns {'names no column' if not name else 'is there twice'}",
                code="unknown-name",
                remedy="name each column once, for example --columns S=rad,L=rad,x=m",
            )
        if stated:
            unit(stated)
        columns[name] = Column(int(name) if name.isdigit() else name, stated or None)
    if not columns:
        raise UsageError("--columns is empty", remedy="for example --columns S=rad,L=rad,x=m")
    return columns


def read_repeats(
    files: Sequence[str | Path],
    *,
    project: Project | None = None,
    columns: str | None = None,
    pose: str | None = None,
) -> tuple[Dataset, ...]:
    """One dataset for each file; the columns of the project, those asked for, or all of numbers.

    A column of ids is no sensor: `pose`, or one called pose, id, point, nr, no or row.
    Raises InputError for files that cannot be read so, UsageError where options clash.
    """
    if project is not None and columns is not None:
        raise UsageError(
            "--project and --columns exclude each other",
            code="conflicting-keys",
            remedy="use --project alone; the project names the columns",
        )
    if project is None:
        asked = None if columns is None else columns_of(columns)
        return tuple(_series(file, asked, pose) for file in files)
    if project.data is None:
        raise InputError(
            "the project names no columns",
            code="missing-column",
            place=project.name,
            remedy='add [data] with file = "poses.csv" and the columns',
        )
    # Sds are what repeated readings are to give: their files may lack the columns of sds.
    readings_columns = {
        q: replace(c, sd_column=None, sd_unit=None, coverage=None)
        for q, c in project.data.columns.items()
    }
    how = {"pose": project.data.pose, **project.data.keywords}
    if pose is not None:
        how["pose"] = pose
    return tuple(read_dataset(file, readings_columns, **how) for file in files)


def _series(file: str | Path, columns: dict[str, Column] | None, pose: str | None) -> Dataset:
    source, stated = read_once(file), {}
    if columns is None:  # units that the headers state
        headings = {name: heading(name).unit for name in column_labels(source) if name != pose}
        stated = {name: of for name, of in headings.items() if of is not None}
    read = read_dataset(source, columns, pose=pose, units=stated)
    aside = [q for q in read.quantities if q.strip().lower() in _IDS]
    if columns is not None or pose is not None or not aside:
        return read
    kept = {q: v for q, v in read.readings.items() if q != aside[0]}
    if not kept:
        raise InputError(
            "there is no column of readings besides the ids",
            code="missing-column",
            place=read.source.name,
            remedy="name the columns: --columns S=rad,x=m",
        )
    return replace(read, readings=kept)
