"""Readings to predict from: written as those were that a result was calibrated with."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from loopcal.files.project.data_entries import DataSpec, named_columns
from loopcal.files.project.project_file import data_spec
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import column_labels, read_dataset
from loopcal.files.toml.model import validated
from loopcal.files.toml.place import Place
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism

_FORMAT = ("sheet", "header", "delimiter", "decimal", "encoding", "variable")


def read_new_readings(
    path: str | Path, inputs: Mapping[str, Any], mechanism: Mechanism, *, whole: bool = False
) -> Dataset:
    """Readings of what predicts the outputs, SI, under the columns and units of a project.

    inputs: the project as result.json holds it; without one, columns are named as quantities, in
    SI; whole: read the outputs too. The pose ids and sds of readings are read where the file has
    their columns. Raises InputError as `read_dataset` does.
    """
    spec = _spec(inputs, mechanism)
    how: dict[str, Any] = {key: spec.options.get(key) for key in _FORMAT}
    content = sys.stdin.buffer.read() if str(path) == "-" else None

    def source() -> str | Path | BinaryIO:
        return path if content is None else BytesIO(content)

    there = column_labels(source(), **how)
    stated = {q for part in (spec, *spec.joins) for q in part.columns}
    parts = [named_columns(p, there, mechanism, stated) for p in (spec, *spec.joins)]
    needless = set() if whole else {*mechanism.outputs, *mechanism.predicting().unused}
    columns = {
        quantity: _without_absent_sd(column, there)
        for part in parts
        for quantity, column in part.columns.items()
        if quantity not in needless
    }
    pose = spec.options.get("pose", "pose")
    pose_column = pose if pose in there or isinstance(pose, int) else None
    return read_dataset(source(), columns, pose=pose_column, **how)


def _spec(inputs: Mapping[str, Any], mechanism: Mechanism) -> DataSpec:
    if "data" not in inputs:
        names = [*mechanism.quantities, *mechanism.known]
        return DataSpec("", {q: Column(q) for q in names if q not in mechanism.latest})
    from loopcal.files.project.project_schema import ProjectModel

    kept = {key: _infinite(inputs[key]) for key in ("data", "noise") if key in inputs}
    place = Place("result.json").at("inputs")
    undated = replace(mechanism, implied={**mechanism.implied, **mechanism.latest})
    spec = data_spec(validated(ProjectModel, {"schema": 1, **kept}, place), undated, place)
    assert spec is not None
    return spec


def result_columns(inputs: Mapping[str, Any], mechanism: Mechanism) -> dict[str, Column]:
    """Quantity -> its column and unit in the project of a result; see `read_new_readings`."""
    spec = _spec(inputs, mechanism)
    return {q: column for part in (spec, *spec.joins) for q, column in part.columns.items()}


def result_pose_column(inputs: Mapping[str, Any], mechanism: Mechanism) -> str | int:
    """The column of pose ids in the project of a result; "pose" without one."""
    found: str | int = _spec(inputs, mechanism).options.get("pose") or "pose"
    return found


def _without_absent_sd(column: Column, there: tuple[str, ...]) -> Column:
    if isinstance(column.sd_column, str) and column.sd_column not in there:
        return replace(column, sd_column=None, sd_unit=None, coverage=None)
    return column


def _infinite(value: Any) -> Any:
    """Plain data with the text "inf", which stands for infinity in result.json, as a number."""
    if isinstance(value, Mapping):
        return {key: _infinite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_infinite(inner) for inner in value]
    return math.inf if value == "inf" else value
