"""A loop as data: a flat list of elementary operations that ends in the loop equations.

A tape is a value: frozen, compared by its contents, printed readably, written to and read from
plain JSON data, so that a mechanism can travel in a file without any code being run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import index
from typing import Any

from loopcal.errors import InputError, nearest
from loopcal.expressions.graph import Graph, Node
from loopcal.expressions.operations import LEAVES, OPERATIONS
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
    known: tuple[str, ...]
    parameters: tuple[str, ...]
    loops: tuple[str, ...]
    operations: tuple[tuple[str, tuple[float, ...]], ...]
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
        known: Sequence[str] = (),
    ) -> Tape:
        """The part of a graph that its outputs need, renumbered."""
        return cls._made_of(
            graph.operations,
            outputs,
            quantities=quantities,
            known=known,
            parameters=parameters,
            loops=loops,
        )

    @classmethod
    def _made_of(
        cls,
        everything: Sequence[tuple[str, tuple[float, ...]]],
        outputs: Sequence[Node],
        *,
        quantities: Sequence[str],
        known: Sequence[str],
        parameters: Sequence[str],
        loops: Sequence[str],
    ) -> Tape:
        needed = _reachable(everything, outputs)
        place = {node: position for position, node in enumerate(needed)}
        operations = tuple(
            [
                (name, payload if name in LEAVES else tuple([place[int(a)] for a in payload]))
                for name, payload in [everything[node] for node in needed]
            ]
        )
        return cls(
            tuple(quantities),
            tuple(known),
            tuple(parameters),
            tuple(loops),
            operations,
            tuple(place[node] for node in outputs),
        )

    def __hash__(self) -> int:
        # The operations are compared but not hashed: thousands of them, seldom alike otherwise.
        return hash((self.quantities, self.parameters, self.loops, self.outputs))

    def depends_on(self) -> tuple[frozenset[str], ...]:
        """For each loop equation, the names of all inputs it contains."""
        return self._inputs_of_loops

    @cached_property
    def _inputs_of_loops(self) -> tuple[frozenset[str], ...]:
        names: list[frozenset[str]] = []
        for name, payload in self.operations:
            if name in LEAVES:
                own = () if name == "constant" else (self._input(name, payload),)
                names.append(frozenset(own))
            else:
                names.append(frozenset().union(*(names[int(a)] for a in payload)))
        return tuple(frozenset(names[output]) for output in self.outputs)

    def only(self, loops: Sequence[int]) -> Tape:
        """The tape of some of the loop equations, by position, with all inputs in their places."""
        return self._made_of(
            self.operations,
            [self.outputs[i] for i in loops],
            quantities=self.quantities,
            known=self.known,
            parameters=self.parameters,
            loops=[self.loops[i] for i in loops],
        )

    def needed_by(self, outputs: Sequence[int]) -> list[int]:
        """The positions of all operations that these are made of, and of these, in order."""
        return _reachable(self.operations, outputs)

    def _input(self, kind: str, payload: tuple[float, ...]) -> str:
        table = {"quantity": self.quantities, "known": self.known, "parameter": self.parameters}
        return table[kind][int(payload[0])]

    def __str__(self) -> str:
        uses = [0] * len(self.operations)
        for name, payload in self.operations:
            if name not in LEAVES:
                for argument in payload:
                    uses[int(argument)] += 1
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
        self, name: str, payload: tuple[float, ...], texts: Sequence[tuple[str, int]]
    ) -> tuple[str, int]:
        if name == "constant":
            return f"{payload[0]!r}", _ATOM if payload[0] >= 0 else 1
        if name in LEAVES:
            return f"{_PREFIX[name]}.{self._input(name, payload)}", _ATOM
        operation = OPERATIONS[name]
        written = []
        for place, argument in enumerate(payload):
            text, binding = texts[int(argument)]
            # a - (b - c) and (a ** b) ** c need their brackets, a + b + c and functions do not
            tighter = operation.binding + (place in _BRACKETS.get(name, ()))
            inside_function = operation.binding == _ATOM
            written.append(text if inside_function or binding >= tighter else f"({text})")
        return operation.text.format(*written), operation.binding

    def to_data(self) -> dict[str, Any]:
        """The tape as plain data for JSON; floats survive exactly."""
        return {
            "quantities": list(self.quantities),
            "known": list(self.known),
            "parameters": list(self.parameters),
            "loops": list(self.loops),
            "operations": [[name, *payload] for name, payload in self.operations],
            "outputs": list(self.outputs),
        }

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Tape:
        """The tape written by `to_data`.

        Raises InputError naming the operation that is not one, or refers ahead of itself.
        """
        try:
            tables = [_names(data[key]) for key in _TABLES]
            rows, outputs = list(data["operations"]), [index(o) for o in data["outputs"]]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"this is not a tape: {error!r}", code="wrong-file-type", remedy=_REWRITE
            ) from None
        quantities, known, parameters, loops = tables
        sizes = {
            "quantity": len(quantities),
            "known": len(known),
            "parameter": len(parameters),
        }
        operations = tuple(_checked(i, row, sizes) for i, row in enumerate(rows))
        if len(outputs) != len(loops) or not all(0 <= o < len(operations) for o in outputs):
            raise InputError(
                "the outputs of the tape are not among its operations",
                code="unknown-name",
                remedy=_REWRITE,
            )
        return cls(quantities, known, parameters, loops, operations, tuple(outputs))


_ATOM = 4
_BRACKETS = {"sub": (1,), "div": (1,), "neg": (0,), "pow": (0, 1)}
"""Which arguments are bracketed also where they bind as tightly as the operation itself."""
_TABLES = ("quantities", "known", "parameters", "loops")
_REWRITE = "write it again with Tape.to_data()"


def _names(values: Any) -> tuple[str, ...]:
    if isinstance(values, str) or not all(isinstance(value, str) for value in values):
        raise TypeError(f"{values!r} is not a list of names")
    return tuple(values)


def _checked(position: int, row: Any, sizes: Mapping[str, int]) -> tuple[str, tuple[float, ...]]:
    """One operation of a tape read from outside, or the error that says what is wrong with it."""
    place = f"operation {position}"
    try:
        name, payload = str(row[0]), list(row[1:])
        numbers = tuple(float(v) if name == "constant" else index(v) for v in payload)
    except (TypeError, ValueError, IndexError):
        raise InputError(
            f"{row!r} is not an operation", code="wrong-shape", place=place, remedy=_REWRITE
        ) from None
    if name in sizes or name == "constant":
        valid = len(numbers) == 1 and (
            math.isfinite(numbers[0]) if name == "constant" else 0 <= numbers[0] < sizes[name]
        )
    elif name in OPERATIONS:
        valid = len(numbers) == OPERATIONS[name].arity and all(0 <= n < position for n in numbers)
    else:
        remedy = nearest(name, [*LEAVES, *OPERATIONS])
        raise InputError(
            f"operation {name!r} is not known", code="unknown-name", place=place, remedy=remedy
        )
    if not valid:
        raise InputError(
            f"{row!r} has wrong arguments", code="wrong-shape", place=place, remedy=_REWRITE
        )
    return name, numbers


def _reachable(
    operations: Sequence[tuple[str, tuple[float, ...]]], outputs: Sequence[Node]
) -> list[Node]:
    needed = bytearray(len(operations))
    for node in outputs:
        needed[node] = True
    for node in range(max(outputs, default=-1), -1, -1):  # arguments stand before what they make
        if needed[node]:
            name, payload = operations[node]
            if name not in LEAVES:
                for argument in payload:
                    needed[int(argument)] = True
    return [node for node, wanted in enumerate(needed) if wanted]
