"""Machines and instruments apart, and the mechanism that they make together.

A machine says what moves: joints, passive joints and platforms with the loops that tie them, and
the frame of the body that is looked at. An instrument says what is read of that body. Each of an
instrument's loops predicts one of its own readings, and it is there in those poses only in which
the instrument was read. Parameters of the same name are the same parameter, wherever they stand.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, ParamSpec, get_type_hints

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest, refuse_repeated
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.keys import Key, described
from loopcal.mechanisms.body import Body, Displaced, displacement_names
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.frame import (
    ChainFrame,
    Frame,
    Relative,
    Values,
    Vector,
    forward_kinematics,
)
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.mechanism import Family, Mechanism, Placement
from loopcal.mechanisms.parameters import OF_CAMERAS, Gauge, Parameter, fixed, held, stated
from loopcal.mechanisms.tree import BASE, BODY, Tree
from loopcal.presentation.shown import brief

if TYPE_CHECKING:
    from loopcal.mechanisms.effects.gravity import Load

Arguments = ParamSpec("Arguments")
SECOND = 0.01
"""By how much [m, rad] the home of a row's second pose differs from that of the first."""
TOOL = "tool"
"""Owner of coordinates on the body that were named one by one."""
ENDS = ("", "_b")
"""What names the quantities of both poses of a row; `Quantity.first` says which belong together."""


_INSTEAD = {
    **dict.fromkeys(("joints", "joint_names", "names", "q", "qlim"), "robot.quantities"),
    **dict.fromkeys(("links", "dh", "params", "offsets"), "robot.parameters"),
    **dict.fromkeys(("dof", "n_joints", "n", "ndof"), "len(robot)"),
    **dict.fromkeys(("fit", "identify"), "lc.calibrate(readings, urdf='robot.urdf')"),
    **dict.fromkeys(
        ("plot", "show", "to_urdf", "save", "export"),
        "lc.calibrate(readings, urdf='robot.urdf') first: its result has it",
    ),
    **dict.fromkeys(
        ("ik", "inverse_kinematics", "jacobian", "jacob0", "ikine", "ikine_LM", "inverse"),
        "lc.correct(result, targets), which solves for joints, or another library on the URDF of "
        "result.to_urdf('robot.urdf')",
    ),
    "calibrate": "lc.calibrate(readings, urdf='robot.urdf'), or lc.assemble(robot, instruments)",
    **{
        name: f"lc.{name}(lc.assemble(robot, instruments), ...)"
        for name in ("check", "plan", "simulate")
    },
    **dict.fromkeys(("forward", "tool_pose", "fkine", "forward_kinematics", "pose"), "robot.fk(q)"),
}
"""What people type instead of a name, and the call that does it."""


@dataclass(frozen=True)
class Machine:
    """What moves, without any instrument.

    quantities: joints, passive joints and platform coordinates, name -> SI unit; parameters by
    name; frame(x, p): T_base_body; equations(x, p): values of the closure loops, named in
    `loops`; home: a typical value [SI] of the quantities that no sensor may read, from which the
    search for them begins; pose_constants: those that vary by pose; implied: quantities that have
    the same reading in every pose; dimension: 2 for a machine that moves in the plane z = 0; gauge:
    parameters that only say where its frames lie; tree: its bodies, where joints alone tie them,
    with one leaf for a serial arm; lines(x, p): what draws it, polylines of points (3,) [m] in its
    base frame; masses: known ones of its links; description: what a mechanism file says to build
    it, empty where none can.
    """

    name: str
    quantities: Mapping[str, str]
    parameters: Mapping[str, Parameter]
    frame: Callable[[Values, Values], Frame]
    loops: tuple[str, ...] = ()
    equations: Callable[[Values, Values], Sequence[Any]] = lambda x, p: ()
    home: Mapping[str, float] = field(default_factory=dict)
    pose_constants: Mapping[str, str] = field(default_factory=dict)
    implied: Mapping[str, float] = field(default_factory=dict)
    dimension: int = 3
    gauge: Gauge = field(default_factory=Gauge)
    tree: Tree | None = None
    lines: Callable[[Values, Values], list[list[Vector]]] | None = None
    masses: tuple[Load, ...] = ()
    description: Mapping[str, Any] = field(default_factory=dict)

    @property
    def chain(self) -> tuple[Step, ...]:
        """The steps from the base to the body of a serial arm; none of other machines."""
        return () if self.tree is None else self.tree.serial

    def seen(self, on: str, against: str, x: Values, p: Values) -> Frame:
        """T_against_on of two bodies in one pose."""
        if self.tree is None or (on, against) == (BODY, BASE):
            body = self.frame(x, p)
            return body if against == BASE else Relative(ChainFrame((), {}, {}), body)
        return ChainFrame(self.tree.path(on, against), x, p)

    def fk(
        self, q: Any, *, on: str | None = None, against: str | None = None
    ) -> NDArray[np.float64]:
        """T_against_on (4, 4) [m] of the nominal machine at readings (n,), or (N, 4, 4) of (N, n).

        q: numbers [rad, m] in the order of `quantities`, or a mapping or table by their names. on,
        against: bodies of a tree; by default its only leaf, and its root. Raises InputError for
        other columns and bodies.
        """
        nominal = {p.name: p.nominal for p in self.parameters.values()}
        names = (*self.quantities, *self.pose_constants)
        pair = looked_between(self, on, against)
        each = self.tree is None
        return forward_kinematics(lambda x: self.seen(*pair, x, nominal), q, names, each=each)

    def forward_kinematics(self, q: Any) -> NDArray[np.float64]:
        """The same as `fk`."""
        return self.fk(q)

    __call__ = fk

    def __len__(self) -> int:
        """Of `quantities`."""
        return len(self.quantities)

    def __getitem__(self, key: object) -> NoReturn:
        raise TypeError(
            f"a Machine has no part {key!r}: use robot.quantities for its joints, "
            "robot.parameters for its constants, or robot.fk(q)"
        )

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            words = f"a Machine has no attribute {name!r}"
            if name in _INSTEAD:
                words += f": use {_INSTEAD[name]}"
            elif not name.startswith("_"):
                words += f": {nearest(name, [n for n in dir(self) if n[0] != '_'])}"
            raise AttributeError(words, name=name, obj=self)

    def __repr__(self) -> str:
        return f"<Machine {self.name!r}: {len(self.quantities)} quantities>"

    def _repr_html_(self) -> str:
        from loopcal.presentation.html import table

        head = ["parameter", "nominal", "unit"]
        return table(head, [[n, f"{p.nominal:.6g}", p.unit] for n, p in self.parameters.items()])


@dataclass(frozen=True)
class Instrument:
    """What is read of a body of a machine, from another one or from the ground.

    readings: its own quantities, name -> SI unit; equations(frames, x, p): one loop value for
    each of `loops`, as many as readings, such that each reading follows from the rest; frames are
    T_against_on, one for each pose that a row holds (`ends`). on, against: the two bodies of a
    tree, by default its only leaf and its root.
    placement: parameters that say where it stands, with `place` telling how they change when the
    machine is moved; parameters: the others (reflector, length, zero), of which those in mounted
    say where something sits on the body; pose_constants: those that vary by pose; orientation:
    which of them are a measured orientation; implied: readings that are the same in every pose by
    construction, such as the gap between a ball and its socket; form: what the readings are
    together, "point", "spherical", "polar", "pose", "length", "angle", "gap" (of things that
    touch) or a word of its own; dimension: that of the machines it can look
    at, 2 or 3; remedy: what to do where its loops cannot be evaluated; description: what a
    mechanism file says of it, empty where none can.
    """

    __repr__ = brief

    name: str
    readings: Mapping[str, str]
    parameters: Mapping[str, Parameter]
    equations: Callable[[Sequence[Frame], Values, Values], Sequence[Any]]
    form: str
    placement: Mapping[str, Parameter] = field(default_factory=dict)
    place: Placement | None = None
    mounted: tuple[str, ...] = ()
    pose_constants: Mapping[str, str] = field(default_factory=dict)
    orientation: Orientation | None = None
    implied: Mapping[str, float] = field(default_factory=dict)
    ends: int = 1
    dimension: int = 3
    remedy: str = ""
    on: str | None = None
    against: str | None = None
    description: Mapping[str, Any] = field(default_factory=dict)

    @property
    def loops(self) -> tuple[str, ...]:
        """Names of its loop equations: those of its readings."""
        return tuple(self.readings)


@dataclass(frozen=True)
class Between:
    """The two bodies of a tree between which an instrument measures."""

    on: Annotated[
        str | None,
        Key(
            "The body of a tree that is looked at. Default: its only leaf; of other machines "
            '"body", or "base" where it is looked at from the body.'
        ),
    ] = None
    against: Annotated[
        str | None,
        Key(
            "The body of a tree that it is looked at from. Default: its root, the ground; of other "
            'machines "base". Write "body" for an instrument on the machine that looks at the base.'
        ),
    ] = None


def recorded(
    make: Callable[Arguments, Instrument], also: Mapping[str, Any] = MappingProxyType({})
) -> Callable[..., Instrument]:
    """The same maker of instruments, which writes what it was given into `description`.

    It takes the two bodies too, `on` and `against`, unless it does so itself. also: further keys by
    name, with their annotations, that no equation needs.
    """
    signature = inspect.signature(make)
    bodies = get_type_hints(Between, include_extras=True)
    added = {} if "on" in signature.parameters or "between" in signature.parameters else bodies
    keys = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
        for name, kind in (*also.items(), *added.items())
    ]
    whole = signature.replace(parameters=[*signature.parameters.values(), *keys])

    @wraps(make)
    def made(*args: Any, **kwargs: Any) -> Instrument:
        arguments = whole.bind(*args, **kwargs).arguments
        between = {name: kwargs.pop(name, None) for name in added}
        kwargs = {name: value for name, value in kwargs.items() if name not in also}
        return replace(make(*args, **kwargs), **between, description=described(made, arguments))

    made.__signature__ = whole  # type: ignore[attr-defined]
    made.__annotations__ = {**make.__annotations__, **also, **added}
    return made


def looked_between(machine: Machine, on: str | None, against: str | None) -> tuple[str, str]:
    """The names of two bodies of a machine (see `Tree.between`)."""
    if machine.tree is not None:
        return machine.tree.between(on, against)
    if against == BODY and on in (None, BASE):
        return BASE, BODY
    if on in (None, BODY) and against in (None, BASE):
        return BODY, BASE
    raise InputError(
        f"{machine.name!r} has no body {(against if on in (None, BODY, BASE) else on)!r}: its "
        "loops tie one body to the base",
        code="unsupported",
        remedy='leave on and against out, or write against = "body" where the instrument moves '
        "along and looks at the base",
    )


def assemble(
    machine: Machine,
    instruments: Sequence[Instrument] = (),
    nominal: Mapping[str, float | Parameter] | None = None,
) -> Mechanism:
    """The mechanism of a machine and the instruments that look at it.

    nominal: values [SI] of parameters by name, in place of their own. Without instruments only
    the machine's own loops are there: it calibrates itself if its sensors are redundant.
    Parameters that place a frame which no instrument ties are fixed (`gauge`).

    Raises InputError for names that readings, instruments or things of different kinds share. The
    same for an instrument of another dimension than the machine's, and for unknown parameters.
    """
    instruments = [_looking(machine, i) for i in instruments]
    ends = max((i.ends for i in instruments), default=1)
    quantities = {q + end: u for end in ENDS[:ends] for q, u in machine.quantities.items()}
    readings = [*quantities, *(q for i in instruments for q in i.readings)]
    refuse_repeated(readings, "two readings of the mechanism are named {!r}")
    refuse_repeated(
        [i.name for i in instruments], "two instruments of the mechanism are named {!r}"
    )
    _refuse_misfits(machine, instruments)
    closure = [loop + end for end in ENDS[:ends] for loop in machine.loops]
    pose_constants = {
        name + end: u for end in ENDS[:ends] for name, u in machine.pose_constants.items()
    }
    if not closure and not instruments:
        raise InputError(
            f"{machine.name!r} has no loop: only its joints are read",
            code="undetermined-quantities",
            remedy="add an instrument that measures it",
        )
    # A shared name keeps its first declaration: stations before the machine, the machine before
    # targets.
    parameters: dict[str, Parameter] = {}
    root = _root(machine)
    for part in (
        *(_placed(i, i.placement, on_body=i.against != root) for i in instruments),
        machine.parameters,
        *(_placed(i, i.parameters) for i in instruments),
    ):
        parameters |= {name: p for name, p in part.items() if name not in parameters}
    drawn = parameters | stated(parameters, nominal or {})
    without_effect = held(machine.gauge, instruments, drawn)
    # A file that is read again states each of them: calibrated values may tie other coordinates.
    maybe_held = without_effect.union(machine.gauge.names)
    parameters = fixed(parameters, without_effect)
    parameters |= stated(parameters, nominal or {})

    def loops(x: Any, p: Any, displaced: Displacements | None = None) -> list[Any]:
        varying = [*machine.quantities, *machine.pose_constants]
        rows = [{name: x[name + end] for name in varying} for end in ENDS[:ends]]
        values = [value for row in rows for value in machine.equations(row, p)]
        pairs = dict.fromkeys((str(i.on), str(i.against)) for i in instruments)
        seen = {pair: _frames(machine, pair, rows, p, displaced or {}) for pair in pairs}
        for i in instruments:
            values += i.equations(seen[str(i.on), str(i.against)], x, p)
        return values

    measured = {q: u for i in instruments for q, u in i.readings.items()}
    alone = instruments[0] if len(instruments) == 1 else None
    made = Mechanism.from_function(
        loops,
        quantities=quantities | measured,
        parameters=parameters,
        outputs=[q for i in instruments for q in i.readings if q not in i.implied],
        pose_constants=pose_constants
        | {name: u for i in instruments for name, u in i.pose_constants.items()},
        loops=[*closure, *measured],
        name=machine.name,
    )
    # The sensor of a variable is the same in both poses of a row.
    firsts = (
        {q + ENDS[1]: q for q in (*machine.quantities, *machine.pose_constants)} if ends > 1 else {}
    )
    return replace(
        made,
        variables=tuple(replace(v, first=firsts.get(v.name)) for v in made.variables),
        families=tuple(_families(machine, instruments, ends)),
        home=_home(machine, ends),
        implied={**machine.implied, **{q: v for i in instruments for q, v in i.implied.items()}},
        orientations=tuple(i.orientation for i in instruments if i.orientation),
        tree=machine.tree,
        masses=machine.masses,
        placement=alone.place if alone is not None and alone.against == root else None,
        body=_body(machine, instruments, made.tape, loops) if instruments else None,
        description=_description(machine, instruments, maybe_held),
    )


Displacements = Mapping[str, tuple[tuple[str, ...], ...]]
"""By body, for each pose of a row, the names of its displacements."""


def _root(machine: Machine) -> str:
    return BASE if machine.tree is None else machine.tree.root


def _looking(machine: Machine, instrument: Instrument) -> Instrument:
    """The instrument with the names of its two bodies; what it has on either sits there."""
    on, against = looked_between(machine, instrument.on, instrument.against)
    return replace(instrument, on=on, against=against)


def _frames(
    machine: Machine,
    pair: tuple[str, str],
    rows: Sequence[Values],
    p: Values,
    displaced: Displacements,
) -> list[Frame]:
    """T_against_on of a pair of bodies for each pose of a row, their displacements included."""
    on, against = pair
    if not displaced:
        return [machine.seen(on, against, row, p) for row in rows]
    root = _root(machine)

    def stands(body: str, i: int) -> Frame:
        return Displaced.by(machine.seen(body, root, rows[i], p), displaced[body][i], p)

    # What displaces a body is stated in the base, joints that both have in common included.
    ends = range(len(rows))
    if against == root:
        return [stands(on, i) for i in ends]
    if on == root:
        still = ChainFrame((), {}, {})
        return [Relative(still, stands(against, i)) for i in ends]
    return [Relative(stands(on, i), stands(against, i)) for i in ends]


def _body(
    machine: Machine, instruments: Sequence[Instrument], tape: Tape, loops: Callable[..., Any]
) -> Body:
    """The bodies that the instruments look at and from, for a tape of these loops."""
    ends = ENDS[: max(i.ends for i in instruments)]
    root = _root(machine)
    bodies = dict.fromkeys(str(b) for i in instruments for b in (i.on, i.against) if b != root)
    displaced = {
        body: tuple(displacement_names(body, machine.dimension, end) for end in ends)
        for body in bodies
    }
    held_up = (tuple(i.placement) if i.against != root else () for i in instruments)
    mounted = (*(i.mounted for i in instruments), *held_up)
    return Body(
        trace(
            lambda x, p: loops(x, p, displaced),
            quantities=tape.quantities,
            pose_constants=tape.pose_constants,
            parameters=(*tape.parameters, *(n for of in displaced.values() for r in of for n in r)),
            loops=tape.loops,
        ),
        displaced,
        tuple(dict.fromkeys(names for names in mounted if names)),
        frozenset(body for body in bodies if _turns(body, instruments)),
    )


def _turns(body: str, instruments: Sequence[Instrument]) -> bool:
    """Whether what is read depends on how a body is turned.

    Two targets, or a turn of one, show it; one point alone does not.
    """
    on = [(i, [i.parameters[n] for n in i.mounted]) for i in instruments if i.on == body]
    against = [(i, list(i.placement.values())) for i in instruments if i.against == body]
    things = [sitting for _, sitting in (*on, *against) if sitting]
    turning = [p for sitting in things for p in sitting if p.unit == "rad"]
    points = {tuple(p.name for p in sitting if p.unit != "rad") for sitting in things}
    poses = [i for i, _ in (*on, *against) if i.form == "pose"]
    return bool(turning or poses) or len(points) > 1


def _placed(
    instrument: Instrument, part: Mapping[str, Parameter], *, on_body: bool = False
) -> dict[str, Parameter]:
    """Parameters of an instrument: the place of something on a body, or on the ground."""
    return {
        name: p
        if p.role in OF_CAMERAS
        else p.of("mounting", p.owner or (instrument.name if on_body else TOOL))
        if on_body or name in instrument.mounted
        else p.of("placement", p.owner or instrument.name)
        for name, p in part.items()
    }


def _description(
    machine: Machine, instruments: Sequence[Instrument], names: Iterable[str]
) -> dict[str, Any] | None:
    """What a mechanism file says of them; None where one of them is a user's own."""
    if not machine.description or not all(i.description for i in instruments):
        return None
    return {
        **machine.description,
        "instrument": [i.description for i in instruments],
        "held": sorted(names),
    }


def _families(machine: Machine, instruments: Sequence[Instrument], ends: int) -> Iterable[Family]:
    if ends > 1 and machine.loops:
        loops = tuple(loop + ENDS[1] for loop in machine.loops)
        yield Family(
            "second pose", loops, tuple(q + ENDS[1] for q in machine.quantities), "closure"
        )
    for i in instruments:
        parameters = tuple(i.placement), tuple(i.parameters)
        yield Family(
            i.name,
            i.loops,
            tuple(i.readings),
            i.form,
            i.place,
            i.remedy,
            *parameters,
            on=str(i.on),
            against=str(i.against),
        )


def _home(machine: Machine, ends: int) -> dict[str, float]:
    """Where searches begin; the second pose a little aside: two in one place have no distance."""
    return {
        q + end: v + SECOND * number
        for number, end in enumerate(ENDS[:ends])
        for q, v in machine.home.items()
    }


def _refuse_misfits(machine: Machine, instruments: Sequence[Instrument]) -> None:
    for i in instruments:
        if i.dimension != machine.dimension:
            raise InputError(
                f"the instrument {i.name!r} measures in {i.dimension} dimensions, but "
                f"{machine.name!r} moves in {machine.dimension}",
                code="unsupported",
                remedy=f"make it for {machine.dimension} dimensions",
            )
        names = {*i.placement, *i.parameters}
        # Of a chain a parameter shared with a target would be one number in two frames.
        if machine.tree and (shared := names & set(machine.parameters)):
            raise InputError(
                f"{min(shared)!r} is a parameter of a joint and of the instrument {i.name!r}",
                code="duplicate-name",
                remedy="name the station or target of the instrument differently",
            )
    on_bodies = {*machine.parameters, *(n for i in instruments for n in i.parameters)}
    for i in instruments:
        for other in instruments:
            shared = set(i.placement) & set(other.placement)
            if shared and set(i.placement) != set(other.placement):
                _refuse_shared(i, f"where {other.name!r} stands", shared)
            sits = set(i.mounted) & set(other.mounted)
            if sits and i.on != other.on:
                raise InputError(
                    f"{min(sits)!r} would say where something sits on {i.on!r} and on {other.on!r}",
                    code="duplicate-name",
                    remedy="give the target of each instrument another name: "
                    f'target = "{i.name}_target"',
                )
        if shared := set(i.placement) & on_bodies:
            _refuse_shared(i, "something else of the machine or on its body", shared)


def _refuse_shared(instrument: Instrument, other: str, shared: set[str]) -> None:
    raise InputError(
        f"{min(shared)!r} would be a parameter of both the placement of the instrument "
        f"{instrument.name!r} and {other}, which are not of the same kind",
        code="duplicate-name",
        remedy="rename one of them; equal names share their parameters",
    )
