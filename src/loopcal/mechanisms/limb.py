"""Cut one limb out of a robot that has several, as an arm."""

from __future__ import annotations

from dataclasses import replace

from loopcal.errors import InputError
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.tree import Tree


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
