"""Serial arms: joints in one of the field's conventions, seen by an instrument as a point.

Each convention is a recipe for elementary steps around the joint's own motion (i: number of the
joint from 1, for the transitions from 0):

- "dh", classical Denavit and Hartenberg (1955): Rz(offset + theta) Tz(d) Tx(a) Rx(alpha);
- "mdh", modified, Craig (1986): Rx(alpha) Tx(a) Rz(offset + theta) Tz(d);
- "hayati", Hayati and Mirmirani (1985), for a next axis nearly parallel:
  Rz(offset + theta) Tx(a) Rx(alpha) Ry(beta);
- "transition-x", "-y", "-z", the seed's four parameters (chapter 5): move within the coordinate
  plane most nearly normal to the joint axis to where the axis pierces it. Turn about the two axes
  of that plane, then by the joint about the named axis: Tx Ty Rx Ry Rz(theta) for z,
  Tx Tz Rx Rz Ry(theta) for y, Ty Tz Ry Rz Rx(theta) for x.

A prismatic joint moves along the axis about which a revolute one turns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from loopcal.errors import InputError, refuse_repeated, unknown_name
from loopcal.keys import Key
from loopcal.mechanisms.chain import MOTIONS, JointName, Step, chain_parameters, refuse_long_chain
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.instruments.point import point as cartesian
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.placement import ChainPlacement
from loopcal.mechanisms.station import Station, Target
from loopcal.mechanisms.tree import Tree

NAME = "serial arm"
"""What an arm is called that has no other name."""
FORMS = ("dh", "mdh", "hayati", "transition-x", "transition-y", "transition-z")
KINDS = ("revolute", "prismatic")
Direction = Annotated[int, Key("-1: the reading counts against the axis.", choices=(1, -1))]
_PLANES = {"z": "xy", "y": "xz", "x": "yz"}


def moved_by(motion: str) -> str:
    """SI unit of a fixed motion such as "tx" or "rz"."""
    return "m" if motion[0] == "t" else "rad"


Motions = Annotated[
    Mapping[str, float],
    Key(
        "Fixed, exactly known motions in the order of writing: displacements along x, y, z and "
        "turns about them.",
        unit=moved_by,
        choices=MOTIONS,
    ),
]


@dataclass(frozen=True)
class Joint:
    """One joint of a serial arm.

    name: the quantity that is read; form: "dh", "mdh", "hayati", "transition-x", "-y" or "-z";
    kind: "revolute" or "prismatic"; direction: +1, or -1 where the reading counts against the
    axis; before, after: fixed, exactly known motions ({"rx": 1.57, "tz": 0.1}, in the order of
    writing, [m, rad]) ahead of and behind this joint's own transform.
    """

    name: JointName
    form: Annotated[str, Key("Convention of the joint.", choices=FORMS)] = "dh"
    kind: Annotated[str, Key("How the joint moves.", choices=KINDS)] = "revolute"
    direction: Direction = 1
    before: Motions = field(default_factory=dict)
    after: Motions = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise unknown_name(f"joint {self.name!r} has the form {self.form!r}", self.form, FORMS)
        if self.kind not in KINDS:
            raise InputError(
                f"joint {self.name!r} is of the kind {self.kind!r}",
                code="unknown-name",
                remedy="give 'revolute' or 'prismatic'",
            )
        if self.direction not in (1, -1):
            raise InputError(
                f"joint {self.name!r} has the direction {self.direction!r}",
                code="invalid-value",
                remedy="give 1, or -1 where the reading counts against the axis",
            )
        for motion in (*self.before, *self.after):
            if motion not in MOTIONS:
                raise unknown_name(
                    f"joint {self.name!r} has the fixed motion {motion!r}", motion, MOTIONS
                )


def parameter_keys(form: str) -> tuple[str, ...]:
    """The keys of a form's parameters, in the order of the method's tables."""
    if form.startswith("transition"):
        a, b = tuple(_PLANES[form[-1]])
        return (a, b, f"phi{a}", f"phi{b}")
    return ("a", "alpha", "beta", "offset") if form == "hayati" else ("a", "d", "alpha", "offset")


def parameter_name(form: str, key: str, number: int | str) -> str:
    """Name of a parameter of the joint with this number (from 1): a_1, d_1, ...; x0, phix0, ...

    number: or the name of its body, in a tree: a_BODY, phix_BODY.
    """
    counted = isinstance(number, int) and form.startswith("transition")
    return f"{key}{number - 1}" if counted else f"{key}_{number}"  # type: ignore[operator]


def joint_steps(joint: Joint, number: int | str) -> list[Step]:
    """The elementary steps of one joint; number: see `parameter_name`."""

    def named(motion: str, key: str) -> Step:
        return Step(motion, parameter_name(joint.form, key, number))

    def moving(motion: str, key: str | None = None) -> Step:
        parameter = parameter_name(joint.form, key, number) if key else None
        return Step(motion, parameter, joint.name, joint.direction)

    revolute = joint.kind == "revolute"
    turn = moving("rz", "offset") if revolute else named("rz", "offset")
    slide = named("tz", "d") if revolute else moving("tz", "d")
    match joint.form:
        case "dh":
            steps = [turn, slide, named("tx", "a"), named("rx", "alpha")]
        case "mdh":
            steps = [named("rx", "alpha"), named("tx", "a"), turn, slide]
        case "hayati":
            steps = [turn, named("tx", "a"), named("rx", "alpha"), named("ry", "beta")]
            if not revolute:
                steps.insert(1, moving("tz"))
        case _:
            axis = joint.form[-1]
            a, b = tuple(_PLANES[axis])
            steps = [named(f"t{a}", a), named(f"t{b}", b)]
            steps += [named(f"r{a}", f"phi{a}"), named(f"r{b}", f"phi{b}")]
            steps.append(moving(("r" if revolute else "t") + axis))
    fixed = [[Step(m, constant=v) for m, v in part.items()] for part in (joint.before, joint.after)]
    return [*fixed[0], *steps, *fixed[1]]


def base_names() -> tuple[str, ...]:
    """Names of the six parameters of the base's placement."""
    return Station("base").parameters


def tool_names(joints: Sequence[Joint]) -> tuple[str, str, str]:
    """Names of the tool point's coordinates: the seed's x6B, ... for transitions, else tool_x."""
    if all(joint.form.startswith("transition") for joint in joints):
        n = len(joints)
        return (f"x{n}B", f"y{n}B", f"z{n}B")
    return ("tool_x", "tool_y", "tool_z")


def places_itself(mechanism: Mechanism) -> bool:
    """Whether an arm's own transitions say where it stands: it has no other joints, and none of its
    instruments has a station."""
    if isinstance(mechanism.placement, ChainPlacement):
        return True
    joints = (mechanism.description or {}).get("joints", ())
    forms = [joint.form if isinstance(joint, Joint) else "" for joint in joints]
    transitions = bool(forms) and all(form.startswith("transition") for form in forms)
    return transitions and not any(family.placement for family in mechanism.families)


def chain_steps(joints: Sequence[Joint]) -> tuple[Step, ...]:
    """All steps of an arm, from its base to the last link's frame."""
    return tuple(
        step for number, joint in enumerate(joints, 1) for step in joint_steps(joint, number)
    )


def chain_machine(
    steps: Sequence[Step], *, name: str, description: Mapping[str, Any] | None = None
) -> Machine:
    """The machine whose body is the last frame of a chain; its parameters are nominally 0."""
    steps = tuple(steps)
    return Machine(
        name,
        {step.joint: step.unit for step in steps if step.joint},
        chain_parameters(steps),
        lambda x, p: ChainFrame(steps, x, p),
        tree=Tree.chain(steps),
        description=description or {},
    )


def serial_machine(joints: Sequence[Joint], *, name: str = NAME) -> Machine:
    """A serial arm without any instrument; joints from the base to the tip, the body is the last.

    T_base_body = T_1 ... T_n, the T_i in the forms of the joints (see `Joint`). Quantities: the
    joints' readings by their names [rad or m]; parameters, nominally 0, by number from 1: a_i,
    d_i [m], alpha_i, offset_i [rad] ("hayati": beta_i in place of d_i; transitions, from 0: two of
    x0, y0, z0 and of phix0, phiy0, phiz0).

    Sources: Denavit and Hartenberg (1955); Craig (1986); Hayati and Mirmirani (1985).
    Raises InputError for an arm without joints, or with two joints of one name.
    """
    joints = tuple(joints)
    if not joints:
        raise InputError(
            "a serial arm has no joints", code="missing-key", remedy="list at least one joint"
        )
    refuse_long_chain(len(joints))
    _check_distinct([joint.name for joint in joints])
    described = {"type": "serial", "joints": list(joints)}
    return chain_machine(chain_steps(joints), name=name, description=described)


def serial_arm(
    joints: Sequence[Joint],
    nominal: Mapping[str, float | Parameter],
    *,
    base: bool | None = None,
    point: tuple[str, str, str] = ("x", "y", "z"),
    name: str = NAME,
) -> Mechanism:
    """A serial arm whose tool point an instrument measures as x, y, z in its own frame.

    Loops: T_instrument_base T_1 ... T_n [tool 1]^T - [x y z 1]^T = 0 (three equations [m]).

    joints from the base to the tip; nominal: values [SI] of the parameters by name, those not
    given are 0; base: whether the base's placement in the instrument's frame is made of six
    parameters base_x ... base_rx (default: unless all joints are transitions, whose parameters
    hold it already); point: names of the three measured coordinates.

    Raises InputError for a joint or parameter name that is not one of this arm's.
    """
    machine = serial_machine(joints, name=name)
    _check_distinct([*machine.quantities, *point])
    tool = tool_names(joints)
    transitions = tool[0] != "tool_x"
    base = not transitions if base is None else base
    instrument = cartesian(readings=point, station="base" if base else None, target=Target(tool))
    made = assemble(machine, [instrument], nominal)
    placement = made.placement
    if transitions and not base:
        placement = ChainPlacement.of(chain_steps(joints), tool)
    described = {"type": "serial", "base": base, "point": list(point), "joints": list(joints)}
    made = replace(made, description=described, placement=placement)
    # Where no station places the arm, parameters of its first transitions do.
    placing = () if placement is None else placement.parameters
    return made.with_parameters(made.parameters.with_role("placement", placing))


def _check_distinct(names: Sequence[str]) -> None:
    """Joints and coordinates are read apart, so no two of them may share a name."""
    words = "{!r} names two readings of the arm (joints and measured coordinates)"
    refuse_repeated(names, words, "give every joint and every coordinate a unique name")
