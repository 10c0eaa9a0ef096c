"""A loop as data: a flat list of elementary operations that ends in the loop equations.

A tape is a value: frozen, compared by its contents, printed readably.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any
from weakref import WeakValueDictionary

from loopcal.expressions.graph import LEAVES, OPERATIONS, Graph, Node, Step
from loopcal.lazy import cached_property

_PREFIX = {"quantity": "x", "known": "x", "parameter": "p"}


@dataclass(frozen=True)
class Tape:
    """f(x, p) as operations in order of evaluation.

    operations[i] is (name, arguments): positions of earlier operations, or for a leaf the value
    of a constant or the position among quantities, known constants or parameters. outputs are
    the positions of the loop equations, one for each name in loops.
    """

    quantities: tuple[str, ...]
    pose_constants: tuple[str, ...]
    parameters: tuple[str, ...]
    loops: tuple[str, ...]
    operations: tuple[Step, ...]
    outputs: tuple[int, ...]

    @classmethod
    def from_graph(
        cls,
        graph: Graph,
        outputs: Sequence[Node],
        *,
        quantities: Sequence[str],
        parameters: Sequence[str],
        loops: Sequence[str],
        pose_constants: Sequence[str] = (),
    ) -> Tape:
        """The part of a graph that its outputs need, renumbered."""
        return cls._made_of(
            graph.operations,
            outputs,
            quantities=quantities,
            pose_constants=pose_constants,
            parameters=parameters,
            loops=loops,
        )

    @classmethod
    def _made_of(
        cls,
        everything: Sequence[Step],
        outputs: Sequence[Node],
        *,
        quantities: Sequence[str],
        pose_constants: Sequence[str],
        parameters: Sequence[str],
        loops: Sequence[str],
    ) -> Tape:
        """The tape of these operations; of equal tapes always the same one.

        A tape is the key of all that is made of it, and equal ones are compared operation by
        operation.
        """
        # Positions stay in order, so arguments stand before what they make without sorting.
        needed = _reachable(everything, outputs)
        place = [-1] * len(everything)
        for position, node in enumerate(needed):
            place[node] = position
        operations = tuple([moved(everything[node], place) for node in needed])
        tape = cls(
            tuple(quantities),
            tuple(pose_constants),
            tuple(parameters),
            tuple(loops),
            operations,
            tuple(place[node] for node in outputs),
        )
        present = _PRESENT.setdefault(hash(tape), tape)
        return present if present == tape else tape

    def __hash__(self) -> int:
        # The operations are compared but not hashed: thousands of them, seldom alike otherwise.
        return hash((self.quantities, self.parameters, self.loops, self.outputs))

    def depends_on(self, kind: str = "") -> tuple[frozenset[str], ...]:
        """For each loop equation, the names of all inputs it contains.

        kind: "quantity", "known" or "parameter" for these alone; one name may be of two kinds.
        """
        return self._inputs[kind]

    @cached_property
    def _inputs(self) -> dict[str, tuple[frozenset[str], ...]]:
        # A bit for each input: a node contains what is set in any of its arguments.
        bits: dict[tuple[str, str], int] = {}
        masks: list[int] = []
        for name, payload in self.operations:
            mask = 0
            if name not in LEAVES:
                for argument in payload:
                    mask |= masks[argument]
            elif name != "constant":
                mask = bits.setdefault((name, self._input(name, payload)), 1 << len(bits))
            masks.append(mask)
        of_loops = [
            [leaf for leaf, bit in bits.items() if masks[output] & bit] for output in self.outputs
        ]
        return {
            kind: tuple(frozenset(n for of, n in some if kind in ("", of)) for some in of_loops)
            for kind in ("", *_PREFIX)
        }

    def only(self, loops: Sequence[int]) -> Tape:
        """The tape of some of the loop equations, by position, with all inputs in their places."""
        return _only(self, tuple(loops))

    def _input(self, kind: str, payload: tuple[Any, ...]) -> str:
        table = {
            "quantity": self.quantities,
            "known": self.pose_constants,
            "parameter": self.parameters,
        }
        text: str = table[kind][payload[0]]
        return text

    def __str__(self) -> str:
        uses = [0] * len(self.operations)
        for name, payload in self.operations:
            if name not in LEAVES:
                for argument in payload:
                    uses[argument] += 1
        lines: list[str] = []
        texts: list[tuple[str, int]] = []  # with how tightly each binds
        for position, (name, payload) in enumerate(self.operations):
            text, binding = self._text(name, payload, texts)
            if name not in LEAVES and uses[position] > 1:
                shared = f"t{len(lines) + 1}"
                lines.append(f"{shared} = {text}")
                text, binding = shared, _ATOM
            texts.append((text, binding))
        lines += [
            f"{loop}: {texts[output][0]} = 0"
            for loop, output in zip(self.loops, self.outputs, strict=True)
        ]
        return "\n".join(lines)

    def _text(
        self, name: str, payload: tuple[Any, ...], texts: Sequence[tuple[str, int]]
    ) -> tuple[str, int]:
        if name == "constant":
            return f"{payload[0]!r}", _ATOM if payload[0] >= 0 else 1
        if name in LEAVES:
            return f"{_PREFIX[name]}.{self._input(name, payload)}", _ATOM
        operation = OPERATIONS[name]
        written = []
        for place, argument in enumerate(payload):
            text, binding = texts[argument]
            # a - (b - c) and (a ** b) ** c need their brackets, a + b + c and functions do not
            tighter = operation.binding + (place in _BRACKETS.get(name, ()))
            inside_function = operation.binding == _ATOM
            written.append(text if inside_function or binding >= tighter else f"({text})")
        return operation.text.format(*written), operation.binding


_PRESENT: WeakValueDictionary[int, Tape] = WeakValueDictionary()
"""Tapes that are in use, by hash."""


@lru_cache(maxsize=64)
def _only(tape: Tape, loops: tuple[int, ...]) -> Tape:
    if loops == tuple(range(len(tape.loops))):
        return tape
    return tape._made_of(
        tape.operations,
        [tape.outputs[i] for i in loops],
        quantities=tape.quantities,
        pose_constants=tape.pose_constants,
        parameters=tape.parameters,
        loops=[tape.loops[i] for i in loops],
    )


_ATOM = 4
_BRACKETS = {"sub": (1,), "div": (1,), "neg": (0,), "pow": (0, 1)}
"""Which arguments are bracketed also where they bind as tightly as the operation itself."""


def moved(step: Step, place: Sequence[Node] | dict[Node, Node]) -> Step:
    """The step where its arguments stand elsewhere."""
    name, payload = step
    if name in LEAVES:
        return step
    if len(payload) == 2:  # nine of ten
        a, b = payload
        return name, (place[a], place[b])
    return name, tuple([place[a] for a in payload])


def _reachable(operations: Sequence[Step], outputs: Sequence[Node]) -> list[Node]:
    needed = bytearray(len(operations))
    for node in outputs:
        needed[node] = True
    for node in range(max(outputs, default=-1), -1, -1):  # arguments stand before what they make
        if needed[node]:
            name, payload = operations[node]
            if name not in LEAVES:
                for argument in payload:
                    needed[argument] = True
    return [node for node, wanted in enumerate(needed) if wanted]
