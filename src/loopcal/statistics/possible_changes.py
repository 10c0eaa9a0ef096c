"""What may change on a machine: a row for each cause that is tried.

A row names the parameters, or the zeros of readings, that change together. `ALONG_A_RUN` are the
causes of a change between two poses of one run, `ALONG_A_DAY` of a run after the calibration,
`BETWEEN_DAYS` those of a change since it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.problem.problem import Problem
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.mechanisms.parameters import GEOMETRY, OF_CAMERAS
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.station import BASE, Station
from loopcal.mechanisms.structure.structured import driven_joints
from loopcal.statistics.changed import PRINCIPAL_POINT
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.replacing import CAMERAS, IN_PROPORTION
from loopcal.statistics.run_order import WAYS, like_a_delay

# What machines can have; chosen, not derived, a few times what their makers and users report: a
# joint that is mastered anew, a link that a crash bends, a tool that is exchanged, a print that was
# fitted to another page, 50 K of warming at 24e-6 per kelvin, half of the way to the next pose. A
# load may do anything.
_MOST = {
    "zero": 0.5,
    "angle": 0.05,
    "length": 0.03,
    "mounting": 1.0,
    "camera": 1.0,
    "scale": 0.1,
    "print": 0.1,
    "expansion": 1.2e-3,
    "delay": 0.5,
}
"""The largest change of a kind [SI]."""
# Chosen, not derived: as between two days; a load bends a joint by 0.05 rad at a lever of a metre.
_MOST_AT_ONCE = {
    ("target", "m"): _MOST["mounting"],
    ("joint", "rad"): _MOST["zero"],
    ("link", "rad"): _MOST["angle"],
    ("link", "m"): _MOST["length"],
    ("load", "rad/m"): 0.05,
    ("expansion", "1"): _MOST["expansion"],
}
"""The largest change during a run of a kind, by the unit of its part [SI]; else any."""
# What they usually have between two days; chosen, not derived: a joint that creeps or is mastered
# anew by a tenth of a degree, a tool that is exchanged by some millimetres, a link that gives way
# by some tenths, 10 K of warming. `analyses.gauntlet` counts what is named.
_USUAL = {
    ("zero", "rad"): 2e-3,
    ("zero", "m"): 3e-4,
    ("mounting", "m"): 5e-3,
    ("mounting", "rad"): 2e-2,
    ("camera", "m"): 5e-3,
    ("camera", "rad"): 2e-2,
    ("angle", "rad"): 5e-4,
    ("length", "m"): 3e-4,
    ("expansion", "1"): 2e-4,
    ("slide", "1"): 2e-4,
    ("load", "kg"): 5.0,
}
"""The usual size of a change of a kind, by the unit of its part [SI]; any, where none is stated."""
EXPANSION = "the scale of the machine"
"""The name of its growth in all directions, as it warms up."""
# Where each mass of a simulated arm was stated with an sd of 20 %, loads were off by 13 %.
_MASSES = 0.15
"""Relative sd of a load, which is weighed against the masses that are stated."""
# Chosen, not derived: as of what a fit takes up (`ordered_system`).
_CANCELLED = 1e-4
"""Share of the squares of its names that a part must leave. Where angles alone are read, f(s l) =
s f(l) of all lengths l: the column of their scale is the misclosure itself, and explains it all."""
# Chosen, not derived: arms carry a few times what they were calibrated with.
HEAVY = 3.0
"""Another load, in units of the learnt sag."""
_PLACE = ("x", "y", "z", "rz", "ry", "rx")
"""Ends of the names of where a camera sits."""
# As in `change_points`: joints are mastered, tools exchanged, other loads carried and machines warm
# more often than links bend.
_OFTEN, _RARE = ("zero", "mounting", "camera", "load", "expansion", "slide"), 10.0
"""Kinds of changes that happen, and by how much others are less likely [log]."""


@dataclass(frozen=True)
class Possible:
    """A change of parameters, or of zeros of readings, by name.

    steps, ramps: whether it may happen at once, and all along a run; parts: its independent parts,
    by name [SI], where they are not the names one by one, and units, theirs; label: what it is
    called where that is not its only name; sized: the kind whose largest size it has, where not its
    own; described: its only name, and what that is.
    """

    kind: str
    names: tuple[str, ...]
    steps: bool = True
    ramps: bool = True
    parts: tuple[tuple[tuple[str, float], ...], ...] = ()
    units: tuple[str, ...] = ()
    label: str = ""
    sized: str = ""
    described: str = ""

    @property
    def name(self) -> str:
        """What changes."""
        return self.label or self.names[0]

    @property
    def directions(self) -> tuple[Mapping[str, float], ...]:
        """Its independent parts, by name [SI]."""
        if self.parts:
            return tuple(dict(part) for part in self.parts)
        return tuple({name: 1.0} for name in self.names)

    @property
    def titles(self) -> tuple[str, ...]:
        """What each of its parts is called."""
        return (self.label,) if len(self.parts) == 1 else self.names

    def columns(self, of: Callable[[Sequence[str]], Array]) -> Array:
        """(..., d) of its parts, by those of its names."""
        each = of(self.names)
        if not self.parts:
            return each
        shares = np.array([[d.get(n, 0.0) for d in self.directions] for n in self.names])
        rows = tuple(range(each.ndim - 1))
        whole, all_parts = each @ shares, np.square(each).sum(axis=rows) @ np.square(shares)
        seen = np.square(whole).sum(axis=rows) > _CANCELLED * all_parts
        return np.asarray(np.where(seen, whole, 0.0))

    @property
    def loaded(self) -> tuple[str, ...]:
        """All that gives way, of another load: what one weight leaves of it is there all day, and
        no step along the run."""
        return self.names if self.kind == "load" else ()

    @property
    def most(self) -> float:
        """The largest that a machine can have [SI]."""
        return _MOST.get(self.sized or self.kind, math.inf)

    def usual(self, unit: str) -> float:
        """The usual size of a part in this SI unit; infinite where none is stated."""
        return _USUAL.get((self.kind, unit), math.inf)

    def part_units(self, problem: Problem) -> tuple[str, ...]:
        """SI unit of each of its parts."""
        return self.units or tuple(unit_of(problem, name) for name in self.names)

    @property
    def of_few(self) -> bool:
        """Whether it counts with all others together: a load without mass has so many parts that
        too little is then left to show by how much readings scatter."""
        return self.kind != "load" or len(self.names) < 2

    @property
    def called(self) -> tuple[str, str]:
        """What it is: a load in one part is the same change as in several."""
        return self.name, self.kind

    def within(self, whole: Possible) -> bool:
        """Whether it is a part of another one, as a focal length is of all, or the same."""
        part = not whole.parts and {*self.names} < {*whole.names}
        return part or self.called == whole.called

    @property
    def often(self) -> bool:
        """Whether it is of a kind that happens often."""
        return self.kind in _OFTEN

    def unlikely(self, sizes: Array, covariance: Array, units: Sequence[str]) -> float:
        """By how much it is less likely than a usual change of a kind that happens often [log].

        sizes (d,), covariance (d, d), units: of the parts that are seen [SI]. Sizes of a kind are
        spread about the usual one as a Cauchy distribution, whose tails are heavy.
        """
        usual = np.array([self.usual(unit) for unit in units])
        stated = np.flatnonzero(np.isfinite(usual))
        x = sizes[stated] / usual[stated]
        # What is hardly seen is as large as its sd, which is no size.
        noise = covariance[np.ix_(stated, stated)] / np.outer(usual[stated], usual[stated])
        square = float(x @ np.linalg.solve(np.eye(len(x)) + noise, x))
        return math.log1p(square) + (0.0 if self.often else _RARE)


def impossible(kind: str, size: float, sd: float, unit: str) -> bool:
    """Whether no machine can have a change of this size and sd [SI] during a run."""
    return abs(size) - 2.0 * sd > _MOST_AT_ONCE.get((kind, unit), math.inf)


Cause = Callable[[Problem], Iterable[Possible]]
"""The changes of one kind that a machine can have."""


def possible(problem: Problem, causes: Iterable[Cause]) -> list[Possible]:
    """All changes by these causes."""
    return list(dict.fromkeys(one for cause in causes for one in cause(problem)))


def changed_share(number: Array, at: int, until: int | None) -> Array:
    """The share of a change that has happened at poses of these numbers: all of it from `at` on, or
    in proportion to the number up to `until`."""
    if until is None:
        return np.asarray(1.0 * (number >= at))
    return np.clip((number - at) / max(until - at, 1), 0.0, 1.0)


def unit_of(problem: Problem, name: str) -> str:
    """SI unit of a reading, or of a parameter, those of `held_station` too."""
    mechanism = problem.mechanism
    if name in mechanism.quantities:
        return mechanism.quantities[name]
    declared = mechanism.parameters if name in mechanism.parameters.names else _BASE.declared
    return declared[name].unit


_BASE = Station(BASE)


def held_station(problem: Problem) -> tuple[str, ...]:
    """The parameters of the station that an arm of transitions has or would get; none where these
    are estimated.

    The transitions alone would move the geometry without what is stated in their frames (see
    `mechanisms.station`).
    """
    chain = isinstance(problem.mechanism.placement, ChainPlacement)
    return _BASE.parameters if chain and not {*_BASE.parameters} & {*problem.names} else ()


def _mounted(problem: Problem) -> Iterator[tuple[str, ...]]:
    """The estimated parameters of each thing on the body; by instrument where the body gives way
    already."""
    mechanism = problem.mechanism
    groups = () if mechanism.body is None else mechanism.body.mounted
    if mechanism.body is None:
        mounted = mechanism.parameters.of_role("mounting")
        seen = [tuple(n for n in f.mounted if n in mounted) for f in mechanism.families]
        groups = (*seen, tuple(n for n in mounted if not any(n in names for names in seen)))
    for names in dict.fromkeys(groups):  # two stations see one target
        if estimated := tuple(n for n in names if n in problem.names):
            yield estimated


def _targets(problem: Problem) -> Iterator[Possible]:
    """Each thing on the body."""
    for names in _mounted(problem):
        yield Possible("target", names, label=_seen_by_images(problem, names))


def _stations(problem: Problem) -> Iterator[Possible]:
    if held := held_station(problem):
        yield Possible("station", held)
        return
    mechanism = problem.mechanism
    for place in (mechanism.placement, *(f.placement for f in mechanism.families)):
        parameters = () if place is None else place.parameters
        if estimated := tuple(n for n in parameters if n in problem.names):
            label = _seen_by_images(problem, estimated)
            yield Possible("station", estimated, label=label)


def _seen_by_images(problem: Problem, names: Sequence[str]) -> str:
    """The camera or the board whose place these parameters are; empty for that of another thing."""
    owners = {problem.mechanism.parameters[n].owner for n in names}
    for f in problem.mechanism.families if len(owners) == 1 else ():
        if f.form == PIXELS:
            for what, name in zip(("camera", "board"), f.readings[0].split(":"), strict=False):
                if owners == {name}:
                    return f"the {what}" if name == what else f"the {what} {name!r}"
    return ""


def _joints(problem: Problem) -> Iterator[Possible]:
    """The zero of each quantity that is read, but for what instruments read."""
    mechanism = problem.mechanism
    aside = {q for f in mechanism.families for q in f.readings} | {*mechanism.outputs}
    aside |= {*mechanism.disturbances, *mechanism.turns}
    unread = problem.uncertainty.sd.max(axis=1) == float("inf")
    for q, missing in zip(mechanism.tape.quantities, unread.tolist(), strict=True):
        if q not in aside and not missing:
            yield Possible("joint", (q,), ramps=False)


def _readings(problem: Problem) -> Iterator[Possible]:
    """The zeros of all that an instrument reads in one unit at once, and of each along the run."""
    mechanism = problem.mechanism
    aside = {*mechanism.disturbances, *mechanism.turns}
    # Of an image nothing has a zero: what moves is the camera, or what it sees.
    read = [f.readings for f in mechanism.families if f.form not in ("closure", PIXELS)]
    if not mechanism.families:
        read = [mechanism.outputs]
    by_instrument = [[q for q in group if q not in aside] for group in read]
    for group in by_instrument:
        units = [mechanism.quantities[q] for q in group]
        for unit in dict.fromkeys(units):
            alike = tuple(q for q, other in zip(group, units, strict=True) if other == unit)
            yield Possible("reading", alike)
            for q in alike if len(alike) > 1 else ():
                yield Possible("reading", (q,), steps=False)


def _zeros(problem: Problem) -> Iterator[Possible]:
    for q in driven_joints(problem.mechanism):
        slides = problem.mechanism.quantities[q] == "m"
        yield Possible("zero", (q,), sized="length" if slides else "")


def _mountings(problem: Problem) -> Iterator[Possible]:
    """Each thing on the body, its place and its turn together, and the tool that carries several
    targets: each is exchanged as a whole."""
    parameters, mounted = problem.mechanism.parameters, list(_mounted(problem))
    if tool := _tool(problem, mounted):
        yield tool
    on_body = {n for names in mounted for n in names}
    # Beside what is on the body, such as the zero of a wire.
    rest = [tuple(n for n in f.mounted if n not in on_body) for f in problem.mechanism.families]
    # Lenses and prints are changes of `_cameras`.
    others = {n for n in problem.names if parameters[n].role not in OF_CAMERAS}
    aside = [tuple(n for n in names if n in others) for names in dict.fromkeys(rest)]
    for names in [*mounted, *filter(None, aside)]:
        owners = {parameters[n].owner for n in names} if len(names) > 1 else set()
        label = next(iter(owners)) if len(owners) == 1 else ""
        yield Possible("mounting", names, label=label)


def _tool(problem: Problem, mounted: Sequence[tuple[str, ...]]) -> Possible | None:
    """A rigid motion of all targets, of which there are several in space, about their middle: near
    one point no reading shows a turn, which would hide the way about any other."""
    parameters = problem.mechanism.parameters
    points = [names for names in mounted if len(names) == len("xyz")]
    if len(points) < 2 or len(points) < len(mounted):
        return None
    places = np.array([[parameters[n].nominal for n in names] for names in points])
    places = places - places.mean(axis=0)
    parts: list[tuple[tuple[str, float], ...]] = []
    for i in range(3):
        parts.append(tuple((names[i], 1.0) for names in points))
    for i, j in ((1, 2), (2, 0), (0, 1)):
        # A small turn about the third axis moves (x_i, x_j) by (-x_j, x_i).
        parts.append(
            tuple(
                pair
                for names, at in zip(points, places.tolist(), strict=True)
                for pair in ((names[i], -at[j]), (names[j], at[i]))
            )
        )
    names = tuple(n for target in points for n in target)
    units = ("m",) * 3 + ("rad",) * 3
    return Possible("mounting", names, parts=tuple(parts), units=units, label="the tool")


def _cameras(problem: Problem) -> Iterator[Possible]:
    """The place of each camera beside the machine, its lens, and the size of each print."""
    parameters = [p for p in problem.mechanism.parameters if p.name in problem.names]
    whole = _sitting(problem, "placement")
    for eye in dict.fromkeys(p.owner for p in parameters if p.role == "lens"):
        lens_names = {p.name.removeprefix(f"{eye}_"): p.name for p in parameters if p.owner == eye}
        if place := tuple(p.name for p in parameters if p.owner == eye and p.role == "placement"):
            # By the way of its centre: where the base stands in the camera also moves by its turn.
            alone = Possible("camera", place, label=eye)
            yield _bracket(problem, [eye], "camera", eye) if eye in whole else alone
        if centre := tuple(lens_names[key] for key in ("cx", "cy") if key in lens_names):
            yield Possible("lens", centre, label=f"{PRINCIPAL_POINT}{eye}")
    yield from (focus := [*_focus(problem)])
    if len(focus) > 1:  # alike in all, which with the distance of the boards hides each of them
        names = tuple(name for one in focus for name in one.names)
        yield Possible("lens", names, label="the focal lengths")
    for role, kind in (("placement", "camera"), ("mounting", "mounting")):
        if len(eyes := _sitting(problem, role)) > 1:
            yield _bracket(problem, eyes, kind)
    for p in parameters:
        if p.role == "print" and p.name == f"{p.owner}_scale":
            yield Possible("print", (p.name,))


def _focus(problem: Problem) -> Iterator[Possible]:
    """The focal length of each lens, which autofocus and a zoom change at once."""
    for p in problem.mechanism.parameters:
        if p.role == "lens" and p.name == f"{p.owner}_f" and p.name in problem.names:
            yield Possible("lens", (p.name,), ramps=False)


def _sitting(problem: Problem, role: str) -> list[str]:
    """The cameras whose whole place is estimated: beside the machine, or mounted on it."""
    parameters = [p for p in problem.mechanism.parameters if p.name in problem.names]
    eyes = dict.fromkeys(p.owner for p in parameters if p.role == "lens")
    placed = {p.name for p in parameters if p.role == role}
    return [eye for eye in eyes if placed.issuperset(f"{eye}_{end}" for end in _PLACE)]


def _bracket(problem: Problem, eyes: Sequence[str], kind: str, label: str = CAMERAS) -> Possible:
    """A rigid motion of these cameras, which one bracket carries, about the middle of them.

    A camera beside the machine has T_camera_base = T(t) R, which becomes T_camera_base M^-1 where
    it is moved by M; one that is mounted has T_body_camera, which becomes M T_body_camera. With M
    of a small shift v and turn w about the middle c of all cameras,

        dt = -R (v - w x c),   dR = [-R w] R,   and   dt = v + w x (t - c),   dR = [w] R.
    """
    values = {p.name: p.nominal for p in problem.mechanism.parameters}
    beside, poses = kind == "camera", []
    for eye in eyes:
        x, y, z, rz, ry, rx = (values[f"{eye}_{end}"] for end in _PLACE)
        by_z, by_y, by_x = (_turn(i, angle) for i, angle in ((2, rz), (1, ry), (0, rx)))
        # Columns: the turns by rz, ry and rx as vectors.
        rates = np.column_stack([np.eye(3)[2], by_z[:, 1], (by_z @ by_y)[:, 0]])
        poses.append((np.array([x, y, z]), by_z @ by_y @ by_x, rates))
    middle = np.mean([-R.T @ t if beside else t for t, R, _ in poses], axis=0)
    parts = []
    for v, w in [*((e, 0.0 * e) for e in np.eye(3)), *((0.0 * e, e) for e in np.eye(3))]:
        part: list[tuple[str, float]] = []
        for eye, (t, R, rates) in zip(eyes, poses, strict=True):
            shift = -R @ (v - np.cross(w, middle)) if beside else v + np.cross(w, t - middle)
            # Where two of the three axes are one, the shortest of all that do.
            angles = np.linalg.lstsq(rates, -R @ w if beside else w, rcond=1e-9)[0]
            moved = np.concatenate([shift, angles]).tolist()
            part += [(f"{eye}_{end}", by) for end, by in zip(_PLACE, moved, strict=True)]
        parts.append(tuple(part))
    names = tuple(f"{eye}_{end}" for eye in eyes for end in _PLACE)
    return Possible(kind, names, parts=tuple(parts), units=("m",) * 3 + ("rad",) * 3, label=label)


def _turn(axis: int, angle: float) -> Array:
    """Rotation about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[[i, j], [i, j]] = math.cos(angle)
    R[j, i], R[i, j] = math.sin(angle), -math.sin(angle)
    return R


def _dimensions(problem: Problem) -> Iterator[Possible]:
    """What is added to the reading of a joint is the zero of this joint, and no other cause."""
    joints = {*driven_joints(problem.mechanism)}
    for p in problem.mechanism.parameters:
        if p.role in GEOMETRY and not p.same and not (p.role == "zero" and p.owner in joints):
            yield Possible(p.dimension or p.role, (p.name,), described=p.label)


def sd_of(size: float, sd: float, unit: str) -> float:
    """The sd of the size of a change, by how well what it is measured by is known as well."""
    return math.hypot(sd, _MASSES * size) if unit == "kg" else sd


def _loads(problem: Problem) -> Iterator[Possible]:
    """What the arm carries: its mass, or all that gives way under it."""
    structure = problem.mechanism.structure
    if structure is not None and structure.loaded:
        yield Possible("load", structure.loaded, ramps=False, label="the load")


def as_learnt(
    one: Possible, prior_sd: Array, covariance: Array, linear: Linearised
) -> tuple[Possible, ...]:
    """A load without mass in one part, and in the directions that these poses show; any other cause
    as it is.

    prior_sd (n_all,), covariance (n_all, n_all): of the parameters. One weight at the tool bends
    each joint in proportion to what was learnt of it: the root mean square of each column. Where
    nothing was, by its usual sd. In several parts each column of the sag has changed by about its
    own prior sd. Of these independent changes the parts are the principal ones that a heavy load
    lifts out of the noise: as single columns, of which most do next to nothing, it costs so much
    that a scale is named in its place.
    """
    placement, names = linear.placement, linear.placement.problem.mechanism.parameters.names
    if one.kind != "load" or len(one.names) == 1:
        return (one,)
    rows = [names.index(n) for n in one.names]
    learnt = prior_sd[rows]
    if not np.isfinite(learnt).all():
        return (one,)
    sds = np.sqrt(np.diag(covariance)[rows])
    size = np.where(sds > 0.0, np.hypot(placement.parameters[rows], sds), learnt)
    U = placement.columns(one.names) * learnt / np.sqrt(linear.factor)
    U = U - linear.F @ (linear.solve @ U)
    information, V = np.linalg.eigh(linear.weighed(U, U))
    seen = information > min(1.0 / HEAVY**2, 0.5 * information[-1])
    ways = (size[None], learnt * V[:, seen].T)
    return tuple(
        replace(
            one,
            parts=tuple(tuple(zip(one.names, part.tolist(), strict=True)) for part in way),
            units=("1",) * len(way),
        )
        for way in ways
    )


def _expansion(problem: Problem) -> Iterator[Possible]:
    """All dimensions of the machine in proportion, those that its slides read too, as it warms up,
    or another scale of what measures it."""
    units = problem.mechanism.quantities
    slides = [f"{q}{IN_PROPORTION}" for q in driven_joints(problem.mechanism) if units[q] == "m"]
    yield from _growing({**_lengths(problem), **dict.fromkeys(slides, 1.0)})


def scale_of(slide: str) -> str:
    """The name of the change of what this slide reads in proportion."""
    return f"the scale of {slide}"


def _slides(problem: Problem) -> Iterator[Possible]:
    """What one slide reads in proportion: its spindle or glass scale grows, or its pitch is entered
    anew."""
    units = problem.mechanism.quantities
    for q in driven_joints(problem.mechanism):
        if units[q] == "m":
            part = ((f"{q}{IN_PROPORTION}", 1.0),)
            names, label = (part[0][0],), scale_of(q)
            yield Possible("slide", names, parts=(part,), units=("1",), label=label, sized="scale")


def _lengths(problem: Problem) -> dict[str, float]:
    """The nominal dimensions, by name; what is held has no column."""
    parameters = [p for p in problem.mechanism.parameters if p.name in problem.names]
    return {p.name: p.nominal for p in parameters if p.dimension == "length" and p.nominal}


def _growing(by: Mapping[str, float]) -> Iterator[Possible]:
    if by:
        parts = (tuple(by.items()),)
        yield Possible("expansion", tuple(by), parts=parts, units=("1",), label=EXPANSION)


def _warming(problem: Problem) -> Iterator[Possible]:
    """The machine grows all along a run; at once it does not."""
    for one in _growing(_lengths(problem)):
        yield replace(one, steps=False)


def _warming_slides(problem: Problem) -> Iterator[Possible]:
    """The same where the calibration is held, with what slides read: the way of an axis grows."""
    for one in _expansion(problem):
        yield replace(one, steps=False)


def _delays(problem: Problem) -> Iterator[Possible]:
    """Poses that are read, or measured, on the way to the next one or from the last one."""
    if joint_rows(problem) and not like_a_delay(problem):
        for name in WAYS:
            yield Possible("delay", (name,), units=("1",))


def _links(problem: Problem) -> Iterator[Possible]:
    """What a crash bends: all dimensions of a link at once, which it never does all along a run."""
    by_link: dict[str, list[str]] = {}
    for p in problem.mechanism.parameters:
        if p.role in GEOMETRY - {"zero"} and p.name in problem.names:
            by_link.setdefault(p.owner or p.name, []).append(p.name)
    for names in by_link.values():
        yield Possible("link", tuple(names), ramps=False)


ALONG_A_RUN: tuple[Cause, ...] = (
    *(_targets, _stations, _focus, _joints, _readings, _loads, _links, _warming),
)
ALONG_A_DAY: tuple[Cause, ...] = (*ALONG_A_RUN[:-1], _warming_slides)
BETWEEN_DAYS: tuple[Cause, ...] = (
    *(_zeros, _mountings, _cameras, _loads, _dimensions, _expansion, _slides, _delays),
)
"""Of changes that do the same the first speaks: zeros of joints, then mountings."""
