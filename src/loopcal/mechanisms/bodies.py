"""Machines of several bodies: robots with two arms, a head, a positioner, or two robots.

Each body hangs on its parent by the joint of a URDF (`loopcal.mechanisms.origins`) or by a row of
Denavit and Hartenberg (`loopcal.mechanisms.serial`). Joints of one name are one reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from loopcal.errors import InputError, listed, unknown_name
from loopcal.keys import Key
from loopcal.mechanisms.chain import Step, axis_parameters, chain_parameters, refuse_long_chain
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, joint_steps
from loopcal.mechanisms.tree import Link, Tree

NAME = "robot"


@dataclass(frozen=True)
class Hanging:
    """A body below its parent: the joint of a URDF, or the row of a table, that ties them.

    fixed: of a row, whether nothing moves it, so that its name is read nowhere; standing: whether
    the joint is where a robot stands, which no drawing states.

    Raises InputError unless exactly one of joint and row is there.
    """

    name: Annotated[str, Key("Name of the body; of a row it ends the names of its parameters.")]
    parent: Annotated[str, Key("The body on which it hangs.")]
    joint: Annotated[LinkJoint | None, Key("The joint of a URDF that ties it to its parent.")] = (
        None
    )
    row: Annotated[Joint | None, Key("The row of Denavit and Hartenberg that ties it.")] = None
    fixed: Annotated[bool, Key("Of a row, whether nothing moves it.")] = False
    standing: Annotated[
        bool, Key("Of a fixed joint, whether a robot stands there, which no drawing states.")
    ] = False

    def __post_init__(self) -> None:
        if (self.joint is None) == (self.row is None):
            raise InputError(
                f"the body {self.name!r} is tied to its parent by "
                f"{'nothing' if self.joint is None else 'a joint and a row'}",
                code="conflicting-keys",
                remedy="give it a joint, or a row",
            )

    @property
    def steps(self) -> tuple[Step, ...]:
        """T_parent_body as elementary steps."""
        if self.row is None:
            return tuple(self.joint.steps()) if self.joint else ()
        steps = joint_steps(self.row, self.name)
        return tuple(replace(step, joint=None) for step in steps) if self.fixed else tuple(steps)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Its parameters, those of a joint at their nominal values, those of a row at 0."""
        if self.joint is not None:
            name = self.joint.name if self.standing else ""
            return {p.name: p.of("placement", name) if name else p for p in self.joint.origin}
        if self.fixed:
            return axis_parameters(self.name, self.steps)
        return chain_parameters(self.steps)


def tree_machine(
    bodies: Sequence[Hanging],
    *,
    root: str,
    name: str = NAME,
    masses: Sequence[Load] = (),
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
        description=stated,
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


# Cut one limb out of a robot that has several, as an arm.


def limb(mechanism: Mechanism, body: str) -> Mechanism:
    """The joints from the root to a body, and the instruments on the ground that look at it.

    What measures between limbs is left out; all parameters stay. Raises InputError for a machine
    that is no tree, and for what is none of its bodies.
    """
    tree = mechanism.tree
    if tree is None:
        raise InputError(
            f"{mechanism.name!r} has no limbs", code="unsupported", remedy="leave limb out"
        )
    on, root = tree.between(body, None)
    links = {name: tree.links[name] for name in tree.ancestry(on)}
    families = tuple(f for f in mechanism.families if (f.on, f.against) == (on, root))
    readings = {q for f in families for q in f.readings}
    loops = {loop for f in families for loop in f.loops}
    kept = [i for i, loop in enumerate(mechanism.tape.loops) if loop in loops]
    arm = replace(
        mechanism,
        tree=Tree(links, root),
        families=families,
        outputs=tuple(q for q in mechanism.outputs if q in readings),
    )
    return arm.with_tape(lambda tape: tape.only(kept))
