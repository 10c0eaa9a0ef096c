"""What of a calibration can be entered into a controller or simulator, and its accuracy.

A machine is exported as its geometry. Where the calibration found effects beyond geometry (sag,
gears, a smooth discrepancy), the geometric parameters are refitted. Their goal is what the full
model predicts in the working region, and the remaining error is stated. Beside it stands the error
of zeros, tool and base alone, for controllers that keep their nominal geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.robot.refit import Goal, Refit, SeenPoint, refit, seen_points, separable
from loopcal.document.accuracy import Distances
from loopcal.document.exported import Exported, ModelAccuracy, Placed, ZeroOffset
from loopcal.document.result_document import ResultDocument
from loopcal.estimation.accuracy import Accuracy
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.constants import as_now, constants_by_pose, with_implied
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.files.machines.further_points import with_points
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.instruments.camera import all_cameras
from loopcal.mechanisms.limits import listed_joints
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, calibrated_origins
from loopcal.mechanisms.outputs import POLAR, cartesian_slopes
from loopcal.mechanisms.parameters import BEYOND
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.rest import rest_chain
from loopcal.mechanisms.serial import places_itself
from loopcal.mechanisms.station import MOTIONS, Station
from loopcal.mechanisms.structure.structured import EFFECT
from loopcal.mechanisms.tree import BODY
from loopcal.small_samples import t_quantile
from loopcal.statistics.case import instruments_alone
from loopcal.statistics.predictor import Predictor

# 1200 coordinates are some times the parameters of any arm (record 0080).
_POSES = 400
_POINT = "point:"


def exported(
    document: ResultDocument,
    mechanism: Mechanism,
    poses: Dataset | None,
    predictor: Predictor | None,
    *,
    offsets_apart: bool = False,
) -> Exported:
    """A calibrated machine for export.

    document, mechanism: of a result; poses: its readings, without which no accuracy at them is
    known; predictor: what predicts, without which no models are compared; offsets_apart:
    whether the zero offsets of joint origins stand beside them.
    """
    values = {p.name: p.value for p in document.parameters}
    name = document.mechanism.name if document.mechanism else mechanism.name
    if not mechanism.joints:
        eyes, images = _eyes(mechanism, values), _images(mechanism)
        return Exported(name, None, (), document.parameters, values, eyes=eyes, images=images)
    effects = {n for names in mechanism.effects.values() for n in names}
    beyond = {n: v for n in effects - instruments_alone(mechanism) if (v := values[n]) != 0.0}
    if predictor is not None and poses is not None:
        kept = [i for i, pose in enumerate(poses.poses) if pose not in document.data.discarded]
        poses = after_last_change(predictor.mechanism, poses.take(kept))
    full = None if predictor is None else _Full.of(document, predictor, poses)
    bare = {n: 0.0 if n in effects else v for n, v in values.items()}
    geometry, warnings = bare, list[str]()
    if beyond and full is not None:
        free = [p.name for p in mechanism.parameters if not p.fixed and p.role not in BEYOND]
        units = {p.name: p.unit for p in mechanism.parameters}
        refitted = refit(full.goals, bare | full.standing, free, units=units)
        geometry = {n: v for n, v in refitted.values.items() if n in bare}
    elif beyond:
        warnings.append(
            "The geometry is not refitted to the full model: it is written as a function, or no "
            "instrument sees a point. Expect errors as large as the effects that are left out."
        )
    zeros = None if full is None else _zeros(document, mechanism, full, bare)
    described = mechanism.description or {}
    joints = [j for j in listed_joints(mechanism) if isinstance(j, LinkJoint)]
    origins = calibrated_origins(
        joints, geometry, axes=bool(described.get("axes")), apart=offsets_apart
    )
    frames = list(_frames(mechanism, geometry, "geometry"))
    accuracy: tuple[ModelAccuracy, ...] = ()
    if full is not None and zeros is not None:
        frames += _frames(mechanism, zeros.refit.values, "zeros and tool")
        accuracy = _accuracy(document, full, zeros, geometry)
    return Exported(
        name,
        rest_chain(mechanism.chain, geometry) if mechanism.chain else None,
        origins,
        document.parameters,
        geometry,
        () if zeros is None else zeros.rows,
        tuple(frames),
        accuracy,
        _omitted(mechanism, beyond),
        tuple(warnings),
        {
            one.name: one.limits
            for one in listed_joints(mechanism)
            if getattr(one, "limits", None) and getattr(one, "mimic", None) is None
        },
        _links(joints, geometry, axes=bool(described.get("axes"))) if mechanism.chain else {},
        images=_images(mechanism),
    )


def _images(mechanism: Mechanism) -> dict[str, tuple[int, int]]:
    """Sizes of images that are stated, by camera."""
    every = all_cameras(mechanism)
    return {one.name: one.intrinsics.image for one in every if one.intrinsics.image}


def _eyes(mechanism: Mechanism, values: Mapping[str, float]) -> dict[str, tuple[bool, Array]]:
    """Stations of poses by name: whether the body carries them, and their places."""
    return {
        one.placement.name: (
            one.against == BODY,
            inverse(product(one.placement.steps, {}, values)),
        )
        for one in mechanism.families
        if one.form == "pose" and isinstance(one.placement, Station) and one.placement.name
    }


def _links(
    joints: Sequence[LinkJoint], values: Mapping[str, float], *, axes: bool
) -> dict[str, Array]:
    """Joint -> frame of the link behind it in the base's frame, all joints at zero."""
    T, frames = np.eye(4), {}
    for joint in joints:
        read = joint.reads
        still = {} if read is None else {read[0]: 0.0}
        T = T @ product(list(joint.steps(axes=axes)), still, values)
        frames[joint.name] = T
    return frames


@dataclass(frozen=True, eq=False)
class _Full:
    """The full model in the working region: what it predicts there, and from which readings.

    floating: parameters of where the base stands, 0 in the full model, of an arm that has none:
    lengths alone are measured, which do not determine it, or its own transitions hold it.
    """

    predictor: Predictor
    seen: tuple[SeenPoint, ...]
    goals: tuple[Goal, ...]
    x: Array
    constants: Array
    poses: Dataset | None
    floating: tuple[str, ...]

    @classmethod
    def of(
        cls, document: ResultDocument, predictor: Predictor, poses: Dataset | None
    ) -> _Full | None:
        """None for an arm written as a function, a tree of which no point is seen, and where the
        region is unknown."""
        machine, floating = predictor.mechanism, Station(None)
        seen = seen_points(machine)
        if not seen and not machine.chain:
            return None
        if not seen:
            floating = Station("base:")
            machine = _looked_at(machine)
            predictor = replace(predictor, mechanism=machine)
            seen = seen_points(machine)
        elif places_itself(machine):
            floating = Station("base:")
        seen = tuple(replace(one, steps=(*floating.steps, *one.steps)) for one in seen)
        names = machine.tape.quantities
        stored = document.prediction
        ranges = {}
        if stored is not None and stored.region is not None:
            ranges = {r.quantity: (r.low, r.high) for r in stored.region.ranges}
        joints = list(machine.joints)
        if poses is not None:
            measured = {q: poses.readings[q] for q in joints if q in poses.readings}
            read = {q: v[np.isfinite(v)] for q, v in measured.items()}
            spans = {q: (float(v.min()), float(v.max())) for q, v in read.items() if len(v)}
            ranges = spans | ranges
        if not set(joints) <= ranges.keys():
            return None
        rng = np.random.default_rng(0)
        # Disturbances are predicted at their mean, 0.
        home = {q: v for q, v in predictor.typical.items() if q not in machine.disturbances}
        x = np.repeat([[home.get(q, 0.0)] for q in names], _POSES, axis=1)
        for q, (low, high) in ranges.items():
            if q in names:
                x[names.index(q)] = rng.uniform(low, high, _POSES)
        constants = _constants(machine, poses, rng)
        values = np.array([p.nominal for p in machine.parameters])
        x[[names.index(q) for q in machine.outputs]] = predict_outputs(
            machine, values, x, constants
        )
        good = np.isfinite(x).all(axis=0)
        x, constants = x[:, good], constants[:, good]
        goals = tuple(Goal.of(one, dict(zip(names, x, strict=True))) for one in seen)
        if not good.any():
            return None
        return cls(predictor, seen, goals, x, constants, poses, floating.parameters)

    @property
    def standing(self) -> dict[str, float]:
        """The floating parameters in the full model, and those of a point that is looked at."""
        looked_at = self.predictor.mechanism.parameters.nominal
        added = {n: v for n, v in looked_at.items() if n.startswith(_POINT)}
        return {**added, **dict.fromkeys(self.floating, 0.0)}

    def by_parameter(self) -> Array:
        """(rows, n) derivatives of all points of the goals by the estimated parameters."""
        machine = self.predictor.mechanism.predicting()
        values = np.array([p.nominal for p in machine.parameters])
        kept = [self.predictor.mechanism.tape.quantities.index(q) for q in machine.tape.quantities]
        S = output_sensitivity(
            machine, values, self.predictor.names, self.x[kept], self.constants
        ).by_parameter
        parts = []
        for goal in self.goals:
            rows = [machine.outputs.index(q) for q in goal.seen.outputs]
            part = S[:, rows]
            if goal.seen.family.form in POLAR:
                names = self.predictor.mechanism.tape.quantities
                part = cartesian_slopes(self.x[[names.index(q) for q in goal.seen.outputs]]) @ part
            parts.append(part.reshape(-1, S.shape[2]))
        return np.vstack(parts)


def _looked_at(machine: Mechanism) -> Mechanism:
    """An arm of which no point is measured, the point that is looked at as its only output."""
    mounted = next((f.mounted for f in machine.families if len(f.mounted) >= 3), ())
    target = [n for n in mounted if machine.parameters[n].unit == "m"][:3]
    made = with_points(machine, {_POINT: target or (0.0, 0.0, 0.0)}, None)
    outputs = tuple(f"{_POINT}_{axis}" for axis in "xyz")
    kept = [made.tape.loops.index(name) for name in outputs]
    families = tuple(family for family in made.families if family.name == _POINT)
    made = replace(made, outputs=outputs, families=families)
    return made.with_tape(lambda tape: tape.only(kept))


def _constants(machine: Mechanism, poses: Dataset | None, rng: np.random.Generator) -> Array:
    """Known constants (c, N) of each pose: as after the last change, else as in measured poses."""
    names = machine.tape.pose_constants
    constants = np.zeros((len(names), _POSES))
    for i, name in enumerate(names):
        if name in machine.latest:
            constants[i] = machine.latest[name]
        elif poses is not None and name in poses.readings:
            constants[i] = poses.readings[name][rng.integers(0, len(poses), _POSES)]
    return constants


@dataclass(frozen=True, eq=False)
class _Zeros:
    """rows; refit: of zeros, tool and base; nominal: of tool and base alone."""

    rows: tuple[ZeroOffset, ...]
    refit: Refit
    nominal: Refit


def _zeros(
    document: ResultDocument, mechanism: Mechanism, full: _Full, bare: Mapping[str, float]
) -> _Zeros:
    """Zeros, tool and base alone: the drawing's geometry refitted by these to the full model."""
    roles = mechanism.roles
    nominal = {p.name: p.nominal for p in document.parameters}
    placed = ("mounting",) if full.floating else ("placement", "mounting")
    start = {n: v if roles[n] in placed else nominal[n] for n, v in bare.items()}
    start |= {n: 0.0 for effect_parameters in mechanism.effects.values() for n in effect_parameters}
    start |= full.standing
    names = [p.name for p in mechanism.parameters if not p.fixed and p.role in placed]
    names += full.floating
    joints = mechanism.joints
    determined = separable(full.goals, start, names, list(joints))
    refitted = refit(full.goals, start, names, determined)
    spread = full.predictor.covariance.through(refitted.map @ full.by_parameter())
    sd = np.sqrt(np.maximum(np.diag(spread.matrix), 0.0))
    half = {
        n: t_quantile(0.95, float(f)) * float(s)
        for n, s, f in zip(refitted.names, sd, spread.freedom, strict=True)
    }
    rows = tuple(
        ZeroOffset(q, unit, refitted.offsets.get(q, 0.0), half.get(q), q in determined)
        for q, unit in joints.items()
    )
    return _Zeros(rows, refitted, refit(full.goals, start, names))


def _accuracy(
    document: ResultDocument, full: _Full, zeros: _Zeros, geometry: Mapping[str, float]
) -> tuple[ModelAccuracy, ...]:
    """The four models beside the measured poses and the full model."""
    stated = document.accuracy
    nominal = calibrated = None
    instruments = {family.name for family in full.predictor.mechanism.families}
    if stated is not None and not {one.instrument for one in stated.by} <= instruments:
        # Of one limb: what was computed at the poses counts all limbs.
        alike = [one.position for one in stated.by if one.instrument in instruments]
        calibrated = alike[0].after if len(alike) == 1 and alike[0] else None
    elif stated is not None and stated.unit == "m":
        nominal, calibrated = stated.nominal, stated.after
    if full.predictor.mechanism.latest:  # the stated one is of the machine before its changes too
        nominal = None
    alone = Refit({**geometry, **full.standing}, {}, (), np.empty((0, 0)))

    def reached(name: str, model: Refit, measured: Distances | None = None) -> ModelAccuracy:
        away = _distances(model.distances(full.goals))
        return ModelAccuracy(name, measured or _measured(full, model), away)

    return (
        reached("nominal", zeros.nominal, nominal),
        reached("zeros and tool", zeros.refit),
        reached("geometry", alone),
        ModelAccuracy("full", calibrated, None),
    )


def _measured(full: _Full, model: Refit) -> Distances | None:
    """Computed minus measured at the poses of the calibration."""
    if full.poses is None:
        return None
    readings = full.poses.readings
    measured = [seen for seen in full.seen if all(q in readings for q in seen.outputs)]
    goals = [Goal.of(seen, readings) for seen in measured]
    return _distances(model.distances(goals)) if goals else None


def _distances(distances: Array) -> Distances | None:
    accuracy = Accuracy.of(distances, "m")
    return None if accuracy is None else accuracy.distances


def _frames(mechanism: Mechanism, values: Mapping[str, float], model: str) -> tuple[Placed, ...]:
    """Tools on the flange or their body, stations beside the base or theirs; of transitions, which
    have none, axis 1."""
    placed: dict[str, Placed] = {}
    for family in mechanism.families:
        units = [(n, mechanism.parameters[n].unit) for n in family.mounted]
        shift = [n for n, unit in units if unit == "m"][:3]
        turns = [n for n, unit in units if unit == "rad"]
        if len(shift) == 3 and len(turns) in (0, 3):
            tool = mechanism.parameters[shift[0]].owner
            named = zip(MOTIONS[3], [*shift, *turns], strict=False)
            T = product([Step(motion, name) for motion, name in named], {}, values)
            flange = "flange" if family.on == BODY else family.on
            placed.setdefault(tool, Placed(tool, flange, T, bool(turns), model))
        stands = family.placement
        if isinstance(stands, Station) and stands.name is not None and len(stands.steps) == 6:
            T = product(stands.steps, {}, values)
            name = stands.name if stands.name != "base" else "instrument"
            base = family.against
            placed.setdefault(f"{base} in {name}", Placed(base, name, T, True, model))
            placed.setdefault(f"{name} in {base}", Placed(name, base, inverse(T), True, model))
    if places_itself(mechanism):
        ahead = Station("base:").steps if "base:_x" in values else ()
        first = rest_chain((*ahead, *mechanism.chain), values).along_z.joints[0]
        name = f"axis of {first.name} (z)"
        placed[name] = Placed(name, "instrument", first.before, True, model)
    return tuple(placed.values())


def _omitted(mechanism: Mechanism, beyond: Mapping[str, float]) -> tuple[str, ...]:
    """Names of the effects, and of the terms of the model error, that are not geometry."""
    omitted = []
    for name, effect_parameters in mechanism.effects.items():
        if name != EFFECT:
            omitted += [name] * any(n in beyond for n in effect_parameters)
            continue
        for term in mechanism.terms:
            if any(n in beyond for n in term.parameters if n in effect_parameters):
                omitted.append(term.name)
    return tuple(omitted)


# Poses of a machine that changed along its run, as it would be read after the last change.


def after_last_change(machine: Mechanism, poses: Dataset) -> Dataset:
    """The poses with outputs y + f(q, now) - f(q, then): what the model says changed since then.

    machine: a calibrated one; f: its outputs [SI] with the constants as after the last change, and
    as they were. Poses stay as they are where the machine did not change or nothing dates them.
    """
    dated = [name for name in machine.latest if name in poses.readings]
    if not dated:
        return poses
    data = with_implied(machine, poses)
    # Only the difference counts, so what the model does not explain in a reading stays in it.
    then = constants_by_pose(machine, data)
    now = as_now(machine, then)
    values = np.array([p.nominal for p in machine.parameters])
    x = np.array([_read(machine, data, q) for q in machine.tape.quantities])
    moved = predict_outputs(machine, values, x, now) - predict_outputs(machine, values, x, then)
    seen = {q: poses.readings[q] + d for q, d in zip(machine.outputs, moved, strict=True)}
    return poses.with_readings(seen)


def _read(machine: Mechanism, data: Dataset, quantity: str) -> NDArray[np.float64]:
    """(N,) readings; without any, the value at home, which is 0 for errors of the model."""
    if quantity in data.readings:
        return data.readings[quantity]
    return np.full(len(data), machine.home.get(quantity, 0.0))
