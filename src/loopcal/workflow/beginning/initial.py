"""A finished project from files of readings and a description of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, UsageError
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.mounted import Mounted
from loopcal.estimation.problem.problem import build_problem
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.paths import relative
from loopcal.files.project.new_project import refuse_existing, write_new_files
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.recognition.fields import source_of
from loopcal.files.recognition.joins import Fields, joined
from loopcal.files.recognition.layouts import layouts
from loopcal.files.recognition.project_text import project_text
from loopcal.files.recognition.robots import Robot, dh_robot, typed_robot, urdf_robot
from loopcal.files.tables.writer import table_bytes
from loopcal.measurements.checks import check_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import rounding_sd
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import measured_points
from loopcal.presentation.shown import in_unit, unit_shown, with_unit
from loopcal.presentation.text_table import columns as in_columns
from loopcal.statistics.check import check
from loopcal.units import unit
from loopcal.workflow.beginning.searching import PLAUSIBLE, Machine
from loopcal.workflow.beginning.stating import READINGS, Reading, Statement, stated
from loopcal.workflow.beginning.understanding import Ask, understood

Array = NDArray[np.float64]
PROJECT = "project.toml"
DRAWN = {"length": 5e-3, "angle": 5e-3}
"""A drawing states lengths [m] and angles [rad] better than this."""
USUAL = 20e-3
"""A nominal machine is nearer to its readings than this [m]."""
_ROWS, _WORST = 5, 5


@dataclass(frozen=True)
class RobotFile:
    """What describes the robot: a URDF, a table of Denavit-Hartenberg parameters, or a type.

    base, tip: links of the URDF.
    """

    urdf: str | Path | None = None
    dh: str | Path | None = None
    machine: str | None = None
    base: str | None = None
    tip: str | None = None


@dataclass(frozen=True, eq=False)
class InitialProject:
    """A project as it was understood from files, ready to be calibrated.

    mechanism, dataset, noise: for `calibrate`; text: of the project file; tables: further files
    beside it; fits: what the nominal machine misses, by instrument; remarks: what was inferred,
    and why; written: the files on the disk, empty where none were asked for.
    """

    mechanism: Mechanism
    dataset: Dataset
    noise: Noise
    text: str
    tables: Mapping[str, bytes]
    fits: Mapping[str, Mounted]
    remarks: tuple[str, ...]
    written: tuple[Path, ...] = ()

    @property
    def rms(self) -> float:
        """Rms [m] by which the placed nominal machine misses the first instrument's readings,
        over nine tenths of the poses."""
        return next(iter(self.fits.values())).rms

    @property
    def worst(self) -> tuple[str, ...]:
        """Ids of the poses that the placed nominal machine misses most."""
        order = np.argsort(-np.nan_to_num(next(iter(self.fits.values())).shares))
        return tuple(self.dataset.poses[i] for i in order[:_WORST])

    @property
    def command(self) -> str:
        """What to type next."""
        project = self.written[0].as_posix() if self.written else PROJECT
        return f"loopcal calibrate {quote(project)}"

    def __str__(self) -> str:
        parts = [f"{len(self.dataset)} poses as understood, in mm and deg; the first {_ROWS}:"]
        parts += [*in_columns(self._rows()), ""]
        parts += [*(f"- {words}" for words in self.remarks), ""]
        for name, fit in self.fits.items():
            turned = ""
            if fit.turned is not None:
                angle = float(np.sqrt(np.nanmean(np.square(fit.turned))))
                turned = f" and {with_unit(angle, 'rad')}"
            parts.append(
                f"{name}: the nominal machine, placed by alignment, misses the readings by "
                f"{with_unit(fit.rms, 'm')}{turned} rms (without the worst tenth of the poses)"
            )
        parts += ["worst poses: " + ", ".join(self._worst_words())]
        if self.written:
            parts += ["", f"written: {', '.join(map(str, self.written))}"]
            parts += ["next:", f"  {self.command}"]
        return "\n".join(parts)

    def _rows(self) -> list[list[str]]:
        units = {**self.mechanism.quantities, **self.mechanism.known}
        names = list(self.dataset.readings)
        head = ["pose", *(f"{n} [{unit_shown(units[n])}]" if units[n] != "1" else n for n in names)]
        rows = [head]
        for i in range(min(_ROWS, len(self.dataset))):
            values = [in_unit(float(self.dataset[n][i]), units[n]) for n in names]
            rows.append([self.dataset.poses[i], *(_shown(v) for v in values)])
        return rows

    def _worst_words(self) -> list[str]:
        fit = next(iter(self.fits.values()))
        where = {pose: i for i, pose in enumerate(self.dataset.poses)}
        return [f"{pose} ({with_unit(float(fit.away[where[pose]]), 'm')})" for pose in self.worst]


def _shown(value: float) -> str:
    return "" if np.isnan(value) else f"{value:z.4f}".rstrip("0").rstrip(".")


def init(
    *readings: Any,
    urdf: str | Path | None = None,
    dh: str | Path | None = None,
    machine: str | None = None,
    base: str | None = None,
    tip: str | None = None,
    out: str | Path | None = None,
    sheet: str | None = None,
) -> InitialProject:
    """Recognise readings and a robot, and make a finished project of them.

    readings: paths, or Datasets, dicts of arrays and DataFrames, joined by pose ids or by row
    order. One of urdf, dh (a table a, d, alpha, theta) and machine (a type with nominal values)
    describes the robot; base, tip: links of the URDF, by default the only ones that fit. Units,
    orders and directions that no header states are those with which the placed nominal machine
    fits clearly best. out: the folder to write into, by default none; sheet: of a workbook, or the
    variable of a MATLAB file, by default the one with by far the most numbers.

    Raises InputError where something remains open, with what is possible, and where files are in
    the way.
    """
    robot = RobotFile(urdf, dh, machine, base, tip)
    return initial_project(readings, robot, out=out, sheet=sheet)


def initial_project(
    readings: Sequence[Any],
    robot: RobotFile,
    *,
    out: str | Path | None,
    sheet: str | None = None,
    ask: Ask | None = None,
) -> InitialProject:
    """`init`, where a user can be asked what remains open."""
    if not readings:
        raise UsageError("no readings are named", remedy="name one or several files of readings")
    folder = Path() if out is None else Path(out)
    if out is not None:
        from_files = all(isinstance(given, str | Path) for given in readings)
        refuse_existing(folder, (PROJECT,) if from_files else (PROJECT, READINGS))
    sources = [source_of(given, i, sheet) for i, given in enumerate(readings)]
    fields = joined(sources)
    made = _robot(robot, fields, folder)
    machine = _machine(made, fields, folder)
    found = understood(machine, _layouts(made, fields), fields, ask)
    statement = stated(made, machine, fields, found, folder)
    project = _read(statement, folder)
    dataset = _dataset(fields, statement)
    odd = (*_odd(project, dataset), *_far_off(statement.fits))
    if found.share > PLAUSIBLE:
        _refuse_faults(project.mechanism, dataset)
    weak = _weakest(project, dataset)
    if weak:
        statement = statement.remarked("mechanism", weak)
    tables = {READINGS: _table(fields, statement)} if statement.converted else {}
    remarks = tuple(source.remark for source in sources if source.remark)
    remarks += tuple(row for rows in statement.parts.remarks.values() for row in rows) + odd
    text = project_text(statement.parts)
    done = InitialProject(
        project.mechanism, dataset, project.noise.noise(), text, tables, statement.fits, remarks
    )
    if out is None:
        return done
    files = {PROJECT: text.encode("utf-8"), **tables}
    return replace(done, written=write_new_files(folder, files))


def _robot(robot: RobotFile, fields: Fields, folder: Path) -> Robot:
    named = [k for k in ("urdf", "dh", "machine") if getattr(robot, k) is not None]
    if len(named) != 1:
        raise UsageError(
            f"{' and '.join(named) or 'nothing'} describes the robot",
            remedy="name exactly one of --urdf FILE, --dh FILE and --machine TYPE",
        )
    if robot.urdf is not None:
        path = Path(robot.urdf)
        return urdf_robot(path, relative(path, folder), fields.fields, robot.base, robot.tip)
    if robot.base is not None or robot.tip is not None:
        raise UsageError("base and tip are links of a URDF", remedy="remove them, or name --urdf")
    if robot.dh is not None:
        return dh_robot(Path(robot.dh), fields.fields)
    return typed_robot(str(robot.machine))


def _machine(robot: Robot, fields: Fields, folder: Path) -> Machine:
    mechanism = mechanism_from_data(dict(robot.table), str(folder / PROJECT))
    joints = tuple(dict.fromkeys(step.joint for step in mechanism.chain if step.joint))
    return Machine(mechanism, joints)


def _layouts(robot: Robot, fields: Fields) -> Any:
    return layouts(fields.fields, robot.joints, robot.names)


def _table(fields: Fields, statement: Statement) -> bytes:
    """The readings in SI units, for the file beside the project."""
    return table_bytes(
        {"pose": fields.poses, **{n: r.values for n, r in statement.readings.items()}}
    )


def _read(statement: Statement, folder: Path) -> Project:
    """The project as `calibrate` will read it."""
    return read_project(folder / PROJECT, text=project_text(statement.parts))


def _dataset(fields: Fields, statement: Statement) -> Dataset:
    """The readings as values."""

    def sds(reading: Reading) -> Array:
        assert reading.sds is not None
        factor = unit(reading.sds.unit or reading.unit).factor
        step = rounding_sd(reading.sds.resolution())
        return factor * np.fmax(reading.sds.values, step)

    return Dataset.from_arrays(
        {name: r.values for name, r in statement.readings.items()},
        units={name: r.si for name, r in statement.readings.items()},
        poses=fields.poses,
        sds={name: sds(r) for name, r in statement.readings.items() if r.sds is not None},
    )


def _odd(project: Project, dataset: Dataset) -> tuple[str, ...]:
    """What is odd about the readings. Raises InputError for zeros of a lost reflector."""
    mechanism = project.mechanism
    own = {**mechanism.quantities, **mechanism.known}
    told = check_dataset(dataset, own, points=measured_points(mechanism))
    return tuple(str(warning) for warning in told)


def _far_off(fits: Mapping[str, Mounted]) -> tuple[str, ...]:
    """That a nominal machine is further off than robots are."""
    return tuple(
        f"{name}: the nominal machine misses the readings by {with_unit(fit.rms, 'm')}, and a few "
        "mm are usual. Check the robot's description, the units and the rows."
        for name, fit in fits.items()
        if fit.rms > USUAL
    )


def _weakest(project: Project, dataset: Dataset) -> str:
    """What the poses determine worse than a drawing does, in words; empty where nothing is."""
    made = check(project.mechanism, dataset, noise=project.noise.noise())
    kinds = project.mechanism.kinds
    worst, found = 1.0, ""
    for parameter in project.mechanism.parameters:
        sd = made.expected_sd[parameter.name]
        limit = DRAWN.get(kinds[parameter.name])
        if sd is not None and limit is not None and sd > worst * limit:
            worst = sd / limit
            size = with_unit(sd, parameter.unit, 2) if sd < 1.0 else "unknown"
            found = f"sd of {parameter.name}: {size}"
    return found and (
        f"These poses determine the machine worse than a drawing does ({found}). The calibration "
        "learns how near lengths and angles are to the drawing, and poses that it did not use "
        "choose whether that serves. Stating where tool or target is mounted helps most."
    )


def _refuse_faults(mechanism: Mechanism, dataset: Dataset) -> None:
    """Raise InputError for a fault of the whole file that no unit explains."""
    faults = column_faults(build_problem(mechanism, dataset, None))
    if faults:
        raise InputError(
            f"the readings do not belong to this machine: {faults[0].words}",
            code="implausible-readings",
            remedy=_REMEDIES.get(faults[0].code, "correct the file or the robot's description"),
        )


_REMEDIES = {
    "reversed": "add a column direction to the table of the robot, -1 for this joint; or correct "
    "the sign in the file",
    "exchanged": "exchange the headers of these columns",
    "rows-shifted": "give joints and instrument the same pose ids",
    "rows-shuffled": "give joints and instrument the same pose ids",
}
