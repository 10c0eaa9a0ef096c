"""Product of exponentials: every joint by its axis in the base frame when all joints read zero.

    T_base_tool(q) = exp([S_1] q_1) ... exp([S_n] q_n) M

S_i: the screw axis of joint i, by a point on it and its direction, in the base frame; M: the home
pose of the tool. Brockett (1984); Lynch and Park, Modern Robotics (2017), chapter 4.

Each axis has four parameters (a prismatic joint two: where its axis stands does not matter), two
shifts and two tilts normal to its nominal direction: exp([S_i] q_i) = A_i Rz(q_i) A_i^-1, with
A_i the nominal axis frame moved by Tx Ty Rx Ry. They are named after the directions: a joint
along the base's z has NAME_x, NAME_y, NAME_rx, NAME_ry.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.chain import (
    AxisFrame,
    JointName,
    Limits,
    Step,
    Triple,
    axis_parameters,
    check_joints,
    fixed_frame,
)
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.tree import Tree

KINDS = ("revolute", "prismatic")
NAME = "product of exponentials"
"""What a machine is called that has no other name."""


@dataclass(frozen=True)
class ScrewJoint:
    """A joint by its axis in the base frame, all joints at zero.

    name: the quantity that is read; axis: unit vector; point: on the axis [m]; kind: "revolute"
    or "prismatic"; limits: of the reading [m or rad], where known.
    """

    name: JointName
    axis: Annotated[Triple, Key("Unit vector in the base frame.")]
    point: Annotated[Triple, Key("A point on the axis.", unit="m")] = (0.0, 0.0, 0.0)
    kind: Annotated[str, Key("How the joint moves.", choices=KINDS)] = "revolute"
    limits: Limits = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(
                f"the joint {self.name!r} is of the kind {self.kind!r}",
                code="unknown-name",
                remedy="give 'revolute' or 'prismatic'",
            )
        AxisFrame.of(self.axis, self.name)

    @property
    def axis_steps(self) -> tuple[Step, ...]:
        """The steps of its parameters, in the frame of its axis."""
        normal = AxisFrame.of(self.axis, self.name).letters[:2]
        shifts = () if self.kind == "prismatic" else normal
        return (
            *(Step(f"t{a}", f"{self.name}_{a}") for a in shifts),
            *(Step(f"r{a}", f"{self.name}_r{a}") for a in normal),
        )

    def steps(self) -> Iterator[Step]:
        """exp([S] q) as elementary steps."""
        frame = AxisFrame.of(self.axis, self.name)
        to_axis = [] if self.kind == "prismatic" else fixed_frame(self.point, (0.0, 0.0, 0.0))
        # The axis passes through `point`: exp([S] q) = T(point) A J(q) A^-1 T(-point).
        yield from to_axis
        yield from frame.moving(self.name, self.kind, self.axis_steps)
        yield from (step.inverse() for step in reversed(to_axis))


def exponentials(
    joints: Sequence[ScrewJoint],
    *,
    home: tuple[Triple, Triple] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    name: str = NAME,
) -> Machine:
    """The machine T = exp([S_1] q_1) ... exp([S_n] q_n) M, joints from the base to the tip.

    home: the tool's frame M with all joints at zero, xyz [m] and roll, pitch, yaw [rad].
    Quantities: the joints' readings by their names [rad or m]; parameters, nominally 0: where each
    axis lies, by two shifts [m] (of a prismatic joint none) and two tilts [rad] normal to it. Of
    one along z these are NAME_x, NAME_y, NAME_rx, NAME_ry.

    Source: Brockett (1984); Lynch and Park (2017), chapter 4.
    Raises InputError for a machine without joints, or with two joints of one name.
    """
    joints = tuple(joints)
    if not joints:
        raise InputError(
            "the machine has no joint", code="missing-key", remedy="list at least one joint"
        )
    check_joints([joint.name for joint in joints])
    steps = merged([*(s for joint in joints for s in joint.steps()), *fixed_frame(*home)])
    parameters = [p for j in joints for p in axis_parameters(j.name, j.axis_steps).values()]
    return Machine(
        name,
        {j.name: "m" if j.kind == "prismatic" else "rad" for j in joints},
        {p.name: p for p in parameters},
        lambda x, p: ChainFrame(steps, x, p),
        tree=Tree.chain(steps),
        description={
            "type": "exponentials",
            "fix_redundant": False,
            "home": dict(zip(("xyz", "rpy"), home, strict=True)),
            "joints": list(joints),
        },
    )


def merged(steps: Sequence[Step]) -> tuple[Step, ...]:
    """The same chain, fixed displacements that follow each other as one along each axis."""
    made: list[Step] = []
    run: dict[str, float] = {}
    for step in steps:
        if step.motion[0] == "t" and step.parameter is None and step.joint is None:
            # Shifts commute with each other, so a run of them is one step along each axis.
            run[step.motion] = run.get(step.motion, 0.0) + step.constant
            continue
        made += [Step(motion, constant=v) for motion, v in run.items() if v != 0.0]
        run = {}
        made.append(step)
    made += [Step(motion, constant=v) for motion, v in run.items() if v != 0.0]
    return tuple(made)
