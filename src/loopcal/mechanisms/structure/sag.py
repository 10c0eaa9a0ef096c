"""Sag: how an arm may give way under its own weight, everywhere at once.

Weight acts at a few points m of the arm. At the base and at each joint j but the last a link may
give way about each of its axes e. It does so in proportion to the moment of gravity about the
joint's origin o_j, per weight. Each is one column of a linear model, with a compliance c [rad per
metre of lever]:

    w = c e (e . ((m - o_j) x g)),    d = w x (b - o_j),

g the unit vector of gravity; w turns the body and d shifts its origin b. The base may give way
about its own axes. The points: the elbow (origin of the middle joint), the wrist (of the last
joint but one) and the tool (the first point that is looked at). Each loads what stands before it.
All is computed from the geometry as it is without giving way.

Where masses m_k at points r_k are known, each turning joint also yields about its axis e to the
moment of all that stand behind it, with a compliance c [rad/(N m)]:

    w = c e (e . sum_k m_k g_0 (r_k - o_j) x g),    g_0 standard gravity.

A joint that follows another one's reading, by bars, belts or gears, is off. An eccentric wheel
turns it by a cos f + b sin f. A bar of another length between crank and horn turns a parallelogram
by (a + b sin f) / cos f, f the angle of arm and crank from square, nominally at readings of 0. Bars
hold a link against any link ahead, whatever turns between, so that f is any of the angles between
links that turn about one axis.

What the tool carries is estimated where the masses of the links are known, and may be known to
differ by pose.

A robot with several arms has one branch for each arm, with a set of points each. A joint that
carries several arms gives way under the weight of all of them, and moves them all. The base gives
way under each arm apart, so that the joints of the other arms need not be read.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, groupby, product
from typing import Any, cast

import numpy as np

from loopcal.arrays import Array
from loopcal.expressions.engine import engine_for
from loopcal.expressions.trace import trace
from loopcal.expressions.vectors import cross, dot, norm, rotate, vector
from loopcal.lazy import cached_property
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.chain import product as multiplied
from loopcal.mechanisms.effects.gravity import ACCELERATION, Load, end_of
from loopcal.mechanisms.frame import ChainFrame, Direction, Values, Vector
from loopcal.mechanisms.structure.smooth import Smooth

BASE = "base"
GRAVITY = "gravity"
TOOL = "tool"
"""Begins the names of the two parameters that tilt gravity against the base."""
LOAD = "load_mass"
"""The mass [kg] at the tool beyond those that are known: a gripper that a URDF leaves out."""
COUPLINGS = "couplings"
"""Stands for what turns a joint as another one's reading says, where others name the point of a
weight."""
MASSES = "masses"
"""Stands for all known masses behind a joint, where others name the point of a weight."""
# Random poses show which columns act; columns equal to nine digits in all of them are one.
_POSES, _ALIKE = 24, 1e-9
_SHAPES = ("cos", "sin", "sec", "tan")
"""What a coupling is off by: as an eccentric wheel, and as a bar (see the head)."""
# Chosen, not derived: bars that carry a load stay 30 degrees and more from flat, cos^2 > 0.25.
_FLAT = 0.05
"""Added to cos^2 where it divides, so that no reading of a belt or gear is infinitely off."""
_PARALLEL = 0.99
"""Cosine of two axes that are one in the drawing, up to its digits."""
_PAYLOADS = (1.0, 5.0)
"""Masses [kg] that a tool carries in these poses."""
_NEXT = {"x": ("y", "z"), "y": ("z", "x"), "z": ("x", "y")}


@dataclass(frozen=True)
class Column:
    """One way to give way: at `joint`, about `axis` of its link, under a weight at `load`.

    about_joint: whether the axis is that of a turning joint itself; off_by: of a coupling, the
    factors of readings in an angle, and by what function of it the joint is off.
    """

    parameter: str
    joint: str
    axis: str
    load: str
    about_joint: bool
    off_by: tuple[tuple[tuple[str, float], ...], str] = ((), "")

    @property
    def term(self) -> str:
        """Name of the term that it belongs to."""
        if self.load == MASSES:
            return "compliance"
        if self.load == COUPLINGS:
            return COUPLINGS
        return "sag" if self.about_joint else "sag_across"


@dataclass(frozen=True)
class _Link:
    """A frame of the arm, seen from its base: origin (3,), its axes as the columns x, y, z."""

    origin: Vector
    axes: Mapping[str, Vector]


@dataclass(frozen=True)
class Branch:
    """An arm, alone or one of several, that may give way under gravity.

    chain: its steps; ahead: how many of them only place it, in whose last frame gravity is stated;
    target: the coordinates of the tool in the body's frame; gravity: its nominal direction; masses:
    those that are known, each of one branch alone; payload: the known constant [kg] that the tool
    carries; name: begins the names of its weights, where there are several.
    """

    chain: tuple[Step, ...]
    ahead: int
    target: tuple[str, ...]
    gravity: tuple[float, float, float]
    masses: tuple[Load, ...] = ()
    payload: str | None = None
    name: str = ""

    def _named(self, weight: str) -> str:
        return f"{self.name}_{weight}" if self.name else weight

    @property
    def down(self) -> Direction:
        """The direction of gravity, and the two parameters that tilt it."""
        return Direction.near(self.gravity, name=GRAVITY, what="gravity")

    @property
    def carried(self) -> tuple[str, ...]:
        """The parameter of what the tool carries, where the masses of the links show it."""
        return (self._named(LOAD),) if self.masses else ()

    @cached_property
    def joints(self) -> dict[str, int]:
        """Positions of the steps that joints move; of a joint that moves several, NAME_2, ..."""
        positions: dict[str, int] = {}
        for i, step in enumerate(self.chain):
            if step.joint is not None:
                number = 1 + sum(self.chain[k].joint == step.joint for k in positions.values())
                positions[step.joint if number == 1 else f"{step.joint}_{number}"] = i
        return positions

    @property
    def loads(self) -> dict[str, int | None]:
        """By name, after how many joints each weight comes; None for the tool."""
        n = len(self.joints)
        inner = {"elbow": (n + 1) // 2, "wrist": n - 1}
        used = {at: name for name, at in inner.items() if at > 1}
        named = {self._named(name): at for at, name in used.items()}
        return {**named, self._named(TOOL): None}

    @property
    def names(self) -> list[str]:
        """Of the links: the base, and behind each joint."""
        return [BASE, *self.joints]

    def candidates(self) -> Iterator[Column]:
        """All columns, whether or not they are of any effect."""
        for number, joint in enumerate(self.names[: max(1, len(self.joints))]):
            loads = [load for load, at in self.loads.items() if at is None or at > number]
            motion = self.chain[self.joints[joint]].motion if number else ""
            for axis in "xyz":
                for load in loads:
                    about_joint = motion == f"r{axis}"
                    yield Column(f"{joint}_sag_{axis}_{load}", joint, axis, load, about_joint)
        for joint, i in self.joints.items() if self._weighed else ():
            if self.chain[i].motion[0] == "r":
                yield Column(f"{joint}_yield", joint, self.chain[i].motion[1], MASSES, True)
        yield from self._couplings()

    def _couplings(self) -> Iterator[Column]:
        """What turns a joint as the reading of another one says: by every angle that bars may hold
        it by (docs/decisions/0152)."""
        for name, i in self.joints.items():
            step = self.chain[i]
            if step.joint in (None, name) or step.motion[0] == "t":
                continue
            for (label, angle), shape in product(self._angles(name).items(), _SHAPES):
                parameter = f"{name}_coupling_{label}{shape}"
                off_by = tuple(angle.items()), shape
                yield Column(parameter, name, step.motion[1], COUPLINGS, True, off_by)

    def _angles(self, name: str) -> dict[str, dict[str, float]]:
        """The angles between the links that turn about the axis of a joint, ahead of it and behind:
        by the joints between two links, the factor of each reading. One of those in proportion."""
        axes = self._axes()
        side = {joint: _side(axis, axes[name]) for joint, axis in axes.items()}
        alike = [list(run) for _, run in groupby(side, lambda joint: side[joint] != 0)]
        run = next(run for run in alike if name in run)
        between = [run[i:j] for i, j in combinations(range(len(run) + 1), 2)]
        angles: dict[frozenset[tuple[str, float]], tuple[str, dict[str, float]]] = {}
        for joints in sorted(between, key=lambda joints: (joints[0] != name, len(joints))):
            total: dict[str, float] = defaultdict(float)
            for joint in joints:
                step = self.chain[self.joints[joint]]
                total[str(step.joint)] += step.direction * side[joint]
            angle = {joint: total[joint] for joint in sorted(total) if abs(total[joint]) > _ALIKE}
            size = next(iter(angle.values()), 1.0)
            way = frozenset((joint, round(factor / size, 6)) for joint, factor in angle.items())
            words = joints[1:] if joints[0] == name else ["of", *joints]
            if angle:
                angles.setdefault(way, ("".join(f"{word}_" for word in words), angle))
        return dict(angles.values())

    def _axes(self) -> dict[str, Array]:
        """By turning joint, its axis (3,) in the first frame, as drawn at readings of 0."""
        zero: dict[str, float] = defaultdict(float)
        return {
            joint: multiplied(self.chain[:i], zero, zero)[:3, "xyz".index(motion[1])]
            for joint, i in self.joints.items()
            if (motion := self.chain[i].motion)[0] == "r"
        }

    def turns(
        self, columns: Sequence[Column], x: Values, p: Values
    ) -> tuple[list[_Link], _Link, dict[int, Vector]]:
        """The frames of base and joints, that of the body, and by number of a frame the small turn
        (3,) by which it gives way; all in the first frame of the chain."""
        links, body, masses = self._links(x, p)
        acts = {*self.loads, COUPLINGS} | ({MASSES} if self._weighed else set())
        kept = [c for c in columns if c.load in acts]
        return links, body, self._link_turns(links, body, masses, kept, x, p)

    def next_axis(self, joint: str, x: Values, p: Values) -> tuple[str, Vector] | None:
        """The next joint behind the base or a joint, and its axis (3,) in the first frame; None
        where it does not turn."""
        at = self.names.index(joint) + 1
        behind = self.names[at] if at < len(self.names) else ""
        motion = self.chain[self.joints[behind]].motion if behind else "t"
        return (behind, self._links(x, p)[0][at].axes[motion[1]]) if motion[0] == "r" else None

    @property
    def _weighed(self) -> bool:
        return bool(self.masses or self.payload)

    def _link_turns(
        self,
        links: list[_Link],
        body: _Link,
        masses: list[Vector],
        columns: Sequence[Column],
        x: Values,
        p: Values,
    ) -> dict[int, Vector]:
        tool = body.origin
        for letter, name in zip("xyz", self.target, strict=False):
            tool = tool + body.axes[letter] * p[name]
        behind = [link.origin for link in links]
        points = {load: tool if at is None else behind[at] for load, at in self.loads.items()}
        g = self._pull(x, p)
        weighed = any(column.load == MASSES for column in columns)
        behind_each = self._weights(masses, tool, x, p) if weighed else []
        turns = {}
        for number, link in enumerate(links):
            on_link = [column for column in columns if column.joint == self.names[number]]
            if not on_link:
                continue
            moments = {
                load: cross(points[load] - link.origin, g)
                for load in dict.fromkeys(c.load for c in on_link)
                if load not in (MASSES, COUPLINGS)
            }
            if behind_each:
                weight, moment = behind_each[number]
                moments[MASSES] = cross(moment - link.origin * weight, g)
            turn = vector(0.0, 0.0, 0.0)
            for axis in "xyz":
                e = link.axes[axis]
                angle: Any = 0.0
                for column in on_link:
                    if column.axis == axis:
                        one = column.load
                        does = _off(column, x) if one == COUPLINGS else dot(e, moments[one])
                        angle = angle + p[column.parameter] * does
                turn = turn + e * angle
            turns[number] = turn
        return turns

    def _weights(
        self, masses: Sequence[Vector], tool: Vector, x: Values, p: Values
    ) -> list[tuple[Any, Vector]]:
        """Of the known masses behind base and each joint, sum m g_0 [N] and sum m g_0 r (3,)."""
        carried: Any = p[self.carried[0]] if self.masses else 0.0
        weight = (carried if self.payload is None else carried + x[self.payload]) * ACCELERATION
        moment = tool * weight
        sums: list[tuple[Any, Vector]] = []
        for joint in reversed(range(1 + len(self.joints))):
            for mass, point in zip(self.masses, masses, strict=True):
                if joint and end_of(self.chain, mass) - 1 == [*self.joints.values()][joint - 1]:
                    weight = weight + mass.weight
                    moment = moment + point * mass.weight
            sums.append((weight, moment))
        return sums[::-1]

    def _pull(self, x: Values, p: Values) -> Vector:
        """Gravity in the first frame of the chain."""
        pull = self.down.vector(p)
        for step in reversed(self.chain[: self.ahead]):
            if step.motion[0] == "r":
                pull = rotate(step.motion[1], step.amount(x, p), pull)
        return pull

    def _links(self, x: Values, p: Values) -> tuple[list[_Link], _Link, list[Vector]]:
        """The frames of base and joints, behind each joint's motion, that of the body, and where
        the known masses are."""
        origin = vector(0.0, 0.0, 0.0)
        axes = dict(zip("xyz", np.eye(3), strict=True))
        moved = set(self.joints.values())
        links: list[_Link] = []
        masses: list[Vector] = [origin] * len(self.masses)
        for i, step in enumerate(self.chain):
            if i == self.ahead:
                links.append(_Link(origin, axes))
            amount, letter = step.amount(x, p), step.motion[1]
            if step.motion[0] == "t":
                origin = origin + axes[letter] * amount
            else:
                # R_letter(amount) post-multiplied: the two other axes turn within their plane.
                a, b = _NEXT[letter]
                c, s = np.cos(amount), np.sin(amount)
                axes = axes | {a: axes[a] * c + axes[b] * s, b: axes[b] * c - axes[a] * s}
            if i in moved:
                links.append(_Link(origin, axes))
            for k, mass in enumerate(self.masses):
                if end_of(self.chain, mass) == i + 1:
                    shift = zip("xyz", mass.point, strict=True)
                    masses[k] = sum((axes[a] * v for a, v in shift if v), origin)
        return self._standing(links), _Link(origin, axes), masses

    def _standing(self, links: list[_Link]) -> list[_Link]:
        """The links, where the arm's own steps place it: there is no base in such a chain.

        Its first axis begins somewhere in the instrument's frame. The first joint is taken where
        that axis passes the second joint, the base as far below as the second link is long.
        """
        if not self.ahead or len(links) < 3:
            return links
        base, first, second = links[:3]
        motion = self.chain[self.ahead].motion
        e = first.axes[motion[1]]
        foot = first.origin + e * dot(e, second.origin - first.origin)
        # The true base is not in such a model; with base and first joint at one height sag explains
        # less of the MA1400's workspace set: 0.36 instead of 0.30 mm in-sample.
        below = foot - e * norm(links[3].origin - second.origin) if len(links) > 3 else foot
        return [_Link(below, base.axes), _Link(foot, first.axes), *links[2:]]


@dataclass(frozen=True)
class Stands:
    """A body: path to it; end: the branch that ends there, None where none does; shared: of each
    branch, how many joints the two have in common; on: the branches that it is part of."""

    path: tuple[Step, ...]
    end: int | None
    shared: tuple[int, ...]
    on: frozenset[int]


@dataclass(frozen=True)
class Sag:
    """The branches of a robot, one of a serial arm; bodies: those that instruments look at."""

    branches: tuple[Branch, ...]
    bodies: Mapping[str, Stands]

    @property
    def down(self) -> Direction:
        """The direction of gravity, and the two parameters that tilt it."""
        return self.branches[0].down

    @property
    def carried(self) -> tuple[str, ...]:
        """The parameters of what the tools carry."""
        return tuple(name for branch in self.branches for name in branch.carried)

    @property
    def weight(self) -> float:
        """Sum [kg] of the known masses."""
        return sum(load.mass or 0.0 for branch in self.branches for load in branch.masses)

    @property
    def names(self) -> list[str]:
        """Of the links: the base, and behind each joint."""
        return list(dict.fromkeys(name for branch in self.branches for name in branch.names))

    @property
    def shared(self) -> tuple[str, ...]:
        """The joints that carry several branches."""
        every = [joint for branch in self.branches for joint in branch.joints]
        return tuple(name for name in dict.fromkeys(every) if every.count(name) > 1)

    @property
    def units(self) -> dict[str, str]:
        """The SI units of the joints' readings."""
        steps = (step for branch in self.branches for step in branch.chain)
        return {step.joint: step.unit for step in steps if step.joint}

    @property
    def payload(self) -> str | None:
        """The known constant [kg] that the tool of a serial arm carries."""
        return self.branches[0].payload

    def candidates(self) -> list[Column]:
        """All columns, whether or not they are of any effect; those of known masses once."""
        every = [column for branch in self.branches for column in branch.candidates()]
        return list({column.parameter: column for column in every}.values())

    def columns(self, nominal: Mapping[str, float]) -> tuple[Column, ...]:
        """The columns that do something, each once.

        At random poses of the nominal arm, with gravity tilted a little: what turns about it does
        nothing otherwise. Two that displace the body alike would count twice.
        """
        candidates, units = self.candidates(), self.units
        names = [column.parameter for column in candidates]
        payload = () if self.payload is None else (self.payload,)
        p = {**nominal, **dict.fromkeys(names, 0.0), **dict.fromkeys(self.down.tilts, 0.1)}
        p |= dict.fromkeys(self.carried, 0.0)
        tape = trace(
            lambda x, p: [
                component
                for moved in self.displacements(candidates, cast("Any", x), cast("Any", p)).values()
                for component in np.concatenate(moved)
            ],
            quantities=tuple(units),
            pose_constants=payload,
            parameters=tuple(p),
        )
        engine = engine_for(tape, tuple(names), _POSES, ())
        rng = np.random.default_rng(0)
        carried = rng.uniform(*_PAYLOADS, (len(payload), _POSES))
        # Within most joints' limits: readings outside would show columns that no pose can.
        spans = [(-2.5, 2.5) if unit == "rad" else (0.0, 0.7) for unit in units.values()]
        x = np.array([rng.uniform(*span, _POSES) for span in spans])
        each = engine.evaluate(np.array(list(p.values())), x, carried).by_parameter
        kept: list[int] = []
        for i, change in enumerate(each):
            size = float(np.linalg.norm(change))
            if size > _ALIKE and not any(_alike(change, each[k], size) for k in kept):
                kept.append(i)
        return tuple(candidates[i] for i in kept)

    def displacements(
        self, columns: Sequence[Column], x: Values, p: Values
    ) -> dict[str, tuple[Vector, Vector]]:
        """By body, its shift d and turn w (3,) each, in the first frame of the chain."""
        turned = [branch.turns(columns, x, p) for branch in self.branches]
        moved = {}
        for name, stands in self.bodies.items():
            if stands.end is None:
                origin = ChainFrame(stands.path, x, p).point(vector(0.0, 0.0, 0.0))
            else:
                origin = turned[stands.end][1].origin
            shift, turn = vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)
            for i, (links, _, turns) in enumerate(turned):
                for number, bend in turns.items():
                    if number <= stands.shared[i] and (number or i in stands.on):
                        turn = turn + bend
                        shift = shift + cross(bend, origin - links[number].origin)
            moved[name] = shift, turn
        return moved

    def link_turns(self, columns: Sequence[Column], x: Values, p: Values) -> dict[str, Vector]:
        """By base and joint, the small turn (3,) by which it gives way, in the first frame of the
        chain."""
        turned: dict[str, Vector] = {}
        for branch in self.branches:
            for number, turn in branch.turns(columns, x, p)[2].items():
                name = branch.names[number]
                turned[name] = turned[name] + turn if name in turned else turn
        return turned

    def next_axis(self, joint: str, x: Values, p: Values) -> tuple[str, Vector] | None:
        """As of the first branch that has the joint."""
        branch = next(one for one in self.branches if joint in one.names)
        return branch.next_axis(joint, x, p)


def _side(axis: Array, other: Array) -> int:
    """1 where two axes are parallel, -1 where they are opposite, else 0."""
    cosine = float(axis @ other)
    return round(cosine) if abs(cosine) > _PARALLEL else 0


def _off(column: Column, x: Values) -> Any:
    factors, shape = column.off_by
    angle: Any = sum(factor * x[joint] for joint, factor in factors)
    c, s = np.cos(angle), np.sin(angle)
    secant = c / (c * c + _FLAT)
    return {"cos": c, "sin": s, "sec": secant, "tan": s * secant}[shape]


def _alike(one: Array, other: Array, size: float) -> bool:
    apart = min(np.linalg.norm(one - other), np.linalg.norm(one + other))
    return bool(apart <= _ALIKE * size)


# What the structured model error of a mechanism consists of.


@dataclass(frozen=True)
class Structure:
    """sag: the arm that gives way, by these columns, None where it does not; smooth: by body, what
    its discrepancy is made of; joints: those with harmonics; plain: the `Mechanism` without it.
    """

    sag: Sag | None = None
    columns: tuple[Column, ...] = ()
    smooth: Mapping[str, Smooth] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    plain: Any = field(default=None, repr=False, compare=False)

    @property
    def loaded(self) -> tuple[str, ...]:
        """What another load on the tool changes: its mass, or all that gives way under it."""
        weighed = self.sag is not None and any(c.term == "compliance" for c in self.columns)
        if self.sag is not None and weighed and LOAD in self.sag.carried:
            return (LOAD,)
        return tuple(c.parameter for c in self.columns if c.load == TOOL)
