"""A tape rewritten, operation by operation, into what an engine runs faster: the same values.

Plane rotations are written out once derivatives are taken; cos and sin of one angle come from
one tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from loopcal.expressions.graph import LEAVES, Graph, Node, Step
from loopcal.expressions.tape import Tape, moved
from loopcal.expressions.trace import Scalar

Rule = Callable[..., Node]
"""Makes the node that stands for an operation, from a graph, the name and its nodes."""


def rewritten(operations: Iterable[Step], rules: Mapping[str, Rule]) -> tuple[Graph, list[Node]]:
    """A new graph of the operations, where each is in it, some made by a rule of their name."""
    graph = Graph()
    apply = graph.apply
    place: list[Node] = []
    for name, payload in operations:
        if name in LEAVES:
            place.append(graph.leaf(name, payload[0]))
        elif name in rules:
            place.append(rules[name](graph, name, *[place[a] for a in payload]))
        elif len(payload) == 2:  # nine of ten
            a, b = payload
            place.append(apply(name, place[a], place[b]))
        else:
            place.append(apply(name, *[place[a] for a in payload]))
    return graph, place


TURNS_WRITTEN_OUT: Mapping[str, Rule] = dict.fromkeys(("turn_cos", "turn_sin"), Graph.lower_turn)
"""The rules that write a plane rotation with cos and sin."""


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
    paired = {a for a in cosines & sines if varies[a]}
    named = [
        (f"{name} of half" if name in ("cos", "sin") and payload[0] in paired else name, payload)
        for name, payload in tape.operations
    ]
    graph, place = rewritten(named, dict.fromkeys(("cos of half", "sin of half"), _from_tangent))
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
    stage = [len(ends)] * len(tape.operations)
    for number, end in reversed(list(enumerate(ends))):
        for output in tape.outputs[:end]:
            stage[output] = number
    for position in range(len(stage) - 1, -1, -1):  # arguments stand before what they make
        name, payload = tape.operations[position]
        number = stage[position]
        if name not in LEAVES:
            for a in payload:
                if stage[a] > number:
                    stage[a] = number
    used = sorted((i for i, s in enumerate(stage) if s < len(ends)), key=stage.__getitem__)
    order = [-1] * len(stage)
    for i, position in enumerate(used):
        order[position] = i
    operations = tuple([moved(tape.operations[position], order) for position in used])
    return replace(tape, operations=operations, outputs=tuple([order[o] for o in tape.outputs]))


def _from_tangent(graph: Graph, name: str, angle: Node) -> Node:
    t = graph.apply("tan", graph.apply("mul", graph.constant(0.5), angle))
    square = graph.apply("add", graph.constant(1.0), graph.apply("square", t))
    q = graph.apply("div", graph.constant(2.0), square)
    if name.startswith("sin"):
        return graph.apply("mul", t, q)
    return graph.apply("sub", q, graph.constant(1.0))


def varying(operations: Iterable[Step]) -> tuple[bool, ...]:
    """For each operation, whether its value varies from pose to pose."""
    varies: list[bool] = []
    for name, payload in operations:
        if name in LEAVES:
            varies.append(name in ("quantity", "known"))
        else:
            for a in payload:
                if varies[a]:
                    varies.append(True)
                    break
            else:
                varies.append(False)
    return tuple(varies)


# A tape whose inputs mean something else: each is replaced by an expression of the inputs.

Named = Mapping[str, Any]


def substituted(
    tape: Tape,
    meaning: Callable[[Named, Named], tuple[Named, Named]],
    *,
    pose_constants: Sequence[str] = (),
    parameters: Sequence[str] = (),
    without: Sequence[str] = (),
    loops: Callable[[Named, Named, Named], Named] = lambda f, x, p: f,
) -> Tape:
    """The loops f(x', p') with x', p' made of x and p; the rest of the tape stays as it is.

    meaning(x, p): what stands in the place of quantities and of parameters, by name; those that
    it does not name stay themselves. x has the quantities and known constants, p the parameters;
    pose_constants, parameters: further ones that these expressions need; without: parameters that
    expressions stand in place of everywhere, and which are gone; loops(f, x, p): what stands in the
    place of the loops f(x', p'), by name.
    """
    graph = Graph()
    names = {
        "quantity": tape.quantities,
        "known": (*tape.pose_constants, *pose_constants),
        "parameter": (*tape.parameters, *parameters),
    }
    kept = names | {"parameter": [n for n in names["parameter"] if n not in set(without)]}
    inputs = {
        kind: {name: Scalar(graph, graph.leaf(kind, i)) for i, name in enumerate(input_names)}
        for kind, input_names in kept.items()
    }
    of_x, of_p = meaning(inputs["quantity"] | inputs["known"], inputs["parameter"])
    stated = {"quantity": of_x, "known": {}, "parameter": of_p}

    def leaf(kind: str, payload: Any) -> Node:
        if kind == "constant":
            return graph.constant(payload)
        name = names[kind][payload]
        value = stated[kind][name] if name in stated[kind] else inputs[kind][name]
        return value.node if isinstance(value, Scalar) else graph.constant(float(value))

    place: list[Node] = []
    for name, payload in tape.operations:
        if name in LEAVES:
            place.append(leaf(name, payload[0]))
        else:
            place.append(graph.apply(name, *[place[a] for a in payload]))
    values = {n: Scalar(graph, place[i]) for n, i in zip(tape.loops, tape.outputs, strict=True)}
    values |= loops(values, inputs["quantity"] | inputs["known"], inputs["parameter"])
    return Tape.from_graph(
        graph,
        [values[name].node for name in tape.loops],
        quantities=tape.quantities,
        pose_constants=kept["known"],
        parameters=kept["parameter"],
        loops=tape.loops,
    )
