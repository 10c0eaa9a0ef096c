"""The skeleton of a machine in one pose: an arm from base to tool, or legs and platform."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.chain import Step, frames, product
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.parallel.registry import PARALLEL
from loopcal.mechanisms.placement import ChainPlacement, rigid
from loopcal.mechanisms.serial import tool_names
from loopcal.mechanisms.station import Station, Target
from loopcal.mechanisms.tree import BASE

_MOST, _SETTLED, _OPEN = 50, 1e-10, 0.05


def skeleton(mechanism: Mechanism, joints: Mapping[str, float]) -> Array | None:
    """Points (k, 3), or (k, 2) of a planar machine, [m]; lines are parted by a row of NaN.

    Of an arm from the first joint to the tool point, of a robot with several arms each of these,
    of a parallel machine its legs and bodies.
    joints: readings [m, rad] of one pose. In the instrument's frame, with the mechanism's own
    parameters; None for mechanisms that are not machines of a known kind.
    """
    values = mechanism.parameters.nominal
    described = mechanism.description or {}
    if described.get("type") == "planar-two-link":
        return None if mechanism.families else _planar(values, joints)
    station = drawn_in(mechanism)
    kind = described.get("type")
    if kind in PARALLEL:
        machine = PARALLEL[kind]()
        lines = _parallel_lines(mechanism, machine, joints)
        T_station_base = product(station, {}, values)
        return None if lines is None else _seen(lines, T_station_base, machine.dimension)
    if not mechanism.joints:
        return None
    arms: list[Array] = []
    for path, tool in _branches(mechanism):
        T, points = product(station, {}, values), []
        for step in path:
            if step.joint is not None:
                points.append(T[:3, 3])
            T = T @ product([step], joints, values)
        at = np.array([values[name] for name in tool] or [0.0, 0.0, 0.0])
        points += [T[:3, 3], T[:3, :3] @ at + T[:3, 3]]
        arms.append(np.array(points))
    return _seen(arms, np.eye(4), 3)


def drawn_in(mechanism: Mechanism) -> tuple[Step, ...]:
    """T_drawn_base as steps: from the frame in which a machine is drawn, that of an instrument
    beside it, to its base; none where they are one."""
    root = BASE if mechanism.tree is None else mechanism.tree.root
    # Pixels are no points: a machine before cameras is drawn in its base.
    seen = (f for f in mechanism.families if f.form != PIXELS and f.against == root)
    stands = next((f.placement for f in seen if f.placement), None)
    return stands.steps if isinstance(stands, Station) else ()


def _branches(mechanism: Mechanism) -> list[tuple[tuple[Step, ...], tuple[str, ...]]]:
    """The steps to each leaf of a tree, and the parameters of what is looked at on it."""
    tree, lengths = mechanism.tree, {p.name for p in mechanism.parameters if p.unit == "m"}
    if tree is None or mechanism.chain:
        return [(mechanism.chain, target_names(mechanism))]
    mounted = {f.on: f.mounted for f in reversed(mechanism.families)}
    targets = {leaf: [n for n in mounted.get(leaf, ()) if n in lengths] for leaf in tree.leaves}
    return [(tree.path(leaf), tuple(at) if len(at) == 3 else ()) for leaf, at in targets.items()]


def body_poses(mechanism: Mechanism, readings: Mapping[str, Array]) -> Array | None:
    """T_base_body (N, 4, 4) [m] at readings (N,) by name; NaN where one is missing.

    None where the readings alone do not place the body, as in closed loops.
    """
    described = mechanism.description or {}
    kind = described.get("type")
    # What says that a body is not read says where the search for it begins.
    unread = {"read": False} if described.get("read") is False else {}
    machine = PARALLEL[kind](**unread) if kind in PARALLEL else None
    joints = tuple(mechanism.joints) if mechanism.chain else ()
    names = (*machine.quantities, *machine.pose_constants) if machine else joints
    if not names or not {*names} <= readings.keys() or (machine and machine.loops):
        return None
    made = mechanism if machine is None else machine
    return made.fk(readings)


def tree_poses(mechanism: Mechanism, readings: Mapping[str, Array], body: str) -> Array | None:
    """T_drawn_body (N, 4, 4) [m] of a body of a tree, or of a machine's only one, at readings (N,).

    NaN where a joint is not read; None where nothing places the body.
    """
    values = mechanism.parameters.nominal
    count = len(next(iter(readings.values()), ()))
    T_drawn_base = product(drawn_in(mechanism), {}, values)
    root = BASE if mechanism.tree is None else mechanism.tree.root
    if body == root:
        return np.broadcast_to(T_drawn_base, (count, 4, 4))
    if mechanism.tree is None or mechanism.chain:
        placed = body_poses(mechanism, readings)
        return None if placed is None else T_drawn_base @ placed
    lost = np.full(count, np.nan)
    path = mechanism.tree.path(body)
    joints = {s.joint: readings.get(s.joint, lost) for s in path if s.joint}
    if not joints:
        return np.broadcast_to(T_drawn_base @ product(path, {}, values), (count, 4, 4))
    *_, (R, origin) = frames(path, joints, values)
    return T_drawn_base @ rigid(R, origin)


def skeleton_labels(mechanism: Mechanism) -> tuple[str, ...]:
    """The name of the joint at each point of an arm's skeleton, and of its end; none of others.

    Where branches part the name of a joint stands once, and the ends are named as their bodies.
    """
    if (mechanism.description or {}).get("type") == "planar-two-link":
        return ("phi2", "phi3", "end point")
    labels: list[str] = []
    tree = None if mechanism.chain else mechanism.tree
    ends = ("end point",) if tree is None else tree.leaves
    for end, (path, _) in zip(ends, _branches(mechanism), strict=True):
        joints = [step.joint for step in path if step.joint]
        named = [joint if joint not in labels else "" for joint in joints]
        labels += [*([""] if labels else []), *named, *(["", end] if joints else [])]
    return tuple(labels)


def _seen(lines: Sequence[Array], T: Array, dimension: int) -> Array:
    """The lines as a station sees them that stands at T (4, 4), one below the other."""
    parted = [np.vstack([line @ T[:3, :3].T + T[:3, 3], np.full(3, np.nan)]) for line in lines]
    return np.vstack(parted)[:-1, :dimension]


def target_names(mechanism: Mechanism) -> tuple[str, ...]:
    """Parameters of the first instrument's target, in the body's frame; none if unknown."""
    if isinstance(mechanism.placement, ChainPlacement):
        return mechanism.placement.tool
    described = mechanism.description or {}
    if "instrument" not in described:
        return tool_names(described["joints"]) if "joints" in described else ()
    targets = [entry.get("target") for entry in described["instrument"]]
    target: str | list[str] = next((t for t in targets if t), [])
    return Target.named(target).parameters if isinstance(target, str) else tuple(target)


def _planar(values: Mapping[str, float], joints: Mapping[str, float]) -> Array:
    first = joints["phi2"] + values["phi20"]
    second = first + joints["phi3"] + values["phi30"]
    base = np.array([values["xA"], values["yA"]])
    elbow = base + values["l2"] * np.array([np.cos(first), np.sin(first)])
    return np.array(
        [base, elbow, elbow + values["l3"] * np.array([np.cos(second), np.sin(second)])]
    )


def _parallel_lines(
    mechanism: Mechanism, machine: Machine, readings: Mapping[str, float]
) -> list[Array] | None:
    """Lines (k, 3) [m] in the machine's base; None where the platform is not found.

    readings: [m, rad] of one pose, as far as there are any.
    """
    x = _located(mechanism, readings)
    if machine.lines is None or x is None:
        return None
    lines = machine.lines(x, mechanism.parameters.nominal)
    return [np.array(line, dtype=float) for line in lines]


def _located(mechanism: Mechanism, readings: Mapping[str, float]) -> dict[str, float] | None:
    """Readings, and what was not read of the machine, from home by Gauss and Newton's method."""
    tape = mechanism.tape
    # NaN marks what is not read; the loops that need it evaluate to NaN and are left out.
    x = {**dict.fromkeys(tape.quantities, np.nan), **mechanism.home, **readings}
    unread = tuple(q for q in mechanism.home if q not in readings)
    # One pose in a block of 64: the engine computes whole vectors either way.
    engine = engine_for(tape, (), 64, unread)
    nominal = np.array([p.nominal for p in mechanism.parameters])
    pose_constants = np.full((len(tape.pose_constants), 1), np.nan)
    step, f = np.zeros(0), np.zeros(0)
    for _ in range(_MOST):
        at = np.array([[x[q]] for q in tape.quantities])
        values = engine.evaluate(nominal, at, pose_constants, Stage.BY_QUANTITY)
        evaluated = np.isfinite(
            values.f[:, 0]
        )  # loops with readings that are not there say nothing
        f = values.f[evaluated, 0].copy()
        J = values.by_quantity[:, evaluated, 0].T
        if not np.isfinite(J).all() or len(f) < len(unread):
            return None
        step = np.linalg.lstsq(J, -f)[0]
        x |= {q: x[q] + float(change) for q, change in zip(unread, step, strict=True)}
        if np.abs(step).max(initial=0.0) <= _SETTLED:
            break
    return x if np.abs(f).max(initial=0.0) <= _OPEN else None
