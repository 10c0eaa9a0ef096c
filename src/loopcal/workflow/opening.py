"""What people type first: open what a path holds, and see a result."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.files.machines.urdf import urdf_machine
from loopcal.files.recognition.robots import robot_link, urdf_robot
from loopcal.mechanisms.machine import Machine
from loopcal.workflow.resolved import described, result_of
from loopcal.workflow.saved_result import read_result


def load(path: str | Path) -> Any:
    """What a path holds: a `SavedResult` of a result's folder or result.json, a `Machine` of a
    URDF, a `Project` or `Mechanism` of a TOML file.

    Raises InputError for anything else, with what reads it.
    """
    if not isinstance(path, str | PathLike):
        raise InputError(
            f"{type(path).__name__} {path!r:.40} is no path",
            code="invalid-value",
            remedy="give the folder of a result, or the path of a URDF or a project file",
        )
    path = Path(path)
    if path.suffix == ".urdf":
        return load_urdf(path)
    return described(path) if path.suffix == ".toml" else read_result(path)


def load_urdf(path: str | Path, base: str | None = None, tip: str | None = None) -> Machine:
    """The machine of a URDF: `fk(q)` says where it is; `assemble` and `calibrate(readings, urdf=
    path)` calibrate it.

    base, tip: links. By default the tip is the link on which tools are mounted (tool0, flange),
    else that of the chain with the most moving joints. Raises InputError where several chains have
    as many, with their links, and for what is no URDF.
    """
    tip = robot_link(Path(path)) if base is None and tip is None else tip
    table = urdf_robot(Path(path), str(path), (), base, tip).table
    return urdf_machine(path, table["base"], table["tip"])


def plot(result: Any) -> Any:
    """Computed minus measured outputs of a result pose by pose, as a plotly figure.

    `result.plot()` is the same; `result.plot` has the other figures of the report.
    """
    return result_of(result).plot()
