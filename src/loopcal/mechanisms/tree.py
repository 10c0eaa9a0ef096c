"""Trees of bodies: each hangs on its parent by elementary steps, and the root on nothing.

A chain is a tree with one leaf. What stands between two bodies A and B are the joints of the path
from one to the other alone. With c the body at which the ways from the root to A and to B part,

    T_A_B = T_c_A^-1 T_c_B,

so that joints above c drop out exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loopcal.errors import InputError, listed, unknown_name
from loopcal.mechanisms.chain import Step

BASE, BODY = "base", "body"
"""What root and leaf of a chain are called, where nothing else names them."""


@dataclass(frozen=True)
class Link:
    """A body of a tree: the one on which it hangs, and the steps from that one's frame to its."""

    parent: str
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Tree:
    """Bodies by name, parents ahead of what hangs on them; the root is not among them."""

    links: Mapping[str, Link]
    root: str = BASE

    @classmethod
    def chain(cls, steps: Sequence[Step]) -> Tree:
        """The tree with one leaf."""
        return cls({BODY: Link(BASE, tuple(steps))})

    @property
    def leaves(self) -> tuple[str, ...]:
        """The bodies on which nothing hangs."""
        parents = {link.parent for link in self.links.values()}
        return tuple(name for name in self.links if name not in parents)

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of all bodies, each once."""
        return tuple(step for link in self.links.values() for step in link.steps)

    @property
    def serial(self) -> tuple[Step, ...]:
        """The steps from the root to the only leaf; none where there are several."""
        return self.path() if len(self.leaves) == 1 else ()

    @property
    def joints(self) -> dict[str, str]:
        """The SI units of the readings that move its bodies."""
        return {step.joint: step.unit for step in self.steps if step.joint}

    def between(self, on: str | None, against: str | None) -> tuple[str, str]:
        """The names of two bodies: by default the only leaf, and the root.

        Raises InputError for what is no body, or one body twice, or where several leaves are.
        """
        leaves = self.leaves
        if on is None and len(leaves) != 1:
            raise InputError(
                f"several bodies could be meant: {listed(leaves)}",
                code="missing-key",
                remedy=f'name the body that is looked at: on = "{leaves[0]}"',
            )
        pair = (leaves[0] if on is None else on, self.root if against is None else against)
        for name in pair:
            if name != self.root and name not in self.links:
                bodies = (self.root, *self.links)
                raise unknown_name(f"the machine has no body {name!r}", name, bodies)
        if pair[0] == pair[1]:
            raise InputError(
                f"the body {pair[0]!r} would be looked at from itself",
                code="conflicting-keys",
                remedy="name two bodies with joints between them, as on and against",
            )
        return pair

    def ways(self, on: str, against: str) -> tuple[tuple[Step, ...], tuple[Step, ...]]:
        """The steps from the body at which their ways part to each of the two."""
        to, fro = self.ancestry(on), self.ancestry(against)
        shared = sum(a == b for a, b in zip(to, fro, strict=False))
        return self._down(to[shared:]), self._down(fro[shared:])

    def path(self, on: str | None = None, against: str | None = None) -> tuple[Step, ...]:
        """T_against_on as steps. Raises InputError as `between` does."""
        to, fro = self.ways(*self.between(on, against))
        return (*(step.inverse() for step in reversed(fro)), *to)

    def ancestry(self, body: str) -> list[str]:
        """The bodies from the root, which is left out, to this one."""
        names: list[str] = []
        while body != self.root:
            names.append(body)
            body = self.links[body].parent
        return names[::-1]

    def _down(self, names: Sequence[str]) -> tuple[Step, ...]:
        return tuple(step for name in names for step in self.links[name].steps)
