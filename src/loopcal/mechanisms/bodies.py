"""Machines of several bodies: robots with two arms, a head, a positioner, or two robots.

Each body hangs on its parent by the joint of a URDF (`loopcal.mechanisms.origins`) or by a row of
Denavit and Hartenberg (`loopcal.mechanisms.serial`). Joints of one name are one reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from loopcal.errors import InputError, listed, unknown_name
from loopcal.mechanisms.chain import Step, axis_parameters, chain_parameters, refuse_long_chain
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, joint_steps
from loopcal.mechanisms.tree import Link, Tree

NAME = "robot"


@dataclass(frozen=True)
class Hanging:
    """A body below its parent: the joint of a URDF, or the row of a table that ties them.

    joint: a `LinkJoint`, a `Joint`, or for a body that is fixed to its parent a `Joint` that
    nothing moves; fixed: whether nothing moves it.
    """

    name: str
    parent: str
    joint: LinkJoint | Joint
    fixed: bool = False

    @property
    def steps(self) -> tuple[Step, ...]:
        """T_parent_body as elementary steps."""
        if isinstance(self.joint, LinkJoint):
            return tuple(self.joint.steps())
        steps = joint_steps(self.joint, self.name)
        return tuple(replace(step, joint=None) for step in steps) if self.fixed else tuple(steps)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Its parameters, those of a `LinkJoint` at their nominal values, others at 0."""
        if isinstance(self.joint, LinkJoint):
            return {p.name: p for p in self.joint.origin}
        if self.fixed:
            return axis_parameters(self.name, self.steps)
        return chain_parameters(self.steps)


def tree_machine(
    bodies: Sequence[Hanging],
    *,
    root: str,
    name: str = NAME,
    masses: Sequence[Load] = (),
    description: Mapping[str, Any] | None = None,
) -> Machine:
    """The machine of bodies that hang on each other, in any order; instruments name two of them.

    T_A_B of two bodies is the product of the joints between them (`loopcal.mechanisms.tree`). root:
    the body that stands for the ground.

    Raises InputError for two bodies of one name, a parent that is no body, a body that does not
    hang on the root in the end, and a machine in which nothing moves.
    """
    by_name: dict[str, Hanging] = {}
    for body in bodies:
        if body.name in by_name or body.name == root:
            raise InputError(
                f"two bodies are named {body.name!r}",
                code="duplicate-name",
                remedy="give each a unique name; the root hangs on nothing",
            )
        by_name[body.name] = body
    hung = [by_name[body] for body in _ordered(by_name, root)]
    tree = Tree({body.name: Link(body.parent, body.steps) for body in hung}, root)
    if not tree.joints:
        raise InputError(
            f"nothing moves between {root!r} and {listed(by_name)}",
            code="missing-key",
            remedy="name bodies with moving joints between them",
        )
    for leaf in tree.leaves:
        refuse_long_chain(sum(step.joint is not None for step in tree.path(leaf)))
    parameters: dict[str, Parameter] = {}
    for body in hung:
        parameters |= body.parameters
    stated = {
        "type": "tree",
        "root": root,
        "fix_redundant": False,
        "bodies": hung,
        "mass": list(masses),
    }

    def frame(x: Mapping[str, Any], p: Mapping[str, Any]) -> ChainFrame:
        return ChainFrame(tree.path(), x, p)

    return Machine(
        name,
        tree.joints,
        parameters,
        frame,
        tree=tree,
        masses=tuple(masses),
        description=stated if description is None else description,
    )


def _ordered(bodies: Mapping[str, Hanging], root: str) -> list[str]:
    """The bodies, each behind its parent."""
    ordered: list[str] = []
    for name in bodies:
        ahead: list[str] = []
        while name != root and name not in ordered:
            if name not in bodies:
                raise unknown_name(
                    f"the body {ahead[-1]!r} hangs on {name!r}, which is no body",
                    name,
                    (root, *bodies),
                )
            if name in ahead:
                raise InputError(
                    f"the bodies {listed(ahead)} hang on each other and not on {root!r}",
                    code="invalid-value",
                    remedy="correct the parent of one of them",
                )
            ahead.append(name)
            name = bodies[name].parent
        ordered += reversed(ahead)
    return ordered
