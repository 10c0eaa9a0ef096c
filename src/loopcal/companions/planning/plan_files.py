"""Plans: which poses to measure for a project, written beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.planning import plan as planning
from loopcal.companions.planning.candidates import ranges_of
from loopcal.companions.planning.occasions import occasions
from loopcal.companions.planning.page import plan_html
from loopcal.companions.planning.planned import Plan
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.dialect import Stops
from loopcal.companions.robot.programs.program import refuse_redundant
from loopcal.companions.robot.programs.registry import WRITTEN
from loopcal.errors import InputError
from loopcal.estimation.result import FitResult
from loopcal.execution.executor import Progress
from loopcal.files.atomic import write_all, write_atomic
from loopcal.files.json_files import marked, marked_json
from loopcal.files.outputs import expanded, one_command, refuse_foreign
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project
from loopcal.files.project.readings_file import readings_tables
from loopcal.files.result.deployed import PLAN, note_deployed, result_path
from loopcal.files.result.result_poses import poses_of_result, without_poses
from loopcal.files.tables.writer import Column
from loopcal.files.toml.place import Place
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import Calibrated
from loopcal.workflow.projects import named_project
from loopcal.workflow.readings import Units, new_readings, readings
from loopcal.workflow.resolved import described, result_of
from loopcal.workflow.saved_result import SavedResult

POSES, DOCUMENT, PAGE = "plan.csv", "plan.json", "plan.html"


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan and where it was written; document: of plan.json; program: for the controller, where
    one was asked for."""

    plan: Plan
    document: Mapping[str, Any]
    title: str
    folder: Path
    files: tuple[str, ...]
    program: Path | None = None


@dataclass(frozen=True)
class PlanRequest:
    """What the options of `loopcal plan` ask for.

    candidates, existing: paths; report: write the page; program: path of a program for the
    controller; pulses: per degree of each joint, for it.
    """

    poses: int = 30
    criterion: str | None = None
    candidates: str | None = None
    existing: str | None = None
    report: bool = True
    program: str | None = None
    pulses: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class PlanningBasis:
    """What a plan begins from: the machine, its noise, and poses already measured.

    calibrated: by a fit, whose own terms say what geometry does not explain.
    """

    mechanism: Mechanism
    noise: Noise
    existing: Dataset | None = None
    calibrated: bool = False

    def settled(self, settings: PlanSettings) -> PlanSettings:
        """The settings, without further terms beside those of a calibration."""
        return replace(settings, model_error="none") if self.calibrated else settings


def run_plan(
    project: str | Path,
    request: PlanRequest,
    *,
    out: str | Path | None = None,
    function: str | None = None,
    progress: Progress | None = None,
) -> Planned:
    """Choose poses for a project; write plan.csv, plan.json and plan.html.

    out: the folder, by default NAME-plan beside NAME.toml. Raises InputError for what cannot be
    used.
    """
    read = named_project(project, function)
    folder = Path(out) if out is not None else plan_folder(read)
    refuse_foreign(*(folder / name for name in (POSES, DOCUMENT, PAGE)))
    basis = basis_of(read, request.existing)
    program_path = None if request.program is None else Path(request.program)
    write = None
    if program_path is not None:
        write = program_writer(basis.mechanism, program_path, pulses=request.pulses)
    try:
        made = planning.plan(
            basis.mechanism,
            request.poses,
            noise=basis.noise,
            candidates=candidates_of(read, request.candidates),
            existing=basis.existing,
            criterion=request.criterion,
            settings=basis.settled(settings_of(read)),
            progress=progress,
        )
    except InputError as error:
        raise error.at(read.name) from None
    # In the columns of the project, with the use of each pose.
    poses, data = made.poses, read.data
    if data is not None and any(part.spread for part in data.join):
        # Corners are not commanded.
        data = replace(data, join=tuple(part for part in data.join if not part.spread))
        pixels = {q for q in poses.readings if basis.mechanism.quantities.get(q) == "px"}
        poses = Dataset.from_arrays(
            {q: v for q, v in poses.readings.items() if q not in pixels},
            units={q: unit for q, unit in poses.units.items() if q not in pixels},
            poses=poses.poses,
        )
    more: dict[str, Column] = {"use": made.use}
    if made.serves:
        more["serves"] = tuple(" ".join(kind) for kind in made.serves)
    tables = readings_tables(poses, data, {}, folder / POSES, more)
    files: dict[str, str | bytes] = {**tables}
    document = marked({"title": read.title, **made.document()}, files)
    files[DOCUMENT] = marked_json(document)
    if request.report:
        files[PAGE] = plan_html(made, read.title, basis.mechanism, read.name)
    written: dict[Path, str | bytes] = {folder / name: data for name, data in files.items()}
    if program_path is not None and write is not None:
        written[program_path] = write(made)
    write_all(written, remove=() if request.report else (folder / PAGE,))
    if basis.calibrated:
        note_deployed(result_path(str(request.existing)), PLAN, folder.name, document)
    return Planned(made, document, read.title, folder, tuple(files), program_path)


def plan_folder(project: Project) -> Path:
    """NAME-plan beside the project."""
    name = "loopcal" if project.path is None else project.path.stem
    return project.folder / f"{name}-plan"


def settings_of(project: Project) -> PlanSettings:
    """The [plan] of a project, its forbidden rows read.

    Ranges that are not stated are those of the project's readings (`ranges_of`), and instruments
    that its poses were measured with together are in the plan.
    """
    settings, name = project.plan, project.inputs.get("plan", {}).get("forbidden")
    if name is not None:
        path = expanded(name, project.folder, Place(project.name).at("plan", "forbidden"))
        rows = new_readings(path, project.inputs, project.mechanism)
        settings = replace(settings, forbidden=rows)
    mechanism, ranged = project.mechanism, True
    try:
        ranges_of(mechanism, settings.ranges, None)
    except InputError:
        ranged = False
    if ranged and len(mechanism.families) < 2:
        return settings
    with suppress(InputError):
        measured = load_dataset(project).dataset
        settings = replace(settings, occasions=occasions(mechanism, measured))
        if not ranged:
            ranges = ranges_of(mechanism, settings.ranges, measured)
            settings = replace(settings, ranges=ranges)
    return settings


def basis_of(project: Project, existing: Any = None) -> PlanningBasis:
    """The machine and noise of a project, or those that a calibration has found.

    existing: a result, the folder of one, or a file of readings in the project's columns.
    """
    if existing is None:
        return PlanningBasis(project.mechanism, _usual_noise(project))
    if isinstance(existing, Dataset):
        return PlanningBasis(project.mechanism, project.noise.noise(), existing)
    if isinstance(existing, str | Path) and poses_of_result(existing, project.mechanism) is None:
        data = new_readings(existing, project.inputs, project.mechanism, whole=True)
        return PlanningBasis(project.mechanism, project.noise.noise(), data)
    return of_calibration(existing)


def _usual_noise(project: Project) -> Noise:
    """The stated noise; readings that come with sds of their own will have them again (median)."""
    noise = project.noise.noise()
    columns = () if project.data is None else project.data.columns.values()
    if all(column.sd_column is None for column in columns):
        return noise
    with suppress(InputError):
        sds = load_dataset(project).dataset.sds
        usual = {q: float(np.nanmedian(sd)) for q, sd in sds.items()}
        noise = Noise({**usual, **noise.entries}, estimate=noise.estimate)
    return noise


def of_calibration(result: Any) -> PlanningBasis:
    """What a calibration leaves to plan from: its machine, learnt sds and poses."""
    calibrated = _calibrated(result)
    if calibrated.poses is None:
        raise without_poses(calibrated.name)
    names = calibrated.mechanism.parameters.names
    sds = dict(zip(names, calibrated.prior_sd.tolist(), strict=True))
    mechanism = calibrated.mechanism.with_parameters(
        calibrated.mechanism.parameters.with_prior(sds)
    )
    # An sd of inf: what has no noise in the result was not measured.
    entries: dict[str, float] = dict.fromkeys(mechanism.quantities, np.inf)
    entries |= {q: e.sd for e in calibrated.noise for q in e.quantities if q in entries}
    model = [e.sd for e in calibrated.noise if e.role == "disturbance"]
    entries |= {MODEL: model[0]} if model else {}
    kept = {q: v for q, v in calibrated.poses.readings.items() if q not in mechanism.disturbances}
    data = Dataset(
        kept, calibrated.poses.units, calibrated.poses.poses, {}, calibrated.poses.source
    )
    noise = Noise(entries if calibrated.noise else {})  # none of a fit with exact joints
    return PlanningBasis(mechanism, noise, data, calibrated=True)


def _calibrated(result: Any) -> Calibrated:
    result = result_of(result)
    if isinstance(result, FitResult):
        return Calibrated.of(result, "the result")
    calibrated: Calibrated = result.calibrated
    return calibrated


def candidates_of(project: Project, path: str | Path | None) -> Dataset | None:
    """The poses of a file in the project's columns, or of a result."""
    if path is None:
        return None
    poses = poses_of_result(path, project.mechanism)
    if poses is not None:
        return poses
    return new_readings(path, project.inputs, project.mechanism)


@wraps(planning.plan)
def plan(
    mechanism: Any,
    poses: int = 30,
    *,
    candidates: Any = None,
    existing: Any = None,
    units: Units = None,
    **options: Any,
) -> Plan:
    """`plan`, of paths, projects and results too: a result is planned on from its poses."""
    if isinstance(mechanism, FitResult | SavedResult):
        mechanism, existing = mechanism.mechanism, mechanism if existing is None else existing
    description = described(mechanism)
    if isinstance(description, Project):
        basis = basis_of(description, existing)
        options.setdefault("settings", settings_of(description))
    elif (
        existing is None or isinstance(existing, Dataset | Mapping) or hasattr(existing, "columns")
    ):
        machine = getattr(description, "mechanism", description)
        data = None if existing is None else readings(existing, machine, units)
        basis = PlanningBasis(
            machine, options.pop("noise", getattr(description, "noise", None)), data
        )
    else:
        basis = of_calibration(existing)
    options.setdefault("noise", basis.noise)
    options["settings"] = basis.settled(options.get("settings") or PlanSettings())
    if candidates is not None:
        if isinstance(description, Project) and isinstance(candidates, str | Path):
            candidates = candidates_of(description, candidates)
        else:
            candidates = readings(candidates, basis.mechanism, units)
    return planning.plan(
        basis.mechanism, poses, candidates=candidates, existing=basis.existing, **options
    )


# The poses of a plan as a program for the controller of the arm.
#
# Programs that drive poses one after another and wait at each: to measure them.
#
# Only what vendors publish is written: joint targets, a slow move by joints, an exact stop, a wait.


# At most 32 characters each, where Fanuc and Yaskawa programs cut a comment.
WORDS = (
    "Poses planned by loopcal.",
    "Zeros of joints as in the plan.",
    "Moves between poses are not",
    "checked for collisions: run",
    "slowly first.",
)


@one_command
def plan_program(
    mechanism: Any,
    plan: Plan,
    path: str | Path,
    *,
    pulses: Sequence[float] = (),
    force: bool = False,
) -> Path:
    """Write the poses of a plan as a program: a joint move to each, in order, and a wait of 3 s.

    mechanism: a Mechanism, a project or the path of one; path: its ending names the dialect, such
    as .mod for RAPID; pulses: per degree of each joint, for a dialect in pulses; force: replace a
    file that exists, keeping a backup. Joints are named from base to tip. Moves between poses are
    not checked for collisions. Raises InputError for a machine whose joints the plan does not
    state, and for what the format cannot hold.
    """
    description = described(mechanism)
    write = program_writer(getattr(description, "mechanism", description), path, pulses=pulses)
    write_atomic(path, write(plan))
    return Path(path)


def program_writer(
    mechanism: Mechanism, path: str | Path, *, pulses: Sequence[float] = ()
) -> Callable[[Plan], bytes]:
    """What makes the program of a plan, after all that can be refused without one is refused."""
    path, joints = Path(path), {s.joint: s.unit for s in mechanism.chain if s.joint}
    if not joints or not mechanism.implied.keys().isdisjoint(joints):
        raise InputError(
            f"{mechanism.name!r} is not a serial arm whose joints are driven one by one",
            code="unsupported",
            place=str(path),
            remedy="leave --program out, and drive the poses of plan.csv",
        )
    refuse_foreign(path)
    axes = JointAxes(joints, pulses=tuple(pulses))
    # A program without poses refuses name, ending and pulses before anything is planned.
    program_of_stops(path, axes, np.empty((0, len(joints))), (), ())

    def program(plan: Plan) -> bytes:
        q = np.array([plan.poses.readings[joint] for joint in joints]).T
        ids = [f"{i}, {use}" for i, use in zip(plan.poses.poses, plan.use, strict=True)]
        return program_of_stops(path, axes, q, ids, WORDS)

    return program


def program_of_stops(
    path: Path, axes: JointAxes, joints: Array, ids: Sequence[str], words: Sequence[str]
) -> bytes:
    """A program that drives to joints (N, n) [SI] and waits at each, in the format that the ending
    of the path names.

    ids: of the poses, words: for its head, both ASCII in the file. Raises InputError for an unknown
    ending, a name that the format does not allow, an arm of more than six joints, and pulses that
    are not stated.
    """
    dialect = WRITTEN.get(path.suffix.lower())
    if dialect is None or dialect.drive is None:
        raise InputError(
            f"the ending {path.suffix!r} is that of no program that loopcal writes",
            code="wrong-file-type",
            place=str(path),
            remedy=f"give a file that ends in {', '.join(WRITTEN)}",
        )
    drive = dialect.drive
    if not re.fullmatch(rf"[A-Za-z]\w{{0,{drive.longest - 1}}}", path.stem, re.ASCII):
        raise InputError(
            f"{path.stem!r} is no name of a program in {dialect.kind}",
            code="invalid-value",
            place=str(path),
            remedy=f"begin with a letter, use letters, digits and _, at most {drive.longest}",
        )
    refuse_redundant(axes, str(path))
    values = joints if drive.si else joints / axes.scale
    if drive.pulses:
        values = values * axes.pulses_each(str(path))
    units = ["mm" if unit == "m" else "deg" for unit in axes.joints.values()]
    stops = Stops(path.stem, [_plain(i) for i in ids], values, units, [_plain(w) for w in words])
    return drive.ended.join([*drive.write(stops), ""]).encode("ascii")


def _plain(text: str) -> str:
    """As one line of ASCII."""
    return re.sub(r"[^ -~]+", "?", text)
