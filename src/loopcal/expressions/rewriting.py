"""A tape rewritten, operation by operation, into what an engine runs faster: the same values.

Plane rotations are written out once derivatives are taken; cos and sin of one angle come from
one tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from loopcal.expressions.graph import Graph, Node
from loopcal.expressions.operations import LEAVES
from loopcal.expressions.tape import Tape

Operation = tuple[str, tuple[float, ...]]
Rule = Callable[[Graph, str, tuple[Node, ...]], Node]
"""Makes the node that stands for an operation on nodes."""


def rewritten(operations: Iterable[Operation], rule: Rule) -> tuple[Graph, list[Node]]:
    """A new graph of the operations as the rule makes them, and where each is in it."""
    graph = Graph()
    place: list[Node] = []
    for name, payload in operations:
        if name in LEAVES:
            place.append(graph.leaf(name, payload[0]))
        else:
            place.append(rule(graph, name, tuple([place[int(a)] for a in payload])))
    return graph, place


def unchanged(graph: Graph, name: str, arguments: tuple[Node, ...]) -> Node:
    """The rule of a plain copy."""
    return graph.apply(name, *arguments)


def turns_written_out(graph: Graph, name: str, arguments: tuple[Node, ...]) -> Node:
    """The rule that writes a plane rotation with cos and sin."""
    if name in ("turn_cos", "turn_sin"):
        return graph.lower_turn(name, *arguments)
    return graph.apply(name, *arguments)


def half_angles(tape: Tape) -> Tape:
    """The same tape, cos and sin of an angle that varies by pose taken from one tangent.

    With t = tan(a/2) and q = 2/(1 + t^2): cos a = q - 1, sin a = t q, both within 2 eps, also
    near a = pi, where t = 1.6e16 gives -1 and 1.2e-16. NumPy has vector code for tan of doubles
    (AVX-512), but takes sin and cos one by one, at six times the cost.
    """
    varies = varying(tape.operations)
    cosines, sines = (
        {payload[0] for name, payload in tape.operations if name == function}
        for function in ("cos", "sin")
    )
    paired = {a for a in cosines & sines if varies[int(a)]}
    named = [
        (f"{name} of half" if name in ("cos", "sin") and payload[0] in paired else name, payload)
        for name, payload in tape.operations
    ]
    graph, place = rewritten(named, _from_tangent)
    return Tape.from_graph(
        graph,
        [place[output] for output in tape.outputs],
        quantities=tape.quantities,
        pose_constants=tape.pose_constants,
        parameters=tape.parameters,
        loops=tape.loops,
    )


def in_stages(tape: Tape, ends: Sequence[int]) -> Tape:
    """The same tape, first all that outputs[:ends[0]] need, then what outputs[:ends[1]] do, ...

    An engine that needs the first outputs alone stops after their last operation.
    """
    order: dict[int, int] = {}
    for end in ends:
        needed = set(tape.needed_by(tape.outputs[:end])) - order.keys()
        order |= {position: len(order) + i for i, position in enumerate(sorted(needed))}
    operations = tuple(
        [
            (name, payload if name in LEAVES else tuple([order[int(a)] for a in payload]))
            for name, payload in [tape.operations[position] for position in order]
        ]
    )
    return replace(tape, operations=operations, outputs=tuple([order[o] for o in tape.outputs]))


def _from_tangent(graph: Graph, name: str, arguments: tuple[Node, ...]) -> Node:
    if not name.endswith(" of half"):
        return graph.apply(name, *arguments)
    t = graph.apply("tan", graph.apply("mul", graph.constant(0.5), arguments[0]))
    square = graph.apply("add", graph.constant(1.0), graph.apply("square", t))
    q = graph.apply("div", graph.constant(2.0), square)
    if name.startswith("sin"):
        return graph.apply("mul", t, q)
    return graph.apply("sub", q, graph.constant(1.0))


def varying(operations: Iterable[Operation]) -> tuple[bool, ...]:
    """For each operation, whether its value varies from pose to pose."""
    varies: list[bool] = []
    for name, payload in operations:
        if name in LEAVES:
            varies.append(name in ("quantity", "known"))
        else:
            for a in payload:
                if varies[int(a)]:
                    varies.append(True)
                    break
            else:
                varies.append(False)
    return tuple(varies)
