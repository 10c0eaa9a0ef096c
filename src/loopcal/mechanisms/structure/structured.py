"""The structured model error of a machine: what it may have beyond geometry, without being asked.

Kinds of parameters have priors, and what every machine has to some degree is there as parameters
whose sds are learnt (`Term`): near zero where the data do not ask for them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, TypeVar

from loopcal.errors import InputError
from loopcal.expressions.rewriting import substituted
from loopcal.keys import Key, described
from loopcal.mechanisms.body import Body
from loopcal.mechanisms.effects.compliance import YIELD_SD
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.effects.scale import Scale
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters, matching
from loopcal.mechanisms.serial import places_itself
from loopcal.mechanisms.structure.sag import COUPLINGS, TOOL, Branch, Column, Sag, Stands, Structure
from loopcal.mechanisms.structure.smooth import DISCREPANCY, FEATURES, Smooth
from loopcal.mechanisms.terms import Term

MOUNTED = {"m": 5e-3, "rad": 50e-3}
"""Prior sds of what is mounted on the body: 5 mm, and that over the 0.1 m of a typical bracket."""
TILTED = math.radians(5.0)
"""Prior sd of each tilt of gravity against the machine's base."""
GRAVITY_TILT = "tilt of gravity against the base"
CARRIED = 0.2
"""Prior sd of the mass at the tool, as a share of the known masses: from a tenth to a third of its
own weight is what an arm is rated to carry."""
LOAD_MASS = "mass at the tool beyond the known ones"
EFFECT = "structure"
"""Name of all that is added, among the effects of a mechanism."""
DRIVES = ("harmonics", "scales")
"""Names of the terms of gears and encoders, and of slides."""
CHANGED = "_changed"
"""Ends the name of a term of what changed along the run in another term."""
GEOMETRY_TERMS: Mapping[tuple[str, str], tuple[str, float, str]] = {
    ("length", "m"): ("lengths", 1e-3, "lengths of the machine differ from the drawing by {scale}"),
    ("zero", "m"): ("slide_zeros", 1e-3, "zeros of slides differ from the drawing by {scale}"),
    ("zero", "rad"): ("zeros", 3e-3, "zeros of joints differ from the drawing by {scale}"),
    ("twist", "rad"): (
        "twists",
        1e-3,
        "turns between axes differ from the drawing by {scale}",
    ),
    ("angle", "rad"): ("angles", 1e-3, "angles of the machine differ from the drawing by {scale}"),
}
"""Role and unit of what a drawing states -> name, median of the learnt sd [SI], and words of its
term. Joints are mastered less exactly than links are machined (record 0046)."""
STRUCTURE_TERMS = (
    *(name for name, _, _ in GEOMETRY_TERMS.values()),
    "sag",
    "sag_across",
    "compliance",
    COUPLINGS,
    DISCREPANCY,
    "discrepancy_turns",
    *DRIVES,
    *(f"{name}{CHANGED}" for name in ("sag", "sag_across")),
)
"""Names of the terms that a structured mechanism may have."""
# Once per turn: off centre; twice: elliptic or tilted (see `Harmonics`).
ORDERS = (1.0, 2.0)
_UNITS = {"compliance": "rad/(N m)", COUPLINGS: "rad"}
DOWN = (0.0, 0.0, -1.0)

E = TypeVar("E", bound=Effect)
Sagging = Annotated[
    bool | tuple[str, ...],
    Key(
        "Whether an arm may give way under its weight and couplings be off; or by which parameters."
    ),
]


def structured(
    mechanism: Mechanism,
    *,
    sag: Sagging = True,
    harmonics: Annotated[bool, Key("Whether gears and encoders may be out of round.")] = True,
    discrepancy: Annotated[
        bool | int,
        Key(
            "Whether what remains may be a smooth function of the joints; or of how many waves it "
            "is made, 30 for `true`."
        ),
    ] = False,
) -> Mechanism:
    """The mechanism with the model error of a real machine, as parameters with learnt sds.

    Priors by role, where none is stated (see `Parameter.role`): placement flat; mounting known
    to 5 mm and 50 mrad, flat where all its values are 0 and so unstated; lengths, twists and
    zeros share a learnt sd each (see `GEOMETRY_TERMS`). Further parameters, nominally 0:

    - sag, of arms in space: JOINT_sag_AXIS_LOAD [rad/m] about the joints' axes (median 0.5 mrad per
      metre) and across them (0.2), and two tilts of gravity, known to 5 degrees (see `Sag`).
      Gravity pulls along `Mechanism.gravity`;
    - compliance, where masses or a payload are known: JOINT_yield [rad/(N m)] of each turning joint
      (median 1e-5, a stiffness of 1e5 N m/rad), to the moment of all known masses behind it;
    - couplings, of joints that follow another one's reading: JOINT_2_coupling_cos ... [rad]
      (median 0.2 mrad), where bars, belts or gears are off;
    - harmonics: JOINT_cos1 ... JOINT_sin2 [rad] of turning joints (median 0.1 mrad), and
      JOINT_scale of slides (median 1e-4);
    - discrepancy: smooth functions of the joints that shift the body (median 0.3 mm), and turn it
      too (median 0.3 mrad) where that is seen. A number says of how many waves they are made.

    Loops of a Python function are returned as they are, and so is a structured mechanism.
    Raises InputError for parameters of sag that the arm cannot have.
    """
    if mechanism.structure is not None or not _has_roles(mechanism):
        return mechanism
    old = set(mechanism.parameters.names)
    made = _with_priors(mechanism)
    arm = _arm(mechanism) if sag else None
    columns = _columns(mechanism, arm, sag)
    smooth: Mapping[str, Smooth] = {}
    if mechanism.body is not None:
        sag = tuple(c.parameter for c in columns)
        smooth = _smooth(mechanism, mechanism.body, discrepancy)
        made = _displaced(made, arm, columns, smooth)
    joints: list[str] = []
    if harmonics:
        made, joints = _with_drives(made)
    structure = Structure(arm if columns else None, columns, smooth, tuple(joints), mechanism)
    made = _with_awaiting(replace(made, structure=structure))
    arguments = {"sag": sag, "harmonics": harmonics, "discrepancy": discrepancy}
    stated = {k: v for k, v in described(structured, arguments).items() if k != "type"}
    description = mechanism.description
    return replace(
        made,
        description=None if description is None else {**description, "structure": stated},
        parameters=made.parameters.with_role(
            "model error", (n for n in made.parameters.names if n not in old), EFFECT
        ),
    )


def without(
    mechanism: Mechanism,
    structured_mechanism: Mechanism,
    terms: Collection[str],
    stiff: Collection[str] = (),
) -> Mechanism:
    """A mechanism structured like another, but for the terms of these names, and sag of joints.

    The drives of turning joints and of slides stay together.
    """
    made = structured_mechanism
    kept = [term for term in made.terms if term.name not in terms]
    names = {name for term in kept for name in term.parameters}
    structure = made.structure or Structure()
    remaining = [*structure.smooth.values()] if any(t.name == DISCREPANCY for t in kept) else []
    return structured(
        mechanism,
        sag=tuple(
            c.parameter for c in structure.columns if c.parameter in names and c.joint not in stiff
        ),
        harmonics=any(term.name in DRIVES for term in kept),
        discrepancy=max((len(smooth.harmonics) for smooth in remaining), default=False),
    )


def loadable(mechanism: Mechanism) -> Mechanism:
    """The mechanism with the sag that another load on its tool causes, nominally 0, where its model
    error has none; any other mechanism as it is."""
    structure = mechanism.structure
    if structure is None or structure.plain is None or structure.loaded:
        return mechanism
    plain: Mechanism = structure.plain
    if (arm := _arm(plain)) is None:
        return mechanism
    at_tool = (c for c in arm.columns(_turned(plain)) if c.load == TOOL)
    made = structured(
        plain,
        sag=tuple(c.parameter for c in (*structure.columns, *at_tool)),
        harmonics=bool(structure.joints),
        discrepancy=max((len(one.harmonics) for one in structure.smooth.values()), default=False),
    )
    before = {p.name: p for p in mechanism.parameters}
    if not before.keys() <= {*made.parameters.names}:  # what was added since would be lost
        return mechanism
    usual = {name: term.sd for term in made.terms for name in term.parameters}
    every = (
        before.get(p.name) or replace(p, prior_sd=usual.get(p.name, p.prior_sd))
        for p in made.parameters
    )
    # Terms stay as they are: after an update no parameter belongs to one.
    return replace(made, parameters=Parameters(tuple(every)), terms=mechanism.terms)


def scalable(mechanism: Mechanism, names: Container[str] | None = None) -> Mechanism:
    """The mechanism with the scales that its slides have when they are warm or set up anew,
    nominally 0, where it has none; loops of a Python function as they are. names: of those."""
    further = _further(mechanism, _scales_of_slides(mechanism)) if _has_roles(mechanism) else []
    some = [e for e in further if names is None or all(n in names for n in e.parameters(mechanism))]
    return with_effects(mechanism, some) if some else mechanism


def _has_roles(mechanism: Mechanism) -> bool:
    """Whether the roles of its parameters are stated: it has instruments or a placement."""
    return bool(mechanism.families) or mechanism.placement is not None


def _with_priors(mechanism: Mechanism) -> Mechanism:
    """Default priors by kind; what is stated stays."""
    flat = [p for p in mechanism.parameters if not p.fixed and math.isinf(p.prior_sd)]
    terms = [
        _term(name, [p.name for p in flat if (p.role, p.unit) == kind], sd, words)
        for kind, (name, sd, words) in GEOMETRY_TERMS.items()
    ]
    return mounted(mechanism).with_terms(*itertools.chain.from_iterable(terms))


def mounted(mechanism: Mechanism) -> Mechanism:
    """The mechanism with a default prior on the place of what is mounted, where one was drawn."""
    unknown = {name for names in unstated_mountings(mechanism) for name in names}
    priors = {
        p.name: MOUNTED[p.unit]
        for p in mechanism.parameters
        if p.role == "mounting" and not p.fixed and math.isinf(p.prior_sd) and p.name not in unknown
    }
    return mechanism.with_parameters(mechanism.parameters.with_prior(priors))


def unstated_mountings(mechanism: Mechanism) -> tuple[tuple[str, ...], ...]:
    """The parameters of each thing on the body without a stated place: all free, flat and 0."""
    if mechanism.body is None:
        return ()
    groups = [[mechanism.parameters[n] for n in names] for names in mechanism.body.mounted]
    return tuple(
        tuple(p.name for p in group)
        for group in groups
        if all(not p.fixed and math.isinf(p.prior_sd) and p.nominal == 0.0 for p in group)
    )


def _term(name: str, parameters: Sequence[str], sd: float, words: str) -> list[Term]:
    """The term, if it has any parameter."""
    return [Term(name, tuple(parameters), sd, words=words)] if parameters else []


def _arm(mechanism: Mechanism) -> Sag | None:
    """What may give way; None for a machine that is not an arm in space."""
    body = mechanism.body
    return None if body is None or body.planar else _in_space(mechanism)


def _in_space(mechanism: Mechanism) -> Sag | None:
    """What bears the bodies that are looked at; None where no joint does."""
    tree, body = mechanism.tree, mechanism.body
    if tree is None or body is None:
        return None
    paths = {name: tree.path(name) for name in body.displacements}
    ends = [
        name
        for name, path in paths.items()
        if any(step.joint for step in path)
        and not any(other != name and not tree.ways(name, other)[0] for other in paths)
    ]
    if not ends:
        return None
    down, waiting = mechanism.gravity or DOWN, [*mechanism.masses]
    branches = []
    for name in ends:
        chain, ahead = paths[name], 0
        if places_itself(mechanism):
            ahead = next(i for i, step in enumerate(chain) if step.joint)
        moves = {step.joint for step in chain}
        borne = tuple(load for load in waiting if load.joint in moves)
        waiting = [load for load in waiting if load.joint not in moves]
        several = name if len(ends) > 1 else ""
        target = _target(mechanism, several)
        branches.append(Branch(chain, ahead, target, down, borne, mechanism.payload, several))
    stands = {}
    for name, path in paths.items():
        apart = [tree.ways(name, end) for end in ends]
        common = [path[: len(path) - len(to)] for to, _ in apart]
        stands[name] = Stands(
            path,
            ends.index(name) if name in ends else None,
            tuple(len(Branch(steps, 0, (), down).joints) for steps in common),
            frozenset(i for i, (to, _) in enumerate(apart) if not to),
        )
    return Sag(tuple(branches), stands)


def _target(mechanism: Mechanism, body: str) -> tuple[str, ...]:
    """The coordinates of the first thing that is mounted on one of several bodies, or on any."""
    lengths = [p.name for p in mechanism.parameters if p.unit == "m" and p.role == "mounting"]
    if body:
        lengths = next((list(f.mounted) for f in mechanism.families if f.on == body), [])
        lengths = [n for n in lengths if mechanism.parameters[n].unit == "m"]
    return tuple(lengths[:3])


def _columns(
    mechanism: Mechanism, arm: Sag | None, wanted: bool | tuple[str, ...]
) -> tuple[Column, ...]:
    """The columns that are named, or all that do something.

    Raises InputError for a name that is none of the arm's.
    """
    if arm is None:
        if not isinstance(wanted, bool) and wanted:
            raise InputError(
                f"{mechanism.name!r} is no arm in space, so it cannot have the sag {wanted[0]!r}",
                code="unsupported",
                remedy="leave sag out; it is for serial arms in space",
            )
        return ()
    if isinstance(wanted, bool):
        return arm.columns(_turned(mechanism))
    candidates = {c.parameter: c for c in arm.candidates()}
    return tuple(candidates[n] for key in wanted for n in matching(key, candidates, "sag"))


def _smooth(mechanism: Mechanism, body: Body, wanted: bool | int) -> dict[str, Smooth]:
    """By body, features of the joints that move it and are read."""
    if not wanted:
        return {}
    count = FEATURES if wanted is True else wanted
    ranges = {name: limit.high - limit.low for name, limit in joint_limits(mechanism).items()}
    made = {}
    for name in body.displacements:
        driven = driven_joints(mechanism, name)
        joints = [(joint, mechanism.quantities[joint]) for joint in driven]
        if joints:
            several = name if len(body.displacements) > 1 else ""
            made[name] = replace(Smooth.of(joints, ranges, count), body=several)
    return made


def driven_joints(mechanism: Mechanism, body: str | None = None) -> list[str]:
    """The joints that are moved and read: those of an arm, or those that have a zero.

    body: one of several in a tree, which only the joints between it and the root move.
    """
    if mechanism.tree is not None:
        steps = mechanism.tree.steps if body is None else mechanism.tree.path(body)
        return list(dict.fromkeys(step.joint for step in steps if step.joint))
    read = [v.name for v in mechanism.variables if v.role == "reading" and v.first is None]
    if not mechanism.families:
        return [name for name in read if name not in mechanism.outputs]
    zeros = {p.owner for p in mechanism.parameters if p.role == "zero"}
    return [name for name in read if name in zeros]


def _displaced(
    mechanism: Mechanism, arm: Sag | None, columns: Sequence[Column], smooth: Mapping[str, Smooth]
) -> Mechanism:
    """The mechanism with its bodies displaced by sag and by a smooth discrepancy."""
    body = mechanism.body
    if body is None or (arm is None and not smooth):
        return mechanism
    added: list[Parameter] = []
    terms: list[Term] = []
    if arm is not None:
        added += [Parameter(c.parameter, 0.0, _UNITS.get(c.term, "rad/m")) for c in columns]
        added += [Parameter(n, 0.0, "rad", TILTED, meaning=GRAVITY_TILT) for n in arm.down.tilts]
        if any(c.term == "compliance" for c in columns):
            weighing = CARRIED * arm.weight
            added += [Parameter(n, 0.0, "kg", weighing, meaning=LOAD_MASS) for n in arm.carried]
        terms += [
            *_term(
                "sag",
                # Gears yield more than bearings and links: 0.5 and 0.2 mrad per metre of lever
                # (record 0046).
                [c.parameter for c in columns if c.term == "sag"],
                0.5e-3,
                "joints give way about their axes under gravity by {scale}",
            ),
            *_term(
                "sag_across",
                [c.parameter for c in columns if c.term == "sag_across"],
                0.2e-3,
                "links and bearings give way across the joints' axes under gravity by {scale}",
            ),
            *_term(
                "compliance",
                [c.parameter for c in columns if c.term == "compliance"],
                YIELD_SD["rad"][1],
                "joints yield about their axes to known weights by {scale}",
            ),
            *_term(
                COUPLINGS,
                [c.parameter for c in columns if c.term == COUPLINGS],
                0.2e-3,
                "joints that follow others are off by {scale}",
            ),
        ]
    coefficients = {
        name: {
            axis: one.coefficients(axis)
            for axis in body.axes
            if len(axis) == 1 or name in body.turning
        }
        for name, one in smooth.items()
    }
    shifts = [
        n for of in coefficients.values() for a, row in of.items() if len(a) == 1 for n in row
    ]
    turns = [n for of in coefficients.values() for a, row in of.items() if len(a) == 2 for n in row]
    added += [Parameter(n, 0.0, "m") for n in shifts]
    added += [Parameter(n, 0.0, "rad") for n in turns]
    terms += [
        *_term(
            DISCREPANCY,
            shifts,
            0.3e-3,
            "what remains shifts the body by {scale}, smoothly in the joints",
        ),
        *_term(
            "discrepancy_turns",
            turns,
            0.3e-3,
            "what remains turns the body by {scale}, smoothly in the joints",
        ),
    ]
    axes, first_body = body.axes, next(iter(body.displacements.values()))

    def meaning(
        x: Mapping[str, Any], p: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What stands in place of the displacements, for each pose of a row."""
        places: dict[str, Any] = {}
        for i, end in enumerate(ENDS[: len(first_body)]):
            row = {v.name: x[v.name + end] for v in mechanism.variables if v.name + end in x}
            moved = {} if arm is None else arm.displacements(columns, row, p)
            for name, ends in body.displacements.items():
                total = dict.fromkeys(axes, 0.0)
                if name in moved:
                    sagged = moved[name]
                    total |= dict(zip(axes, (*sagged[0], *sagged[1]), strict=True))
                if name in smooth:
                    features = smooth[name].features(row)
                    for axis, of_axis in coefficients[name].items():
                        for coefficient, feature in zip(of_axis, features, strict=True):
                            total[axis] = total[axis] + p[coefficient] * feature
                places |= dict(zip(ends[i], total.values(), strict=True))
        return {}, places

    displaced = tuple(n for ends in body.displacements.values() for names in ends for n in names)
    tape = substituted(body.tape, meaning, parameters=[p.name for p in added], without=displaced)
    made = replace(
        mechanism,
        tape=tape,
        parameters=Parameters((*mechanism.parameters, *added)),
        body=None,
    )
    return made.with_terms(*terms)


def _turned(mechanism: Mechanism) -> dict[str, float]:
    """The nominal values, but turned a little where they place an arm: it may stand anywhere."""
    return {
        p.name: p.nominal + (0.1 if p.unit == "rad" and p.role == "placement" else 0.0)
        for p in mechanism.parameters
    }


def _with_drives(mechanism: Mechanism) -> tuple[Mechanism, list[str]]:
    """The mechanism with harmonics of its turning joints, and scales of its slides; and which
    joints have harmonics now."""
    driven = driven_joints(mechanism)
    turning = [
        Harmonics((q,), ORDERS, f"{EFFECT} {q}") for q in driven if mechanism.quantities[q] == "rad"
    ]
    turning = _further(mechanism, turning)
    made = _with_drive(
        mechanism,
        turning,
        Term(DRIVES[0], ("",), 1e-4, words="gears and encoders are out of round by {scale}"),
    )
    made = _with_drive(
        made,
        _further(made, _scales_of_slides(made)),
        Term(DRIVES[1], ("",), 1e-4, words="scales of slides are wrong by {scale}"),
    )
    return made, [q for effect in turning for q in effect.joints]


def _scales_of_slides(mechanism: Mechanism) -> list[Scale]:
    slides = [q for q in driven_joints(mechanism) if mechanism.quantities[q] == "m"]
    return [Scale((q,), f"{EFFECT} {q}") for q in slides]


def _with_awaiting(mechanism: Mechanism) -> Mechanism:
    """The mechanism with the effects that awaited its model error: what they change in a term has a
    learnt sd as well."""
    made = with_effects(replace(mechanism, awaiting=()), mechanism.awaiting)
    new = [p for p in made.parameters if p.name not in mechanism.parameters.names]
    terms = [
        _term(
            f"{term.name}{CHANGED}",
            [p.name for p in new if p.changes in term.parameters],
            term.sd,
            f"as the load changed, {term.words} more",
        )
        for term in mechanism.terms
    ]
    return replace(made.with_terms(*itertools.chain.from_iterable(terms)), awaiting=())


def _further(mechanism: Mechanism, effects: Sequence[E]) -> list[E]:
    """Those effects that the mechanism has not already."""
    taken = set(mechanism.parameters.names)
    return [e for e in effects if taken.isdisjoint(e.parameters(mechanism))]


def _with_drive(mechanism: Mechanism, effects: Sequence[Effect], term: Term) -> Mechanism:
    """The mechanism with these effects under one term."""
    if not effects:
        return mechanism
    names = tuple(n for e in effects for n in e.parameters(mechanism))
    return with_effects(mechanism, effects).with_terms(replace(term, parameters=names))
