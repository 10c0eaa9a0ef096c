"""A program on the disk, corrected by a result: read, solved, judged and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms, arm_joints, arms_of
from loopcal.deployment.corrected import Corrected, CorrectionBounds, Targets, corrected
from loopcal.deployment.correction import Correction, Left
from loopcal.deployment.inverse import solve
from loopcal.deployment.refusals import Refusal
from loopcal.deployment.rigid import inverse
from loopcal.deployment.solutions import solutions, with_turns
from loopcal.deployment.straight import StraightMove, straight_move
from loopcal.deployment.tool import CALIBRATED, Tool, tool_of
from loopcal.errors import InputError
from loopcal.estimation.result import Result
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.programs.copying import inserted
from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.poses_text import pose_of_turns
from loopcal.files.programs.program import Program, ProgramTarget
from loopcal.files.programs.reader import beside, read_program, refuse_existing, write_program
from loopcal.files.project.new_readings import result_columns, result_pose_column
from loopcal.files.recognition.robots import dh_robot
from loopcal.files.result.deployed import CORRECTION, note_deployed, result_path
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.predictor import Predictor, predictor, predictor_of
from loopcal.workflow.given import readings, result_of
from loopcal.workflow.saved_result import SavedResult

Array = NDArray[np.float64]
_NEAR = 1e-8


def correct(
    result: Any,
    targets: Any,
    *,
    tool: str | Sequence[float] = CALIBRATED,
    controller: Mechanism | str | Path | None = None,
    frame: Sequence[float] | None = None,
    bounds: CorrectionBounds | None = None,
    at: Mapping[str, float] | None = None,
    pulses: Sequence[float] = (),
) -> Correction:
    """Targets of a program, corrected so that the real machine reaches the poses it asks for.

    The controller computes with a model f_c of its own, the machine is f, sag, gears and the
    learnt discrepancy included. T = f_c(q) is wanted; the corrected joints q* solve f(q*) = T, and
    the corrected Cartesian target is f_c(q*). U95 is that of the reached pose: parameters, joints'
    readings, model error and the last digit of the file (see `Reached`). Nothing is written.

    result: of `calibrate` or `read_result`, or the path of its folder; targets: the path of a
    program, or a table of joints [SI]; tool: "calibrated" (default), "nominal", or x, y, z [mm]
    and rz, ry, rx [deg] on the last link; controller: a Mechanism, or the path of a mechanism file
    or of a table of Denavit-Hartenberg parameters, by default the drawing of the result; frame: of
    Cartesian targets in the base, x, y, z [mm] and rz, ry, rx [deg]; bounds: what a target may need
    at most; at: constants such as temperatures, name -> value [SI]; pulses: per degree of each
    joint. Raises InputError for what cannot be used. Source: Denavit-Hartenberg pose redefinition,
    doi 10.1177/16878132221090094.
    """
    given = result_of(result)
    known, nominal, inputs = _known(given)
    if not isinstance(tool, str):
        tool = [*(1e-3 * float(v) for v in tool[:3]), *np.radians(tool[3:]).tolist()]
    seated = tool_of(known.mechanism, nominal, tool)
    joints = arm_joints(known.mechanism)
    of_controller = _controller(controller, joints)
    arms = arms_of(known.mechanism, nominal, seated, of_controller, at, known.typical)
    bounds, at = bounds or CorrectionBounds(), at or {}
    if not isinstance(targets, str | Path):
        return _of_table(arms, known, targets, bounds, at)
    axes = JointAxes(
        joints,
        result_columns(inputs, known.mechanism),
        result_pose_column(inputs, known.mechanism),
        tuple(pulses),
    )
    program = read_program(targets, axes)
    placed = np.eye(4) if frame is None else pose_of_turns([*frame, 0.0, 0.0, 0.0][:6])
    wanted = _wanted(arms, program, placed, frame is not None)
    found = corrected(arms, known, wanted, bounds, at)
    new = {
        i: program.write(target, found.joints[i], inverse(placed) @ found.poses[i])
        for i, target in enumerate(program.targets)
        if found.refused[i] is None
    }
    changed = tuple(
        Refusal("configuration-changed", "the corrected joints are in another configuration")
        if refusal is None and not program.fits(target, q)
        else refusal
        for target, q, refusal in zip(program.targets, found.joints, found.refused, strict=True)
    )
    new = {i: texts for i, texts in new.items() if changed[i] is None}
    found = replace(found, refused=changed)
    moves, ahead = _straight(arms, program, found, bounds.line), dict[int, list[list[str]]]()
    for index, move in moves.items():
        if len(move.inserted):
            own = program.targets[move.end]
            poses = inverse(placed) @ arms.controller(move.inserted)
            pairs = zip(move.inserted, poses, strict=True)
            ahead[index] = [program.write(own, q, pose) for q, pose in pairs]
    return Correction(
        arms,
        found,
        program.name,
        program.kind,
        tuple(target.line for target in program.targets),
        tuple(Left(note.line, note.words) for note in program.noted),
        _remarks(seated, arms),
        program.edited(new, inserted(program, ahead)),
        moves=tuple(moves.values()),
    )


def run_correct(
    result: str | Path,
    targets: str | Path,
    *,
    out: str | Path | None = None,
    force: bool = False,
    **options: Any,
) -> Correction:
    """`correct` a program on the disk, and write the corrected one.

    out: by default NAME-corrected beside the program; a file that exists is replaced only with
    force. Nothing is written where every target is refused. The report of the result shows it.
    """
    path = beside(targets) if out is None else Path(out)
    refuse_existing(path, force)
    done = correct(result, targets, **options)
    if not done.corrected.done.any():
        return done
    write_program(path, done.content)
    done = replace(done, written=str(path))
    note_deployed(result_path(result), CORRECTION, Path(targets).name, done.document())
    return done


def _known(given: Any) -> tuple[Predictor, dict[str, float], Mapping[str, Any]]:
    """What is known of the machine, the drawing's values, and the project of the result."""
    if isinstance(given, SavedResult):
        try:
            known = predictor_of(given.document, given.mechanism)
        except InputError as error:
            raise error.at(str(given.path)) from None
        nominal = {p.name: p.nominal for p in given.document.parameters}
        return known, nominal, given.document.inputs
    if not isinstance(given, Result):
        raise InputError(
            f"{given!r} is no result",
            code="invalid-value",
            remedy="give a result of calibrate, or the path of its folder",
        )
    found = predictor(given)
    if found is None:
        raise InputError(
            f"{given.mechanism.name!r} has no outputs to predict",
            code="no-outputs",
            remedy="correct targets by the result of a measured arm",
        )
    return found, {p.name: p.nominal for p in given.mechanism.parameters}, {}


def _controller(
    given: Mechanism | str | Path | None, joints: Mapping[str, str]
) -> Mechanism | None:
    if given is None or isinstance(given, Mechanism):
        return given
    path = Path(given)
    if path.suffix.lower() == ".toml":
        return read_mechanism(path)
    table = dict(dh_robot(path, ()).table)
    table["joint"] = [
        {**joint, "name": name} for joint, name in zip(table["joint"], joints, strict=False)
    ]
    return mechanism_from_data(table, path.name)


def _of_table(
    arms: Arms, known: Predictor, table: Any, bounds: CorrectionBounds, at: Mapping[str, float]
) -> Correction:
    """Joint targets of a DataFrame, dict or Dataset [SI]."""
    data = readings(table, known.mechanism)
    missing = [joint for joint in arms.joints if joint not in data.readings]
    if missing:
        raise InputError(
            f"the targets lack the joint {missing[0]!r}",
            code="missing-reading",
            remedy="give every joint of the arm [rad or m]",
        )
    q = np.array([data.readings[joint] for joint in arms.joints]).T
    cartesian = np.zeros(len(q), dtype=bool)
    targets = Targets(data.poses, q, arms.controller(q), cartesian, np.zeros(q.shape))
    found = corrected(arms, known, targets, bounds, at)
    lines = tuple(range(1, len(q) + 1))
    remarks = _remarks(arms.tool, arms)
    return Correction(arms, found, "", "joints", lines, (), remarks)


def _wanted(arms: Arms, program: Program, frame: Array, stated: bool) -> Targets:
    """The targets of a program in the base of the arm, with the joints of the controller there.

    stated: whether the user states the frame of the poses.
    """
    count, n = len(program.targets), len(arms.joints)
    q, poses = np.full((count, n), np.nan), np.full((count, 4, 4), np.nan)
    step, missing = np.zeros((count, max(n, 6))), {}
    for i, target in enumerate(program.targets):
        step[i, : len(target.step)] = target.step
        if target.pose is None:
            q[i] = target.joints
        elif program.frame is not None and not stated:
            words = f"the pose is relative to {program.frame}, whose place is not stated (--frame)"
            missing[i] = Refusal("not-stated", words)
        else:
            poses[i] = frame @ target.pose
            found = _joints_of(arms, program, target, poses[i])
            if isinstance(found, Refusal):
                missing[i] = found
            else:
                q[i] = found
    written = np.array([target.cartesian for target in program.targets], dtype=bool)
    known = np.isfinite(q).all(axis=1) & ~written
    poses[known] = arms.controller(q[known])
    names = tuple(target.name for target in program.targets)
    return Targets(names, q, poses, written, step, missing)


def _joints_of(arms: Arms, program: Program, target: ProgramTarget, pose: Array) -> Array | Refusal:
    """The joints that the controller takes at a pose, or why they are not known."""
    if len(arms.joints) > 6:
        words = "a redundant arm takes a pose in many ways; give joint targets"
        return Refusal("configuration-missing", words)
    if target.joints is not None:
        near = solve(arms.controller, pose[None], target.joints[None])
        if not near.settled[0] or np.abs(near.left[0]).max() > _NEAR:
            words = "the controller's model does not reach this pose from the seed"
            return Refusal("not-reached", words)
        seeded: Array = near.joints[0]
        return seeded
    every = solutions(arms, pose)
    fitting: list[Array] = []
    for turns in (0, 1):  # of joints without limits
        for one in every:
            ways = [q for q in with_turns(arms, one, turns) if program.fits(target, q)]
            fitting += sorted(ways, key=lambda q: float(np.abs(q).max()))[:1]
        if fitting:
            break
    fitting = program.chosen(target, fitting)
    if not len(every):
        return Refusal("not-reached", "no joints of the controller's model give this pose")
    if len(fitting) == 1:
        return fitting[0]
    words = (
        f"{len(fitting)} configurations give this pose, and the program does not say which"
        if fitting
        else "no configuration that gives this pose is the one that the program states"
    )
    return Refusal("configuration-missing", words)


def _straight(
    arms: Arms, program: Program, found: Corrected, bound: float | None
) -> dict[int, StraightMove]:
    """The straight moves between corrected targets, by their index in the program."""
    moves, done = dict[int, StraightMove](), found.done
    for at, (last, move) in enumerate(pairwise(program.moves), 1):
        if last is None or move is None or not move.straight:
            continue
        ends = (last.target, move.target)
        if not all(done[i] for i in ends):
            continue
        q, wanted = found.joints[list(ends)], found.targets.poses[list(ends)]
        own = straight_move(arms, ends, move.line, q, wanted, None if move.fixed else bound)
        why = move.fixed if bound is not None and own.error > bound else own.why
        if not all(program.fits(program.targets[move.target], one) for one in own.inserted):
            own = straight_move(arms, ends, move.line, q, wanted, None)
            why = "in between the arm leaves the configuration that the target states"
        moves[at] = replace(own, why=why)
    return moves


def _remarks(tool: Tool, arms: Arms) -> tuple[str, ...]:
    """What the correction assumes."""
    said = []
    if not tool.observed:
        said.append(
            "The turn of the tool on the last link was not measured: its nominal turn is used."
        )
    unlimited = [joint for joint in arms.joints if joint not in arms.limits]
    if unlimited:
        said.append(
            f"No limits are stated for {', '.join(unlimited)}: limits of joints are not checked."
        )
    return tuple(said)
