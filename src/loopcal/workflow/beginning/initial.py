"""A finished project from files of readings and a description of the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from loopcal.document.aliases import of_project
from loopcal.errors import InputError, UsageError
from loopcal.estimation.faults.search import HELD, column_faults
from loopcal.estimation.mounted import Mounted
from loopcal.estimation.problem.problem import build_problem
from loopcal.files.atomic import write_files
from loopcal.files.cameras.folder import are_images, files_of, tables_of
from loopcal.files.machines.trees import tree_table
from loopcal.files.outputs import carried_over, one_command, refuse_foreign, relative, sealed
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.recognition.converting import dataset_of
from loopcal.files.recognition.fields import Field, Source
from loopcal.files.recognition.joins import Fields, joined
from loopcal.files.recognition.joint_sets import joint_columns, turned_columns
from loopcal.files.recognition.layouts import Layout, layouts
from loopcal.files.recognition.logs import at_rest
from loopcal.files.recognition.robots import (
    Robot,
    dh_robot,
    joints_of,
    tips_before,
    typed_robot,
    urdf_robot,
)
from loopcal.files.recognition.rows import observations
from loopcal.files.recognition.sources import refuse_unknown, sources_of_all
from loopcal.files.tables.writer import table_bytes
from loopcal.measurements.checks import check_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import measured_points
from loopcal.presentation.shown import columns as in_columns
from loopcal.presentation.shown import unit_shown, with_unit
from loopcal.units import from_si
from loopcal.workflow.beginning.aligning import aligned
from loopcal.workflow.beginning.begun import PROJECT, READINGS, Begun, before_readings
from loopcal.workflow.beginning.counts import counted
from loopcal.workflow.beginning.delays import Delay, delays
from loopcal.workflow.beginning.from_images import FromImages, from_images, on_another_link
from loopcal.workflow.beginning.from_samples import from_samples, samples_of
from loopcal.workflow.beginning.from_tree import dh_table, from_tree, urdf_table
from loopcal.workflow.beginning.images_project import CORNERS
from loopcal.workflow.beginning.misfits import left_out
from loopcal.workflow.beginning.misplaced_rows import held_readings
from loopcal.workflow.beginning.ratios import misstated
from loopcal.workflow.beginning.readable import in_the_better_convention, readable
from loopcal.workflow.beginning.robot_file import (
    InitOptions,
    RobotFile,
    among,
    undescribed,
    used,
)
from loopcal.workflow.beginning.searching import (
    PLAUSIBLE,
    Machine,
    machine_of,
)
from loopcal.workflow.beginning.stating import First, Statement, stated
from loopcal.workflow.beginning.understanding import Ask, understood
from loopcal.workflow.beginning.weakest import left_open

# The nominal machine is good to millimetres (docs/decisions/0056).
USUAL = 20e-3
"""A nominal machine is nearer to its readings than this [m]."""
_ROWS, _WORST = 5, 5
_IMAGES = 3
"""Fewer images calibrate no camera."""


@dataclass(frozen=True, eq=False)
class InitialProject:
    """A project as it was understood from files, ready to be calibrated.

    mechanism, dataset, noise: for `calibrate`; text: of the project file, inputs: the same as data;
    tables: further files beside it; fits: what the nominal machine misses, by instrument; remarks:
    what was inferred, and why; delays: of instruments that were recorded by time;
    words: what was read, where poses are images; written: the files on the disk, empty where none
    were asked for.
    """

    mechanism: Mechanism
    dataset: Dataset
    noise: Noise
    text: str
    inputs: Mapping[str, Any]
    tables: Mapping[str, bytes]
    fits: Mapping[str, Mounted]
    remarks: tuple[str, ...]
    delays: tuple[Delay, ...] = ()
    words: str = ""
    written: tuple[Path, ...] = ()

    @property
    def rms(self) -> float:
        """Rms [m] by which the placed nominal machine misses the first instrument's readings,
        over nine tenths of the poses."""
        return next(iter(self.fits.values())).rms

    @property
    def worst(self) -> tuple[str, ...]:
        """Ids of the poses that the placed nominal machine misses most."""
        return tuple(self.dataset.poses[i] for i in self._worst_rows())

    @property
    def command(self) -> str:
        """What to type next."""
        project = self.written[0].as_posix() if self.written else PROJECT
        return f"loopcal {'calibrate' if self.inputs.get('data') else 'plan'} {quote(project)}"

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            return of_project(self, name)

    def __str__(self) -> str:
        parts = [self.words, ""] if self.words else self._first_rows()
        parts += [self.inferred]
        if self.written:
            parts += ["next:", f"  {self.command}"]
        return "\n".join(parts)

    @property
    def inferred(self) -> str:
        """What was inferred, how far the drawing is off, and the files that were written."""
        parts = [*(f"- {words}" for words in self.remarks), ""]
        for name, fit in self.fits.items():
            turned = ""
            if fit.turned is not None:
                angle = float(np.sqrt(np.nanmean(np.square(fit.turned))))
                turned = f" and {with_unit(angle, 'rad')}"
            parts.append(
                f"{name}: the nominal machine, placed by alignment, misses the readings by "
                f"{with_unit(fit.rms, 'm')}{turned} rms (without the worst tenth of the poses)"
            )
        if self.fits:
            parts += ["worst poses: " + ", ".join(self._worst_words())]
        if self.written:
            parts += ["", f"written: {', '.join(map(str, self.written))}"]
        return "\n".join(parts)

    def _first_rows(self) -> list[str]:
        head = f"{len(self.dataset)} poses as understood, in mm and deg; the first {_ROWS}:"
        return [head, *in_columns(self._rows()), ""]

    def __repr__(self) -> str:
        if self.words:
            return f"<InitialProject: {self.words}>"
        miss = ", ".join(f"{name} {with_unit(f.rms, 'm')}" for name, f in self.fits.items())
        return f"<InitialProject: {len(self.dataset)} poses, nominal machine misses {miss}>"

    def _repr_html_(self) -> str:
        from html import escape

        from loopcal.presentation.html import table

        head, *rows = self._rows()
        remarks = "".join(f"<li>{escape(words)}</li>" for words in self.remarks)
        return f"{table(head, rows)}<ul>{remarks}</ul><p>{escape(repr(self)[1:-1])}</p>"

    def _rows(self) -> list[list[str]]:
        units = {**self.mechanism.quantities, **self.mechanism.pose_constants}
        names = list(self.dataset.readings)
        # Temperatures of readings are values, not differences.
        shown = {n: "degC" if units[n] == "K" else unit_shown(units[n]) for n in names}
        head = ["pose", *(f"{n} [{u}]" if u != "1" else n for n, u in shown.items())]
        rows = [head]
        for i in range(min(_ROWS, len(self.dataset))):
            values = [float(from_si(self.dataset[n][i], u)) for n, u in shown.items()]
            rows.append([self.dataset.poses[i], *(_shown(v) for v in values)])
        return rows

    def _worst_words(self) -> list[str]:
        fit, poses = next(iter(self.fits.values())), self.dataset.poses
        return [f"{poses[i]} ({with_unit(float(fit.away[i]), 'm')})" for i in self._worst_rows()]

    def _worst_rows(self) -> list[int]:
        order = np.argsort(-np.nan_to_num(next(iter(self.fits.values())).shares))
        rows: list[int] = order[:_WORST].tolist()
        return rows


def _shown(value: float) -> str:
    return "" if np.isnan(value) else f"{value:z.4f}".rstrip("0").rstrip(".")


@one_command
def init(
    *readings: Any,
    urdf: str | Path | None = None,
    dh: str | Path | None = None,
    machine: str | None = None,
    out: str | Path | None = None,
    sheet: str | None = None,
    force: bool = False,
    **options: Unpack[InitOptions],
) -> InitialProject:
    """Recognise readings and a robot, and make a finished project of them.

    readings: paths, or Datasets, dicts of arrays, DataFrames and arrays (N, k), joined by pose ids
    or by row order. One of urdf, dh (a table a, d, alpha, theta) and machine (a type with nominal
    values) describes the robot; base, tip: links of the URDF, by default the only ones that fit.
    Units, orders and directions that no header states are those with which the placed nominal
    machine fits clearly best. Without readings it is a project to plan from. out: the folder to
    write into, by default none; sheet: of a workbook, or the variable of a MATLAB file, by default
    the one with by far the most numbers; force: whether a project that was changed is replaced,
    of which a backup is kept. joints: the columns of the joints in the machine's order,
    as "J1,-J2,J3+J2,J4*0.001" where they count
    otherwise; leave_out: columns that take no part, as "*_soll,v*"; exclude: poses that take none,
    as "P004,P012"; infer_units: take none from headers.

    Raises InputError where something remains open, with what is possible, and where files are in
    the way.
    """
    for name, file in (("urdf", urdf), ("dh", dh), ("machine", machine)):
        if not isinstance(file, str | Path | None):
            raise InputError(
                f"{name} is a {type(file).__name__}, and the path of a file is needed",
                code="invalid-value",
                remedy="write the table with units in its header, such as a [mm], alpha [deg], "
                "d [mm], theta [deg]: table.to_csv('dh.csv'), then dh='dh.csv'"
                if name == "dh"
                else f"name the file, such as {name}='robot.urdf'",
            )
    robot = RobotFile(urdf, dh, machine, **options)
    # A list of paths is these files.
    listed = [list(one) if _are_paths(one) else [one] for one in readings]
    return initial_project([*chain.from_iterable(listed)], robot, out=out, sheet=sheet)


def _are_paths(entry: Any) -> bool:
    return isinstance(entry, list | tuple) and all(isinstance(one, str | Path) for one in entry)


def initial_project(
    readings: Sequence[Any],
    robot: RobotFile,
    *,
    out: str | Path | None,
    sheet: str | None = None,
    ask: Ask | None = None,
    progress: Callable[[str, int], object] = lambda what, percent: None,
) -> InitialProject:
    """`init`, where a user can be asked what remains open.

    progress: called with what is done next, and how much of the work is done by then [%].
    """
    folder = Path() if out is None else Path(out)
    if not readings:
        begun = before_readings(_described(robot, folder, ()), folder)
        return _kept(begun, folder, write=out is not None)
    if robot.observe:
        return _kept(_of_tree(readings, robot, folder), folder, write=out is not None)
    if are_images(readings, _IMAGES):
        return _of_images(readings, robot, folder, write=out is not None)
    if not any((robot.urdf, robot.dh, robot.machine)):
        if samples := samples_of(readings):
            return _kept(from_samples(samples), folder, write=out is not None)
        robot, readings = among(readings, robot)
    described = {str(robot.dh), str(robot.urdf)}
    readings = [entry for entry in tables_of(readings) if str(entry) not in described]
    if out is not None:
        from_files = all(isinstance(entry, str | Path) for entry in readings)
        names = (PROJECT,) if from_files else (PROJECT, READINGS)
        refuse_foreign(*(folder / name for name in names))
    if not readings:
        raise InputError(
            "this describes the robot, and no readings are named",
            code="no-data",
            place=str(robot.dh or robot.urdf),
            remedy="name files of readings before it",
        )
    progress("reading the files", 0)
    sources = sources_of_all(readings, sheet, robot.excluded)
    refuse_unknown(robot.excluded, sources)
    sources, by_time = at_rest(sources, joints_of(robot.urdf))
    progress("recognising the columns", 50)
    every = _joined(sources, robot, folder)
    fields = used(every, robot)
    columns, signs = _joints(fields, robot)
    made = _robot(robot, replace(fields, fields=columns or fields.fields), folder, signs)
    one = in_the_better_convention(made, fields, columns, folder)
    if not one.share <= PLAUSIBLE and (encoders := counted(one.machine, one.layouts)):
        columns = joint_columns(fields.fields, encoders.columns)
        one = readable(one.robot, fields, columns, folder)
        one = replace(one, conditions=encoders.stated(one.conditions, one.machine))
    made, machine, fields, conditions = one.robot, one.machine, one.fields, one.conditions
    if held := held_readings(one.ways, fields.poses):
        raise held
    way = understood(machine, one.layouts, fields, ask, one.ways)
    if not robot.joints and (wrong := misstated(machine, way)):
        raise wrong
    progress("placing the machine", 70)
    statement = stated(made, machine, fields, way, folder, conditions, First(every, sheet))
    if out is not None:
        statement = _planned(statement, folder)
    project = _read(statement, folder)
    dataset = dataset_of(fields.poses, statement.readings)
    progress("checking the poses", 80)
    late = delays(project.mechanism, dataset, way, by_time)
    statement = statement.remarked("data", *map(str, late))
    odd = (*_odd(project, dataset), *_far_off(statement.fits))
    # Where the machine fits, no fault of a whole file is left to be found.
    if way.share > PLAUSIBLE:
        _refuse_faults(project.mechanism, dataset)
    weak, ordered = left_open(project.mechanism, dataset, project.noise.noise())
    if weak:
        statement = statement.remarked("mechanism", weak)
    odd = (*odd, *ordered)
    tables = {READINGS: _table(dataset, statement)} if statement.converted else {}
    remarks = tuple(source.remark for source in every.sources if source.remark)
    remarks += tuple(row for rows in statement.remarks.values() for row in rows) + odd
    text = statement.text
    done = InitialProject(
        project.mechanism,
        dataset,
        project.noise.noise(),
        text,
        project.inputs,
        tables,
        statement.fits,
        remarks,
        late,
    )
    if out is None:
        return done
    files = sealed({PROJECT: text.encode("utf-8"), **tables})
    write_files(folder, files)
    return replace(done, written=tuple(folder / name for name in files))


def _joints(fields: Fields, robot: RobotFile) -> tuple[tuple[Field, ...], tuple[int, ...]]:
    """The columns that are stated as joints, and how each counts; none where none are stated.

    A table of the robot holds directions, so its readings and zeros stay those of the controller.
    """
    columns = joint_columns(fields.fields, robot.joints) if robot.joints else ()
    return turned_columns(fields.fields, columns) if robot.dh else (columns, ())


def _of_images(
    readings: Sequence[Any], robot: RobotFile, folder: Path, *, write: bool
) -> InitialProject:
    """The project of a folder or files with corners of boards, or images of them."""
    if write:
        refuse_foreign(*(folder / name for name in (PROJECT, READINGS, CORNERS)))
    files = files_of(readings)
    named = any((robot.urdf, robot.dh, robot.machine))
    if not named:
        robot, _ = among(files, robot)
    described = [one for one in (robot.urdf, robot.dh, robot.machine) if one is not None]
    describe = partial(_described, robot, folder) if described else None
    robots = {Path(one).resolve() for one in described}
    # A folder may hold the file of the robot as well.
    readings = [path for path in files if path.resolve() not in robots]
    made = from_images(readings, describe, robot.joints, folder, named=named)
    if made.share > PLAUSIBLE:
        table, tips = made.project.hand.table, list[str]()
        if robot.urdf is not None and robot.tip is None and robot.joints is None:
            tips = tips_before(robot.urdf, table["base"], table["tip"])

        def on(tip: str) -> FromImages:
            again = partial(_described, replace(robot, tip=tip), folder)
            return from_images(readings, again, None, folder, named=True)

        made = on_another_link(made, tips, on)
    project = read_project(folder / PROJECT, text=made.begun.text)
    out = left_out(project, made.begun.dataset, made.doubtful)
    return _kept(made.clear_of(out), folder, write=write)


def _of_tree(readings: Sequence[Any], robot: RobotFile, folder: Path) -> Begun:
    """The project of a robot of several bodies and what was observed between them."""
    looking, remarks = observations(robot.observe), tuple[str, ...]()
    if robot.urdf is not None:
        table = urdf_table(relative(Path(robot.urdf), folder), robot.base)
    elif robot.machine is not None and robot.machine.endswith(".toml"):
        table = tree_table(Path(robot.machine), folder)
    else:
        tree = None if robot.dh is None else dh_table(Path(robot.dh), robot.base)
        if tree is None:
            raise UsageError(
                "observations are of a robot of several bodies, which nothing describes",
                remedy="name --urdf FILE, --dh FILE with the columns body and parent, or --machine "
                'FILE of the type "tree"',
            )
        table, remarks = tree
    return from_tree(readings, table, looking, folder, remarks)


def _kept(made: Begun, folder: Path, *, write: bool) -> InitialProject:
    """The project that was begun, written where that is asked for."""
    if write:
        refuse_foreign(*(folder / name for name in (PROJECT, *made.beside)))
    project = read_project(folder / PROJECT, text=made.text)
    done = InitialProject(
        project.mechanism,
        made.dataset,
        project.noise.noise(),
        made.text,
        project.inputs,
        made.beside,
        {},
        made.remarks,
        words=made.words,
    )
    if not write:
        return done
    files = sealed({PROJECT: made.text.encode("utf-8"), **made.beside})
    write_files(folder, files)
    return replace(done, written=tuple(folder / name for name in files))


def _described(robot: RobotFile, folder: Path, fields: Sequence[Field]) -> Robot:
    return _robot(robot, Fields((), (), tuple(fields)), folder, ())


def _robot(robot: RobotFile, fields: Fields, folder: Path, signs: Sequence[int]) -> Robot:
    named = [k for k in ("urdf", "dh", "machine") if getattr(robot, k) is not None]
    if len(named) != 1:
        raise undescribed(named, fields.fields)
    if robot.urdf is not None:
        path = Path(robot.urdf)
        count = len(robot.joints.split(",")) if robot.joints else 0
        links = (robot.base, robot.tip)
        return urdf_robot(path, relative(path, folder), fields.fields, *links, count)
    if robot.base is not None or robot.tip is not None:
        raise UsageError("base and tip are links of a URDF", remedy="remove them, or name --urdf")
    if robot.dh is not None:
        return dh_robot(Path(robot.dh), fields.fields, signs)
    return typed_robot(str(robot.machine))


def _joined(sources: Sequence[Source], robot: RobotFile, folder: Path) -> Fields:
    """The tables as one; where nothing else joins them, as the nominal machine shows."""
    try:
        return joined(sources)
    except InputError as error:
        if error.code != "mismatched-poses":
            raise

        def read(fields: Fields) -> tuple[Machine, Sequence[Layout]]:
            kept = used(fields, robot)
            columns, signs = _joints(kept, robot)
            made = _robot(robot, kept, folder, signs)
            some = layouts(kept.fields, made.joints, made.names, columns)
            return machine_of(made, str(folder / PROJECT)), some

        by_machine = aligned(sources, read)
        if by_machine is None:
            raise
        return by_machine


def _table(dataset: Dataset, statement: Statement) -> bytes:
    """The readings and their sds in SI units, for the file beside the project."""
    columns = statement.tables["data"]["columns"]
    values = {columns[n]["column"]: v for n, v in dataset.readings.items()}
    sds = {columns[n]["sd_column"]: v for n, v in dataset.sds.items()}
    return table_bytes({"pose": dataset.poses, **values, **sds})


def _read(statement: Statement, folder: Path) -> Project:
    """The project as `calibrate` will read it."""
    return read_project(folder / PROJECT, text=statement.text)


def _planned(statement: Statement, folder: Path) -> Statement:
    """With what the project that was planned from states of limits and demands, if it fits."""
    with suppress(InputError), carried_over():
        before = read_project(folder / PROJECT)
        if before.data is None:
            also = {k: v for k, v in before.inputs.items() if k in ("plan", "verdict")}
            kept = replace(statement, tables={**statement.tables, **also})
            _read(kept, folder)  # joints may have other names
            return kept
    return statement


def _odd(project: Project, dataset: Dataset) -> tuple[str, ...]:
    """What is odd about the readings. Raises InputError for zeros of a lost reflector."""
    mechanism = project.mechanism
    units = {**mechanism.quantities, **mechanism.pose_constants}
    warnings = check_dataset(dataset, units, points=measured_points(mechanism))
    return tuple(str(warning) for warning in warnings)


def _far_off(fits: Mapping[str, Mounted]) -> tuple[str, ...]:
    """That a nominal machine is further off than robots are."""
    return tuple(
        f"{name}: the nominal machine misses the readings by {with_unit(fit.rms, 'm')}, and a few "
        "mm are usual. Check the robot's description, the units and the rows."
        for name, fit in fits.items()
        if fit.rms > USUAL
    )


def _refuse_faults(mechanism: Mechanism, dataset: Dataset) -> None:
    """Raise InputError for a fault of the whole file that no unit explains."""
    faults = column_faults(build_problem(mechanism, dataset, None))
    if faults:
        words = faults[0].words
        if faults[0].code != HELD:
            words = f"the readings do not belong to this machine: {words}"
        raise InputError(
            words,
            code="implausible-readings",
            remedy=_REMEDIES.get(faults[0].code, "correct the file or the robot's description"),
        )


_REMEDIES = {
    "reversed": "add a column direction to the table of the robot, -1 for this joint; or correct "
    "the sign in the file",
    "exchanged": "exchange the headers of these columns",
    HELD: "state in a mechanism file where the target is, with the instrument in the machine's own "
    "frame (station = false), and name your columns in a project",
    "rows-shifted": "give joints and instrument the same pose ids",
    "rows-shuffled": "give joints and instrument the same pose ids",
}
