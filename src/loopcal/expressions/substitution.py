"""A tape whose inputs mean something else: each is replaced by an expression of the inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from loopcal.expressions.graph import Graph, Node
from loopcal.expressions.operations import LEAVES
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import Scalar

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

    def leaf(kind: str, payload: float) -> Node:
        if kind == "constant":
            return graph.constant(payload)
        name = names[kind][int(payload)]
        value = stated[kind][name] if name in stated[kind] else inputs[kind][name]
        return value.node if isinstance(value, Scalar) else graph.constant(float(value))

    place: list[Node] = []
    for name, payload in tape.operations:
        if name in LEAVES:
            place.append(leaf(name, payload[0]))
        else:
            place.append(graph.apply(name, *(place[int(a)] for a in payload)))
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
