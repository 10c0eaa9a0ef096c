"""What `init` is given beside the readings: the robot, its joints, columns that take no part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypedDict

from loopcal.errors import UsageError, listed, unknown_name
from loopcal.files.cameras.folder import files_of
from loopcal.files.recognition.dh_table import is_dh
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.joint_sets import usual_joints
from loopcal.files.recognition.layouts import instruments


@dataclass(frozen=True)
class RobotFile:
    """What describes the robot: a URDF, a table of Denavit-Hartenberg parameters, or a type.

    base, tip: links of the URDF; joints: the columns of its joints, or expressions of them, divided
    by commas; leave_out: names of columns that take no part, with * for any letters; infer_units:
    whether units are taken from no header; exclude: ids of poses that take no part, or their
    numbers from 1.
    """

    urdf: str | Path | None = None
    dh: str | Path | None = None
    machine: str | None = None
    base: str | None = None
    tip: str | None = None
    joints: str | None = None
    leave_out: str | None = None
    observe: Sequence[str] = ()
    infer_units: bool = False
    exclude: str | None = None

    @property
    def excluded(self) -> tuple[str, ...]:
        """The ids of `exclude`."""
        return tuple(filter(None, (part.strip() for part in (self.exclude or "").split(","))))


class InitOptions(TypedDict, total=False):
    """What `init` is given beside the files: `RobotFile` says what each means."""

    base: str | None
    tip: str | None
    joints: str | None
    leave_out: str | None
    observe: Sequence[str]
    infer_units: bool
    exclude: str | None


def among(readings: Sequence[Any], robot: RobotFile) -> tuple[RobotFile, Sequence[Any]]:
    """The one file among the readings that describes a robot, and the others."""
    paths = files_of(readings)
    urdfs = [path for path in paths if path.suffix == ".urdf"]
    if len(urdfs) == 1:
        return replace(robot, urdf=urdfs[0]), [r for r in readings if str(r) != str(urdfs[0])]
    tables = [path for path in paths if is_dh(path)]
    if len(tables) == 1:
        return replace(robot, dh=tables[0]), [r for r in readings if str(r) != str(tables[0])]
    return robot, readings


_SEEN = {
    "pose": "poses of a target",
    "point": "points of a target",
    "planar": "points in a plane",
    "length": "lengths",
    "spherical": "range and angles of a target",
}
DH_HEADER = "joint,a [mm],d [mm],alpha [deg],theta [deg]"
"""Of a table of the robot, a row per joint."""


def undescribed(named: Sequence[str], fields: Sequence[Field]) -> UsageError:
    """The error where not one file describes the robot; named: those that do; fields: of the
    readings."""
    remedy = "name exactly one of --urdf FILE, --dh FILE and --machine TYPE"
    if named:
        return UsageError(f"{' and '.join(named)} describes the robot", remedy=remedy)
    joints = usual_joints(fields)
    seen = instruments([f for f in fields if f not in joints])
    parts = [f"{len(joints)} joints ({listed(f.label for f in joints)})"] if joints else []
    parts += [
        f"{_SEEN[s.kind]} ({listed(f.label for f in (*s.position, *s.turned))})" for s in seen
    ]
    stated = f"the readings hold {' and '.join(parts)}, but " if parts else ""
    return UsageError(
        f"{stated}nothing describes the robot",
        remedy=f"{remedy}. dh.csv has a row per joint below the header {DH_HEADER}, theta where "
        "the joint reads 0",
    ).offering("ROBOT")


def used(fields: Fields, robot: RobotFile) -> Fields:
    """Without the columns that are left out, and without units that are to be inferred."""
    kept = list(fields.fields)
    if robot.infer_units:
        kept = [f.without_unit() for f in kept]
    for name in [part.strip() for part in (robot.leave_out or "").split(",") if part.strip()]:
        # Brackets of a unit are no set of letters where the whole name is meant.
        gone = [f for f in kept if f.label == name]
        gone = gone or [f for f in kept if fnmatchcase(f.label, name)]
        if not gone:
            raise unknown_name(
                f"{name!r} is no column", name, [f.label for f in kept], "--leave-out"
            )
        kept = [f for f in kept if f not in gone]
    return replace(fields, fields=tuple(kept))
