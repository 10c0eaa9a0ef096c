"""The two arms of a correction: the machine as it was calibrated, and the model of its controller.

Both give poses of the same tool in the base of the arm, at the same joint readings.

The pose of an arm's tool, and how it moves with joints and parameters, for many poses at once.

A tape gives four points of the body: the tool's own point t, and b, b + e_x, b + e_y of its frame.
From these follow the pose (t, R R_tool) and, from their derivatives, its twists

    v = dt,    w = 1/2 sum_i r_i x dr_i,    r_i the columns of R.

The same holds for the calibrated machine, whose body sags, and for the model of a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.rigid import Tool
from loopcal.errors import Code, InputError, listed
from loopcal.estimation.problem.alignment import align
from loopcal.expressions.engine import Stage, engine_for
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.expressions.vectors import vector
from loopcal.files.machines.further_points import with_points
from loopcal.lazy import cached_property
from loopcal.measurements.checks import cold_as_kelvin
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.limits import Limit, joint_limits
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.mechanisms.rotations import skew
from loopcal.mechanisms.serial import places_itself
from loopcal.mechanisms.station import Station, pose_of
from loopcal.mechanisms.structure.structured import EFFECT

_BODY = {"body_o": (0.0, 0.0, 0.0), "body_x": (1.0, 0.0, 0.0), "body_y": (0.0, 1.0, 0.0)}
_TOOL = "body_tool"
# Random readings around home: many times the six freedoms of a base.
_PLACES = 60
_REACH = {"rad": 1.0, "m": 0.1}
"""Around home, readings at which a base is sought."""
_USUAL = {"K": (22.0, "degC")}
"""Unit of a constant -> a value that a workshop has."""


@dataclass(frozen=True, eq=False)
class Arms:
    """machine, controller: T(q) of the tool; joints: name -> SI unit; limits: of those whose limits
    are stated."""

    machine: ArmPose
    controller: ArmPose
    joints: Mapping[str, str]
    limits: Mapping[str, Limit]
    tool: Tool

    @cached_property
    def spans(self) -> Array:
        """(n, 2) lowest and highest readings [SI]; infinite where no limit is stated."""
        rows = [self.limits.get(q, Limit(-np.inf, np.inf)) for q in self.joints]
        return np.array([(limit.low, limit.high) for limit in rows])


def arms_of(
    calibrated: Mechanism,
    nominal: Mapping[str, float],
    tool: Tool,
    controller: Mechanism | None = None,
    at: Mapping[str, float] | None = None,
    home: Mapping[str, float] | None = None,
) -> Arms:
    """The arms of a calibrated mechanism and its controller.

    nominal: values [SI] of the controller's parameters, those of the drawing, unless a `controller`
    is given, an arm with the same joints; at: constants of the programme such as temperatures, name
    -> value [SI]; home: joint readings [SI] amid the measured poses. Raises InputError for what is
    no arm of joints, for a controller with other joints, and for constants that are not stated.
    """
    joints = arm_joints(calibrated)
    if controller is not None and arm_joints(controller).keys() != joints.keys():
        raise InputError(
            f"the controller's model has the joints {listed(arm_joints(controller))}, the "
            f"calibrated arm {listed(joints)}",
            code="unknown-name",
            remedy="name the joints of the controller's model as those of the result",
        )
    machine, stiff = _machine(calibrated, tool, joints, at or {})
    tool = tool.moved_to(stiff.tool_on_body())
    of_controller = _controller(controller, calibrated, nominal, tool, tuple(joints))
    if places_itself(calibrated):
        middle = np.array([(home or {}).get(q, 0.0) for q in joints])
        machine = _based(machine, of_controller, joints, middle)
    limits = joint_limits(calibrated) if controller is None else joint_limits(controller)
    return Arms(machine, of_controller, joints, limits or joint_limits(calibrated), tool)


def arm_joints(mechanism: Mechanism, poses: Dataset | None = None) -> dict[str, str]:
    """The joints of an arm from base to tip, name -> SI unit; refuses what is no arm.

    poses: of the calibration, by which a limb is offered.
    """
    if not mechanism.chain:
        refuse_limbs(mechanism, poses, f"{mechanism.name!r} has several limbs, and a program one")
        raise InputError(
            f"{mechanism.name!r} is not a serial arm",
            code="unsupported",
            remedy="correct targets of serial arms; for parallel machines export the parameters",
        )
    return dict(mechanism.joints)


def refuse_limbs(mechanism: Mechanism, poses: Dataset | None, words: str) -> None:
    """Raise InputError for a robot of several limbs, of which the one that was read most is offered
    as an example."""
    if mechanism.tree is None or mechanism.chain:
        return
    limbs, readings = mechanism.tree.leaves, {} if poses is None else poses.readings
    read = dict.fromkeys(limbs, 0)
    for family in mechanism.families:
        for body in {family.on, family.against} & {*limbs}:
            of_body = [readings[q] for q in family.readings if q in readings]
            read[body] += sum(int(np.isfinite(values).sum()) for values in of_body)
    raise InputError(
        f"{words}. They end at {listed(limbs)}",
        code="unsupported",
        remedy="name the body at the end of the one that is meant: --limb BODY, in Python "
        "result.limb(BODY)",
    ).offering("--limb", max(limbs, key=lambda body: read[body]))


def _machine(
    calibrated: Mechanism,
    tool: Tool,
    joints: Mapping[str, str],
    at: Mapping[str, float],
) -> tuple[ArmPose, ArmPose]:
    """The machine, and the same without its structured model error."""
    # What reads x and y alone says nothing of heights: the tool is looked at from the base.
    stands = (f.placement for f in calibrated.families if isinstance(f.placement, Station))
    station = next((one for one in stands if not one.flat), None)
    values = calibrated.parameters.nominal
    points = {_TOOL: tool.point, **_BODY}
    looked_at = with_points(calibrated, points, station.name if station else None)
    looked_at = looked_at.with_nominal(values)
    tape = looked_at.tape
    coordinates = [f"{name}_{axis}" for name in points for axis in "xyz"]
    tape = tape.only([tape.loops.index(name) for name in coordinates])
    machine = ArmPose(
        tape,
        np.array([p.nominal for p in looked_at.parameters]),
        tuple(joints),
        _constants(looked_at, tape, at),
        np.eye(4) if station is None else product(station.steps, {}, values),
        pose_of(tool.of_machine)[:3, :3],
    )
    beyond = set(calibrated.effects.get(EFFECT, ()))
    rigid = [0.0 if p.name in beyond else p.nominal for p in looked_at.parameters]
    return machine, replace(machine, parameters=np.array(rigid))


def _constants(mechanism: Mechanism, tape: Tape, at: Mapping[str, float]) -> dict[str, float]:
    """The known constants of every target; those that the pose does not depend on are 0."""
    stated, names = {**mechanism.latest, **at}, tape.pose_constants
    used = frozenset().union(*tape.depends_on())
    unknown = [name for name in at if name not in mechanism.pose_constants]
    missing = [n for n in names if n not in stated and n in used]
    units = mechanism.pose_constants
    cold = [n for n, value in at.items() if cold_as_kelvin(value, units.get(n))]
    if unknown or missing or cold:
        words = (
            f"there is no constant {unknown[0]!r}"
            if unknown
            else f"the result depends on {listed(missing)}, which no target states"
            if missing
            else f"{cold[0]!r} is {at[cold[0]]:g} K: this looks like degC"
        )
        code: Code = (
            "unknown-name" if unknown else "missing-reading" if missing else "implausible-unit"
        )
        again = missing or cold or [*mechanism.pose_constants]
        usual = {n: _USUAL.get(units[n], (1.0, units[n])) for n in again}
        values = [f"{n}={at.get(n, value):g} {unit}" for n, (value, unit) in usual.items()]
        raise InputError(words, code=code, remedy=f"state {listed(again)} with a unit").offering(
            *(part for value in values for part in ("--at", value))
        )
    return {name: stated.get(name, 0.0) for name in names}


def _based(
    machine: ArmPose, controller: ArmPose, joints: Mapping[str, str], home: Array
) -> ArmPose:
    """The machine in the base that its controller has: the chain alone does not say where it is.

    The base lies where the controller's tool points come nearest to the machine's, at readings
    around those of the measured poses.
    """
    reach = np.array([_REACH[unit] for unit in joints.values()])
    q = home + reach * np.random.default_rng(0).uniform(-1.0, 1.0, (_PLACES, len(joints)))
    seen, drawn = (arm(q)[:, :3, 3].T for arm in (machine, controller))
    alignment = align(drawn, seen)
    return replace(machine, base=rigid(alignment.rotation, alignment.shift))


def _controller(
    controller: Mechanism | None,
    calibrated: Mechanism,
    nominal: Mapping[str, float],
    tool: Tool,
    joints: tuple[str, ...],
) -> ArmPose:
    chain = calibrated.chain if controller is None else controller.chain
    values = nominal if controller is None else controller.parameters.nominal
    names = tuple(dict.fromkeys(step.parameter for step in chain if step.parameter))
    return ArmPose(
        _chain_tape(chain, joints, names, tool),
        np.array([values[name] for name in names]),
        joints,
        {},
        np.eye(4),
        pose_of(tool.of_controller)[:3, :3],
    )


def _chain_tape(
    chain: tuple[Step, ...], joints: tuple[str, ...], parameters: tuple[str, ...], tool: Tool
) -> Tape:
    points = (tuple(tool.of_controller[:3]), *_BODY.values())

    def loops(x: Any, p: Any) -> list[Any]:
        frame = ChainFrame(chain, x, p)
        return [value for point in points for value in frame.point(vector(*map(float, point)))]

    return trace(loops, quantities=joints, parameters=parameters)


_BLOCK = 256


@dataclass(frozen=True, eq=False)
class ArmPose:
    """T(q) of a tool in the base of its arm.

    tape: values of the points (12) [m] where its readings are zero but for the joints; parameters:
    (n_all,) [SI]; joints: their names; known: constants of every pose, name -> value [SI]; base:
    (4, 4) of the arm's base in the frame of the tape; tool: (3, 3) R_tool.
    """

    tape: Tape
    parameters: Array
    joints: tuple[str, ...]
    constants: Mapping[str, float]
    base: Array
    tool: Array

    def __call__(self, q: Array) -> Array:
        """(N, 4, 4) at joints q (N, n) [rad, m]."""
        points, _, _ = self._points(q, (), Stage.VALUES)
        t, R = _frame(points)
        return inverse(self.base) @ rigid(R @ self.tool, t)

    def tool_on_body(self) -> Array:
        """(3,) where the tool's point is on the body, after the last change along the run [m]."""
        points, _, _ = self._points(np.zeros((1, len(self.joints))), (), Stage.VALUES)
        t, R = _frame(points)
        on_body: Array = R[0].T @ (t[0] - points[0, 3:6])
        return on_body

    def moving(self, q: Array) -> tuple[Array, Array]:
        """(N, 4, 4) at joints q (N, n), and (N, 6, n) the twists by the joints."""
        points, by_joint, _ = self._points(q, (), Stage.BY_QUANTITY)
        t, R = _frame(points)
        T = inverse(self.base) @ rigid(R @ self.tool, t)
        return T, _twist(R, by_joint, self.base[:3, :3].T)

    def twists(self, q: Array, names: Sequence[str] = ()) -> tuple[Array, Array]:
        """(N, 6, n) by the joints and (N, 6, p) by the named parameters, in the arm's base."""
        stage = Stage.BY_PARAMETER if names else Stage.BY_QUANTITY
        points, by_joint, by_parameter = self._points(q, tuple(names), stage)
        _, R = _frame(points)
        turn = self.base[:3, :3].T
        return _twist(R, by_joint, turn), _twist(R, by_parameter, turn)

    def _points(self, q: Array, names: tuple[str, ...], stage: Stage) -> tuple[Array, Array, Array]:
        """(N, 12) points, (N, 12, n) by joints, (N, 12, p) by parameters."""
        quantities = self.tape.quantities
        rows = [quantities.index(joint) for joint in self.joints]
        engine = engine_for(self.tape, names, min(_BLOCK, max(len(q), 1)), self.joints)
        constants = np.array([self.constants[name] for name in self.tape.pose_constants])
        points = np.empty((len(q), 12))
        by_joint = np.empty((len(q), 12, len(self.joints)))
        by_parameter = np.empty((len(q), 12, len(names)))
        for begin in range(0, len(q), _BLOCK):
            part = slice(begin, min(begin + _BLOCK, len(q)))
            x = np.zeros((len(quantities), len(q[part])))
            x[rows] = q[part].T
            by_pose = np.broadcast_to(constants[:, None], (len(constants), x.shape[1]))
            values = engine.evaluate(self.parameters, x, np.ascontiguousarray(by_pose), stage)
            points[part] = values.f.T
            if stage >= Stage.BY_QUANTITY:
                by_joint[part] = values.by_quantity.transpose(2, 1, 0)
            if stage >= Stage.BY_PARAMETER:
                by_parameter[part] = values.by_parameter.transpose(2, 1, 0)
        return points, by_joint, by_parameter


def _frame(points: Array) -> tuple[Array, Array]:
    """The tool's point (N, 3) and R (N, 3, 3): the rotation nearest to the axes that are given.

    Of M = [x y], M (M^T M)^-1/2, the root of a matrix of 2 rows by its trace and determinant.
    """
    b = points[:, 3:6]
    x, y = points[:, 6:9] - b, points[:, 9:12] - b
    xx, xy, yy = (np.einsum("ni,ni->n", u, v)[:, None] for u, v in ((x, x), (x, y), (y, y)))
    root = np.sqrt(xx * yy - xy * xy)
    scale = root * np.sqrt(xx + yy + 2.0 * root)
    x, y = ((yy + root) * x - xy * y) / scale, ((xx + root) * y - xy * x) / scale
    z = np.einsum("nij,nj->ni", skew(x), y)
    return points[:, :3], np.stack([x, y, z], axis=-1)


def _twist(R: Array, by: Array, turn: Array) -> Array:
    """(N, 6, n) twists of derivatives (N, 12, n) of the points, turned into the arm's base."""
    dx, dy = (by[:, i : i + 3] - by[:, 3:6] for i in (6, 9))
    X, Y, Z = (skew(R[:, :, i]) for i in range(3))
    # dz = dx x y + x x dy
    w = 0.5 * ((X - Z @ Y) @ dx + (Y + Z @ X) @ dy)
    return np.concatenate([turn @ by[:, :3], turn @ w], axis=1)
