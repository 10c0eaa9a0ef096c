"""A mechanism: loop equations with named parameters and quantities."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, Instead, unknown_name
from loopcal.expressions.domain import Stage
from loopcal.expressions.engine import engine_for
from loopcal.expressions.rewriting import substituted
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import Inputs, trace
from loopcal.lazy import cached_property
from loopcal.mechanisms.body import Body
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.frame import ChainFrame, forward_kinematics
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.parameters import BEYOND, Parameter, Parameters, Role, declared, matching
from loopcal.mechanisms.quantity import Quantity
from loopcal.mechanisms.terms import Term, check_terms
from loopcal.mechanisms.tree import BASE, BODY, Tree
from loopcal.presentation.shown import in_unit, significant, unit_shown
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.mechanisms.effects.gravity import Load
    from loopcal.mechanisms.structure.sag import Structure


class Placement(Protocol):
    """How the parameters of a mechanism change when the whole machine is moved rigidly."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that say where the instrument sees the machine stand."""

    def moved(
        self, values: Mapping[str, float], rotation: NDArray[np.float64], shift: NDArray[np.float64]
    ) -> dict[str, float]:
        """The parameter values [SI] of the machine moved by p -> rotation @ p + shift.

        In a plane rotation is 2x2 and shift (2,), in space 3x3 and (3,).
        """

    def advice(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """What is wrong with describing the machine by these values [SI], and the remedy."""


PIXELS = "pixels"
"""The form of a family whose readings are an image: many, of which some may be missing."""


@dataclass(frozen=True)
class Family:
    """Loops that stand or fall together: there only in the poses in which their readings are.

    loops: names of its equations; readings: the quantities that belong to it alone, each of which
    follows from the loops and everything else. In a pose without any of these readings the loops
    would say nothing, and are left out. form: what the readings are together: "point" (x, y, z or
    x, y), "spherical" (range, azimuth, elevation), "polar" (range, azimuth), "length" or "angle";
    or "pose" (a point and three small turns), "gap" (between things that touch), "closure" (a
    machine's own loops in a second pose); placement: how the parameters that place the instrument
    change when the machine is moved; remedy: what to do where its loops cannot be evaluated;
    standing: the parameters that say where the instrument stands; mounted: those of what it looks
    at on the body, and of the instrument itself; on, against: the bodies that it looks at and from.
    """

    name: str
    loops: tuple[str, ...]
    readings: tuple[str, ...]
    form: str = "point"
    placement: Placement | None = None
    remedy: str = ""
    standing: tuple[str, ...] = ()
    mounted: tuple[str, ...] = ()
    on: str = BODY
    against: str = BASE


@dataclass(frozen=True)
class Mechanism:
    """Loop equations f(x, p) = 0 with their names, units and nominal values.

    variables: what varies by pose, of which `quantities` and `pose_constants` are name -> SI unit
    of what is read, and of constants that carry no error; parameters: the constants to be
    estimated; outputs: the quantities that the loop predicts from the rest (the end point of an
    arm; may be empty); tape: the loops. description: what a mechanism file says to build this
    mechanism, None if it was written as a function; placement: how the parameters change when the
    machine is moved, if known. families: loops that hold only where their own readings are; home:
    quantity -> value [SI] from which the search for it begins where it is not read; implied:
    quantity -> reading [SI] that it has in every pose by construction, unless the data say
    otherwise; orientations: which known constants are measured orientations; remarks: what a user
    should know of how it was made, such as why a parameter is fixed; tree: its bodies, where
    joints alone tie them, with one leaf for a serial arm; terms: groups of parameters whose common
    prior sd is learnt; body: the loops with bodies that can be displaced, where instruments look at
    any; gravity: the direction in which it pulls, in the base, None for down; latest: known
    constant -> value [SI] after the last change that it dates, for readings of a machine as it is
    now; structure: what its structured model error consists of, None without one; masses: known
    ones of an arm's links; payload: the known constant [kg] that its tool carries; awaiting:
    each `Effect` that acts on a structured model error alone, which it has not yet.
    """

    name: str
    tape: Tape
    variables: tuple[Quantity, ...]
    parameters: Parameters
    outputs: tuple[str, ...] = ()
    description: Mapping[str, Any] | None = None
    placement: Placement | None = None
    families: tuple[Family, ...] = ()
    home: Mapping[str, float] = field(default_factory=dict)
    implied: Mapping[str, float] = field(default_factory=dict)
    orientations: tuple[Orientation, ...] = ()
    remarks: tuple[str, ...] = ()
    tree: Tree | None = None
    terms: tuple[Term, ...] = ()
    body: Body | None = None
    gravity: tuple[float, float, float] | None = None
    latest: Mapping[str, float] = field(default_factory=dict)
    structure: Structure | None = None
    masses: tuple[Load, ...] = ()
    payload: str | None = None
    awaiting: tuple[Any, ...] = ()

    def __new__(cls, *stated: Any, **named: Any) -> Mechanism:
        """Raises InputError for what people type first: the name of a file alone."""
        if len(stated) == 1 and "tape" not in named:
            raise InputError(
                f"a mechanism is not made of {stated[0]!r} alone",
                code="wrong-file-type",
                remedy='lc.load_urdf("robot.urdf") makes an arm of a URDF, lc.machines.tree one '
                'of several limbs; lc.read_mechanism("mechanism.toml") reads a file of loopcal',
            )
        return object.__new__(cls)

    from_urdf = from_file = from_dh = Instead(
        "lc.load_urdf(path) for its kinematics, or lc.calibrate(readings, urdf=path)"
    )

    @classmethod
    def from_function(
        cls,
        function: Callable[[Inputs, Inputs], Iterable[Any]],
        quantities: Mapping[str, str],
        parameters: Mapping[str, tuple[float, str] | Parameter],
        outputs: Sequence[str] = (),
        *,
        pose_constants: Mapping[str, str] | None = None,
        loops: Sequence[str] | None = None,
        name: str | None = None,
        home: Mapping[str, float] | None = None,
    ) -> Mechanism:
        """A mechanism from a plain Python function f(x, p) that is zero where the loops close.

        The function is traced once (see `loopcal.expressions.trace`); x has the quantities and
        known constants by name in SI units, p the parameters. quantities and pose_constants map
        names to units, parameters to (nominal, unit); outputs name the quantities that the loops
        predict from the others; loops name the equations; home says where quantities without a
        sensor usually stand [SI], such as the coordinates of a platform.

        >>> m = Mechanism.from_function(lambda x, p: x.a * p.gain - x.b,
        ...     {"a": "m", "b": "m"}, {"gain": (1.0, "1")}, outputs=("b",))
        >>> print(m.tape)
        loop 1: x.a*p.gain - x.b = 0

        Raises TraceError (an InputError) for what a tape cannot hold.
        """
        pose_constants = pose_constants or {}
        _check_names([*quantities, *pose_constants], parameters)
        tape = trace(
            function,
            quantities=tuple(quantities),
            pose_constants=tuple(pose_constants),
            parameters=tuple(parameters),
            loops=loops,
        )
        return cls(
            name or str(getattr(function, "__name__", "mechanism")),
            tape,
            (
                *(Quantity(q, unit(u).si) for q, u in quantities.items()),
                *(Quantity(q, unit(u).si, "known") for q, u in pose_constants.items()),
            ),
            declared(parameters),
            tuple(outputs),
            home=dict(home or {}),
        )

    @cached_property
    def quantities(self) -> Mapping[str, str]:
        """What is read in each pose, name -> SI unit; disturbances of the model among them."""
        return {v.name: v.unit for v in self.variables if v.role != "known"}

    @cached_property
    def pose_constants(self) -> Mapping[str, str]:
        """Constants that vary by pose and carry no error, name -> SI unit."""
        return {v.name: v.unit for v in self.variables if v.role == "known"}

    @cached_property
    def chain(self) -> tuple[Step, ...]:
        """The steps of a serial arm from its base to its body; none of other machines."""
        return () if self.tree is None else self.tree.serial

    @cached_property
    def joints(self) -> Mapping[str, str]:
        """The joints that move the bodies of an arm or a tree, name -> SI unit."""
        return {} if self.tree is None else self.tree.joints

    @cached_property
    def recorded(self) -> tuple[str, ...]:
        """What two measurements may differ in: all that varies by pose but what only dates it."""
        return tuple(v.name for v in self.variables if v.name not in self.latest)

    @cached_property
    def units(self) -> Mapping[str, str]:
        """Name -> SI unit of all that a pose may have: quantities and known constants."""
        return {**self.quantities, **self.pose_constants}

    @cached_property
    def roles(self) -> Mapping[str, Role]:
        """What each parameter says, by name (see `loopcal.mechanisms.parameters.ROLES`)."""
        return {p.name: p.role for p in self.parameters}

    @cached_property
    def effects(self) -> Mapping[str, tuple[str, ...]]:
        """By name, the parameters of each effect beyond geometry, learnt model error included."""
        named: dict[str, list[str]] = {}
        for p in self.parameters:
            if p.role in BEYOND:
                named.setdefault(p.owner, []).append(p.name)
        return {owner: tuple(names) for owner, names in named.items()}

    @cached_property
    def disturbances(self) -> tuple[str, ...]:
        """Quantities that stand for errors of the machine model: no sensor reads them."""
        return tuple(v.name for v in self.variables if v.role == "disturbance")

    def __post_init__(self) -> None:
        for output in self.outputs:
            if output not in self.quantities:
                raise unknown_name(
                    f"the output {output!r} is not a quantity of the mechanism",
                    output,
                    self.quantities,
                )
        for name in self.home:
            if name not in self.quantities:
                raise unknown_name(
                    f"the home of {self.name!r} names {name!r}, which is not one of its quantities",
                    name,
                    self.quantities,
                )
        if len(set(self.outputs)) > len(self.tape.loops):
            raise InputError(
                f"{len(self.outputs)} outputs cannot be predicted from "
                f"{len(self.tape.loops)} loop equations",
                code="undetermined-quantities",
                remedy="name at most as many outputs as there are loop equations",
            )
        check_terms(self.terms, self.parameters)
        read = {v.name for v in self.variables}
        if both := [name for name in self.parameters.names if name in read]:
            raise InputError(
                f"a reading and a parameter of {self.name!r} have the same name, {both[0]!r}",
                code="duplicate-name",
                remedy=f"give the reading another name, such as {f'read_{both[0]}'!r}, in the "
                "description of the machine and in the readings",
            )

    @cached_property
    def learnt_terms(self) -> tuple[Term, ...]:
        """The terms with a parameter that is not fixed: only their sds can be learnt."""
        free = frozenset(self.parameters.free)
        return tuple(term for term in self.terms if not free.isdisjoint(term.parameters))

    def with_parameters(self, parameters: Parameters) -> Mechanism:
        """The same machine with other nominal values, priors or fixed parameters."""
        if parameters.names != self.parameters.names:
            raise InputError(
                "the parameters are not those of this mechanism",
                code="wrong-shape",
                remedy="change them with Parameters.with_nominal, with_prior, with_fixed",
            )
        return replace(self, parameters=parameters)

    def with_nominal(self, values: Mapping[str, float]) -> Mechanism:
        """The same machine with other nominal values [SI] for the names given."""
        return replace(self, parameters=self.parameters.with_nominal(values))

    def with_terms(self, *terms: Term) -> Mechanism:
        """The same machine with further terms, whose parameters get the term's sd as prior sd.

        Raises InputError for a parameter that is in another term, or is not there.
        """
        every = (*self.terms, *terms)
        # A term's sd begins as the prior sd of its members; the search for it starts there.
        stated = {n: t.sd for t in terms for n in t.parameters if n in self.parameters.names}
        parameters = self.parameters.with_prior(stated)
        check_terms(every, parameters)
        return replace(self, parameters=parameters, terms=every)

    def with_gravity(self, direction: Sequence[float]) -> Mechanism:
        """The same machine on a wall or ceiling: gravity pulls along this vector in its base.

        The base of an arm whose own parameters place it is the frame of its first joint. Raises
        InputError for a vector without direction.
        """
        x, y, z = map(float, direction)
        if not any((x, y, z)) or not all(map(math.isfinite, (x, y, z))):
            raise InputError(
                f"gravity has the direction {[x, y, z]}",
                code="invalid-value",
                remedy="give the vector that points down, (0, 0, -1) where z points up",
            )
        described = self.description and {**self.description, "gravity": [x, y, z]}
        return replace(self, gravity=(x, y, z), description=described)

    def with_same(self, same: Mapping[str, Sequence[str]]) -> Mechanism:
        """The same machine with parameters that equal each other, as of drives of one type.

        same: by a name of your choice, parameters by names or globs; the first is estimated for
        all. Of several globs the first parameters of each are equal, the second ones, and so on.
        Raises InputError for one parameter alone, one in two groups, and different nominal values.
        """
        first: dict[str, str] = {}
        for name, keys in same.items():
            lists = [self.parameters.matching(key) for key in keys]
            for equal in zip(*lists, strict=True) if len({*map(len, lists)}) == 1 else [()]:
                _check_same(name, [self.parameters[n] for n in equal], first)
                first |= dict.fromkeys(equal, equal[0])
        first = {name: to for name, to in first.items() if name != to}
        items = [
            replace(p, same=first[p.name], fixed=True) if p.name in first else p
            for p in self.parameters
        ]
        tied = self.with_tape(
            lambda tape: substituted(tape, lambda x, p: ({}, {n: p[to] for n, to in first.items()}))
        )
        described = self.description and {**self.description, "same": {**same}}
        return replace(tied, parameters=Parameters(tuple(items)), description=described)

    def with_tape(self, change: Callable[[Tape], Tape]) -> Mechanism:
        """The same machine with its loops changed, those of a displaced body alike."""
        body = self.body and replace(self.body, tape=change(self.body.tape))
        return replace(self, tape=change(self.tape), body=body)

    @cached_property
    def predicting_loops(self) -> tuple[int, ...]:
        """Positions of the loops that predict outputs from other readings; all without outputs.

        What an instrument implies beside its outputs (small turns, gaps) is measured with them:
        its loops would pass what is compared on to the prediction.
        """
        implied = {q for f in self.families for q in f.readings if f.form != "closure"}
        # Outputs stay: they are what the kept loops predict.
        implied -= set(self.outputs or implied)
        return tuple(i for i, loop in enumerate(self.tape.loops) if loop not in implied)

    def predicting(self) -> Mechanism:
        """The mechanism with those loops alone that predict outputs from other readings."""
        kept = self.predicting_loops
        if len(kept) == len(self.tape.loops):
            return self
        return replace(self.with_tape(lambda tape: tape.only(kept)), families=())

    @property
    def turns(self) -> tuple[str, ...]:
        """The small turns from a measured to the computed orientation, three for each."""
        return tuple(turn for o in self.orientations for turn in o.turns)

    @cached_property
    def gaps(self) -> tuple[str, ...]:
        """Of a whole robot, gaps and turns between what touches: they should be as they are read.

        On an arm alone they say nothing beside where the thing stands that it touches.
        """
        if self.tree is None or self.chain:
            return ()
        between = (q for f in self.families if f.form == "gap" for q in f.readings)
        return tuple(q for q in between if q in self.implied)

    @property
    def compared(self) -> tuple[str, ...]:
        """What can be compared with what was measured: outputs, turns of orientations, gaps."""
        return (*self.outputs, *self.turns, *self.gaps)

    @property
    def unused(self) -> frozenset[str]:
        """Quantities and known constants that are in no loop."""
        used = frozenset().union(*self.tape.depends_on())
        return frozenset((*self.tape.quantities, *self.tape.pose_constants)) - used

    def quantity_group(self, key: str) -> tuple[str, ...]:
        """The quantities that a name, a glob, or the joined names of the outputs stand for."""
        if self.outputs and key == "".join(self.outputs):
            return self.outputs
        if key == "model" and self.disturbances:
            return self.disturbances
        images = [
            q for f in self.families if f.form == PIXELS and key == f.name for q in f.readings
        ]
        if images:
            return tuple(images)
        return matching(key, self.quantities, "quantity")

    @property
    def remedies(self) -> dict[str, str]:
        """What to do where a loop cannot be evaluated, by its name."""
        return {loop: f.remedy for f in self.families if f.remedy for loop in f.loops}

    def loop_values(
        self, readings: Any, values: Mapping[str, float] | None = None
    ) -> dict[str, NDArray[np.float64]]:
        """Loop -> f(x, p) (N,) [SI]: of a point the computed minus the measured coordinates.

        readings: a Dataset, or quantities and known constants by name, (N,) each [SI]; values: of
        parameters by name [SI], by default all nominal. For estimators of your own. Raises
        InputError for a parameter or a reading that is not there.
        """
        read = getattr(readings, "readings", readings)
        stated = values or {}
        for name in stated:
            self.parameters[name]
        p = np.array([stated.get(q.name, q.nominal) for q in self.parameters])
        names = (*self.tape.quantities, *self.tape.pose_constants)
        rows = [read[n] if n in read else self.implied.get(n) for n in names]
        if missing := [n for n, row in zip(names, rows, strict=True) if row is None]:
            raise unknown_name(f"the reading {missing[0]!r} is absent", missing[0], list(read))
        every = np.array(np.broadcast_arrays(*map(np.asarray, rows)), dtype=float)
        x, constants = np.split(every, [len(self.tape.quantities)])
        engine = engine_for(self.tape, (), max(x.shape[1], 1), ())
        f = engine.evaluate(p, x, constants, Stage.VALUES).f
        return dict(zip(self.tape.loops, np.array(f), strict=True))

    def fk(self, q: Any) -> NDArray[np.float64]:
        """T_base_body (4, 4) [m] of the nominal arm at joints (n,), or (N, 4, 4) of (N, n).

        q: numbers [rad, m] from base to tip, or a mapping or table by the joints' names. Effects
        beyond geometry are left out. Raises InputError for what is no arm, and other columns.
        """
        if not self.chain:
            raise InputError(
                f"{self.name!r} is no arm of joints",
                code="unsupported",
                remedy="calibrate it, and use result.predict(readings)",
            )
        nominal = self.parameters.nominal
        joints = tuple(self.joints)
        return forward_kinematics(lambda x: ChainFrame(self.chain, x, nominal), q, joints)

    def forward_kinematics(self, q: Any) -> NDArray[np.float64]:
        """The same as `fk`."""
        return self.fk(q)

    def _repr_html_(self) -> str:
        from html import escape  # only notebooks ask

        from loopcal.presentation.html import table

        head = ("parameter", "nominal", "unit", "")
        rows = [
            (
                p.name,
                significant(in_unit(p.nominal, p.unit), 6),
                unit_shown(p.unit),
                "fixed" if p.fixed else "",
            )
            for p in self.parameters
        ]
        read = ((name, unit_shown(u)) for name, u in self.quantities.items())
        return f"<p><b>{escape(self.name)}</b></p>" + "".join(
            (table(("quantity", "unit"), read), table(head, rows))
        )

    def __repr__(self) -> str:
        return (
            f"<Mechanism {self.name!r}: {len(self.tape.loops)} loop equations, "
            f"{len(self.quantities)} quantities, {len(self.parameters)} parameters>"
        )


def _check_names(quantities: Sequence[str], parameters: Iterable[str]) -> None:
    for name in [*quantities, *parameters]:
        if not name or any(c.isspace() or c in "*?[]" for c in name):
            raise InputError(
                f"{name!r} cannot be a name",
                code="invalid-value",
                remedy="use letters, digits and underscores: names are also searched by globs",
            )
    if len(set(quantities)) != len(quantities):
        raise InputError(
            "a quantity is declared twice", code="duplicate-name", remedy="name each once"
        )


def _check_same(name: str, equal: Sequence[Parameter], taken: Container[str]) -> None:
    """Raise InputError for parameters that cannot equal each other."""
    if len({p.name for p in equal}) < 2 or len(equal) != len({p.name for p in equal}):
        raise InputError(
            f"{name!r} pairs no parameters",
            code="invalid-value",
            remedy="name two parameters or more, or globs that stand for as many each",
        )
    if twice := [p.name for p in equal if p.name in taken or p.same]:
        raise InputError(
            f"{twice[0]!r} is the same as others in two groups",
            code="duplicate-name",
            remedy="make one group of the two",
        )
    for p in equal[1:]:
        if (p.unit, p.nominal, p.prior_sd) != (equal[0].unit, equal[0].nominal, equal[0].prior_sd):
            raise InputError(
                f"{p.name!r} cannot be the same as {equal[0].name!r}: their nominal values, units "
                f"or prior sds differ",
                code="conflicting-keys",
                remedy="state one value and sd for both, or leave them apart",
            )
