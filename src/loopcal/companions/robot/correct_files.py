"""A program on the disk, corrected by a result: read, solved, judged and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.arms import Arms, arm_joints, arms_of
from loopcal.companions.robot.corrected import (
    Corrected,
    CorrectionBounds,
    Refusal,
    Targets,
    corrected,
)
from loopcal.companions.robot.correction import Correction, StraightMove, divided, line_errors
from loopcal.companions.robot.inverse import solutions, solve, with_turns
from loopcal.companions.robot.programs.coordinates import JointAxes, pose_of_turns
from loopcal.companions.robot.programs.copying import inserted
from loopcal.companions.robot.programs.program import Program, ProgramTarget
from loopcal.companions.robot.programs.registry import (
    beside,
    corrected_already,
    correction_mark,
    read_program,
    refuse_corrected,
)
from loopcal.companions.robot.rigid import CALIBRATED, Tool, tool_of
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.outputs import refuse_foreign
from loopcal.files.project.project_data import (
    computed_joints,
    result_columns,
    result_pose_column,
)
from loopcal.files.recognition.robots import dh_robot
from loopcal.files.result.deployed import CORRECTION, note_deployed, result_path, was_corrected
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import inverse
from loopcal.workflow.readings import later_readings
from loopcal.workflow.resolved import result_of
from loopcal.workflow.views import Limb

# 10 nm and 10 nrad: three decades below what an arm repeats.
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

    The controller computes with its model f_c, and the machine is f, sag, gears and the
    learnt discrepancy included. T = f_c(q) is wanted; the corrected joints q* solve f(q*) = T, and
    the corrected Cartesian target is f_c(q*). U95 is that of the reached pose: parameters, joints'
    readings, model error and the last digit of the file (see `Reached`). Nothing is written.

    result: of `calibrate` or `read_result`, or the path of its folder; targets: the path of a
    program, or joints as `predict` takes them; tool: "calibrated" (default), "nominal", or x, y, z
    [mm] and rz, ry, rx [deg] on the last link; controller: a Mechanism, or the path of a mechanism
    file or of a table of Denavit-Hartenberg parameters, by default the drawing; frame: of
    Cartesian targets in the base, x, y, z [mm] and rz, ry, rx [deg]; bounds: what a target may need
    at most; at: constants such as temperatures, name -> value [SI]; pulses: per degree of each
    joint. Raises InputError for what cannot be used. Source: Denavit-Hartenberg pose redefinition,
    doi 10.1177/16878132221090094.
    """
    measured = result_of(result)
    calibrated, inputs = measured.predictor, measured.inputs
    if not isinstance(tool, str):
        tool = [*(1e-3 * float(v) for v in tool[:3]), *np.radians(tool[3:]).tolist()]
    joints = arm_joints(calibrated.mechanism, measured.poses)
    arms = _arms(measured, tool, _controller(controller, joints), at)
    bounds, at = bounds or CorrectionBounds(), at or {}
    if not isinstance(targets, str | Path):
        asked = later_readings(measured, targets, None, whole=False)
        return _of_table(arms, measured, asked, bounds, at)
    if computed := computed_joints(inputs):
        raise InputError(
            f"the calibration reads {', '.join(computed)}, and the program holds the controller's "
            "joints",
            code="unsupported",
            place=str(targets),
            remedy="calibrate with a robot's table whose column direction has -1 for joints that "
            "count the other way round, or give converted joints in Python",
        )
    described = measured.whole.mechanism if isinstance(measured, Limb) else calibrated.mechanism
    axes = JointAxes(
        joints,
        result_columns(inputs, described),
        result_pose_column(inputs, described),
        tuple(pulses),
    )
    program = read_program(targets, axes)
    refuse_corrected(program)
    # Three numbers are a shift without a turn.
    placed = np.eye(4) if frame is None else pose_of_turns([*frame, 0.0, 0.0, 0.0][:6])
    wanted = _wanted(arms, program, placed, frame is not None)
    corrections = corrected(arms, calibrated, wanted, bounds, at)
    # The correction may carry a joint across the border of a quadrant or turn.
    changed = tuple(
        Refusal("configuration-changed", "the corrected joints are in another configuration")
        if refusal is None and not program.fits(target, q)
        else refusal
        for target, q, refusal in zip(
            program.targets, corrections.joints, corrections.refused, strict=True
        )
    )
    corrections = replace(corrections, refused=changed)
    # T_frame_target = T_base_frame^-1 T_base_target: programs state poses in their frame.
    new = {
        i: program.write(target, corrections.joints[i], inverse(placed) @ corrections.poses[i])
        for i, target in enumerate(program.targets)
        if changed[i] is None
    }
    moves, ahead = _straight(arms, program, corrections, bounds.line), dict[int, list[list[str]]]()
    for index, move in moves.items():
        if len(move.inserted):
            end = program.targets[move.end]
            poses = inverse(placed) @ arms.controller(move.inserted)
            pairs = zip(move.inserted, poses, strict=True)
            ahead[index] = [program.write(end, q, pose) for q, pose in pairs]
    mark = correction_mark(program) if new else []
    return Correction(
        arms,
        corrections,
        program.name,
        program.kind,
        tuple(target.line for target in program.targets),
        program.noted,
        _remarks(arms.tool, arms, measured),
        program.edited(new, [*inserted(program, ahead), *mark]),
        moves=tuple(moves.values()),
    )


def tool_poses(result: Any, data: Dataset) -> Array:
    """(N, 4, 4) of the calibrated tool in the base of the calibrated arm, with all its effects."""
    arms = _arms(result, CALIBRATED, None, None)
    return arms.machine(np.stack([data[name] for name in arms.joints], axis=-1))


def _arms(
    result: Any,
    tool: str | Sequence[float],
    controller: Mechanism | None,
    at: Mapping[str, float] | None,
) -> Arms:
    calibrated = result.predictor
    nominal = {p.name: p.nominal for p in result.params.entries}
    seated = tool_of(calibrated.mechanism, nominal, tool)
    return arms_of(calibrated.mechanism, nominal, seated, controller, at, calibrated.typical)


def run_correct(
    result: str | Path,
    targets: str | Path,
    *,
    out: str | Path | None = None,
    limb: str | None = None,
    **options: Any,
) -> Correction:
    """`correct` a program on the disk, and write the corrected one.

    out: by default NAME-corrected beside the program; limb: the body at the end of the one whose
    program it is. Nothing is written where every target is
    refused. The report of the result shows it.
    """
    path = beside(targets) if out is None else Path(out)
    refuse_foreign(path)
    # By SHA-256: formats without a place for the mark are recognised too.
    if was_corrected(result_path(result), Path(targets)):
        raise corrected_already(str(targets))
    whole = result_of(result)
    done = correct(whole if limb is None else whole.limb(limb), targets, **options)
    if not done.corrected.done.any():
        return done
    write_atomic(path, done.content)
    done = replace(done, written=str(path))
    name, document = Path(targets).name, done.document()
    note_deployed(result_path(result), CORRECTION, name, document, [done.content])
    return done


def _controller(
    controller: Mechanism | str | Path | None, joints: Mapping[str, str]
) -> Mechanism | None:
    if controller is None or isinstance(controller, Mechanism):
        return controller
    path = Path(controller)
    if path.suffix.lower() == ".toml":
        return read_mechanism(path)
    table = dict(dh_robot(path, ()).table)
    # A controller's table has other names: its joints are matched by their order.
    table["joint"] = [
        {**joint, "name": name} for joint, name in zip(table["joint"], joints, strict=False)
    ]
    return mechanism_from_data(table, path.name)


def _of_table(
    arms: Arms,
    result: Any,
    data: Dataset,
    bounds: CorrectionBounds,
    at: Mapping[str, float],
) -> Correction:
    """Joint targets [SI]."""
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
    corrections = corrected(arms, result.predictor, targets, bounds, at)
    lines = tuple(range(1, len(q) + 1))
    remarks = _remarks(arms.tool, arms, result)
    return Correction(arms, corrections, "", "joints", lines, (), remarks)


def _wanted(arms: Arms, program: Program, frame: Array, stated: bool) -> Targets:
    """The targets of a program in the base of the arm, with the joints of the controller there.

    stated: whether the user states the frame of the poses.
    """
    targets, n = program.targets, len(arms.joints)
    q, poses = np.full((len(targets), n), np.nan), np.full((len(targets), 4, 4), np.nan)
    step, missing = np.zeros((len(targets), max(n, 6))), {}
    placed = []
    for i, target in enumerate(targets):
        step[i, : len(target.step)] = target.step
        if target.pose is None:
            q[i] = target.joints
        elif program.frame is not None and not stated:
            words = f"the pose is relative to {program.frame}, whose place is not stated (--frame)"
            missing[i] = Refusal("not-stated", words)
        else:
            poses[i] = frame @ target.pose
            placed.append(i)
    for i, joints in _joints_of(arms, program, placed, poses).items():
        if isinstance(joints, Refusal):
            missing[i] = joints
        else:
            q[i] = joints
    written = np.array([target.cartesian for target in targets], dtype=bool)
    # A Cartesian target keeps the pose that is written; rounding of its joints would shift it.
    solved = np.isfinite(q).all(axis=1) & ~written
    poses[solved] = arms.controller(q[solved])
    names = tuple(target.name for target in targets)
    return Targets(names, q, poses, written, step, missing)


def _joints_of(
    arms: Arms, program: Program, placed: Sequence[int], poses: Array
) -> dict[int, Array | Refusal]:
    """The joints that the controller takes at the poses of these targets, or why unknown."""
    if len(arms.joints) > 6:
        words = "a redundant arm takes a pose in many ways; give joint targets"
        return dict.fromkeys(placed, Refusal("configuration-missing", words))
    joints_of = dict[int, Array | Refusal]()
    seeds = {i: joints for i in placed if (joints := program.targets[i].joints) is not None}
    if seeds:
        near = solve(arms.controller, poses[[*seeds]], np.array([*seeds.values()]))
        reached = near.settled & ~(np.abs(near.left).max(axis=1) > _NEAR)
        words = "the controller's model does not reach this pose from the seed"
        for i, joints, good in zip(seeds, near.joints, reached, strict=True):
            joints_of[i] = joints if good else Refusal("not-reached", words)
    free = [i for i in placed if i not in seeds]
    for i, every in zip(free, solutions(arms, poses[free]), strict=True):
        joints_of[i] = _stated(arms, program, program.targets[i], every)
    return joints_of


def _stated(arms: Arms, program: Program, target: ProgramTarget, every: Array) -> Array | Refusal:
    """Of all joints (m, n) that give a pose those that the program states."""
    fitting: list[Array] = []
    for turns in (0, 1):  # of joints without limits
        for ways in with_turns(arms, every, turns):
            fits = ways[program.fits(target, ways)]
            if len(fits):
                # Whole turns change no pose: the way nearest to zero represents all.
                fitting.append(fits[np.argmin(np.abs(fits).max(axis=1))])
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
    arms: Arms, program: Program, corrections: Corrected, bound: float | None
) -> dict[int, StraightMove]:
    """The straight moves between corrected targets, by their index in the program."""
    done, none = corrections.done, np.empty((0, corrections.joints.shape[1]))
    straight = {
        at: (last.target, move)
        for at, (last, move) in enumerate(pairwise(program.moves), 1)
        if last is not None and move is not None and move.straight
        if done[last.target] and done[move.target]
    }
    ends = np.array([(begin, move.target) for begin, move in straight.values()], dtype=np.intp)
    q, wanted = (
        corrections.joints[ends.reshape(-1, 2)],
        corrections.targets.poses[ends.reshape(-1, 2)],
    )
    errors, moves = line_errors(arms, q, wanted).tolist(), dict[int, StraightMove]()
    for i, (at, (begin, move)) in enumerate(straight.items()):
        straight_move = StraightMove(begin, move.target, move.line, errors[i], none)
        if bound is not None and move.fixed:
            straight_move = replace(
                straight_move, why=move.fixed if straight_move.error > bound else ""
            )
        elif bound is not None:
            apart = divided(arms, straight_move, q[i], wanted[i], bound)
            if not program.fits(program.targets[move.target], apart.inserted).all():
                why = "in between the arm leaves the configuration that the target states"
                apart = replace(straight_move, why=why)
            straight_move = apart
        moves[at] = straight_move
    return moves


def _remarks(tool: Tool, arms: Arms, result: Any) -> tuple[str, ...]:
    """What the correction assumes."""
    said = []
    if isinstance(result, Limb) and result.shared:
        joints = ", ".join(result.shared)
        said.append(f"Other limbs hang on {joints}: what is corrected there shifts them too.")
    if not tool.observed:
        said.append(
            "The turn of the tool on the last link was not measured: its nominal turn is used."
        )
    unlimited = [joint for joint in arms.joints if joint not in arms.limits]
    if unlimited:
        said.append(
            f"No limits are stated for {', '.join(unlimited)}: limits of joints are not checked."
        )
    at = {name: np.array([value]) for name, value in arms.machine.constants.items()}
    said += result.predictor.unlike(at)
    return tuple(said)
