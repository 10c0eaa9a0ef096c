"""First derivatives of a tape, as a tape: reverse mode, one sweep per loop equation.

The adjoints are built in the graph of the tape itself. So they share subexpressions with the loops
and with each other, and vanish where a derivative is zero. They need no second evaluator: an engine
that can run a tape can run its Jacobian.

Source of the method: Griewank and Walther, Evaluating Derivatives, 2nd ed. (2008), chapter 3.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush

from loopcal.expressions.graph import LEAVES, Graph, Node
from loopcal.expressions.rewriting import TURNS_WRITTEN_OUT, rewritten
from loopcal.expressions.tape import Tape


@dataclass(frozen=True)
class Linearisation:
    """A tape with the loop values f and their partial derivatives as outputs.

    The outputs stand in this order: f (m); then for each chosen quantity its m derivatives;
    then for each chosen parameter its m derivatives.
    """

    tape: Tape
    loops: int
    quantities: tuple[str, ...]
    parameters: tuple[str, ...]


def linearise(tape: Tape, quantities: Iterable[str], parameters: Iterable[str]) -> Linearisation:
    """f, df/dx for the named quantities and df/dp for the named parameters, as one tape."""
    return _linearised(tape, tuple(quantities), tuple(parameters))


@lru_cache(maxsize=64)
def _linearised(
    tape: Tape, quantities: tuple[str, ...], parameters: tuple[str, ...]
) -> Linearisation:
    graph, loops = Graph(tape.operations), tape.outputs
    inputs = [graph.leaf("quantity", tape.quantities.index(q)) for q in quantities]
    inputs += [graph.leaf("parameter", tape.parameters.index(p)) for p in parameters]
    # Adjoints are symbolic nodes, so the loops of one tape share what they have in common.
    useful = _leading_to(graph, inputs)
    gradients = [_reverse(graph, loop, inputs, useful) for loop in loops]
    outputs = [*loops, *(gradient[i] for i in range(len(inputs)) for gradient in gradients)]
    lowered, place = rewritten(graph.operations, TURNS_WRITTEN_OUT)
    names = [str(i) for i in range(len(outputs))]
    return Linearisation(
        Tape.from_graph(
            lowered,
            [place[output] for output in outputs],
            quantities=tape.quantities,
            pose_constants=tape.pose_constants,
            parameters=tape.parameters,
            loops=names,
        ),
        len(loops),
        quantities,
        parameters,
    )


@lru_cache(maxsize=64)
def lagrangian_gradient(tape: Tape) -> Tape:
    """The gradient by all quantities of sum_r lambda_r f_r, with lambda_r as known constants.

    Its outputs are the k derivatives; its known constants those of the tape, then one multiplier
    per loop. Linearised once more, it gives the second derivatives of the loops.
    """
    graph = Graph(tape.operations)
    total = graph.constant(0.0)
    for i, output in enumerate(tape.outputs):
        multiplier = graph.leaf("known", len(tape.pose_constants) + i)
        total = graph.apply("add", total, graph.apply("mul", multiplier, output))
    inputs = [graph.leaf("quantity", i) for i in range(len(tape.quantities))]
    return Tape.from_graph(
        graph,
        _reverse(graph, total, inputs, _leading_to(graph, inputs)),
        quantities=tape.quantities,
        pose_constants=[*tape.pose_constants, *(f"lambda {loop}" for loop in tape.loops)],
        parameters=tape.parameters,
        loops=[f"d/d {quantity}" for quantity in tape.quantities],
    )


def _reverse(
    graph: Graph, output: Node, inputs: Sequence[Node], useful: Collection[Node]
) -> list[Node]:
    """d output / d input for every input: one reverse sweep over what the output needs.

    useful: the nodes whose value depends on an input.
    """
    operations, apply = graph.operations, graph.apply
    adjoint: dict[Node, Node] = {output: graph.constant(1.0)}
    # The last first. Of a tape with hundreds of loops, as of an image, each needs a small part.
    waiting = [-output]
    while waiting:
        node = -heappop(waiting)
        name, arguments = operations[node]
        if name in LEAVES:
            continue
        bar = adjoint[node]
        for position, argument in enumerate(arguments):
            if argument not in useful:
                continue
            if name == "add":
                term = bar
            elif name == "mul":
                term = apply("mul", bar, arguments[1 - position])
            else:
                term = _chain(graph, name, position, arguments, node, bar)
            before = adjoint.get(argument)
            if before is None:
                adjoint[argument] = term
                heappush(waiting, -argument)
            else:
                adjoint[argument] = apply("add", before, term)
    zero = graph.constant(0.0)
    return [adjoint.get(node, zero) for node in inputs]


def _leading_to(graph: Graph, inputs: Sequence[Node]) -> set[Node]:
    """The nodes whose value depends on an input: no other adjoint is needed."""
    useful = set(inputs)
    for node, (name, payload) in enumerate(graph.operations):
        if name not in LEAVES and not useful.isdisjoint(payload):
            useful.add(node)
    return useful


def _chain(
    graph: Graph, name: str, position: int, arguments: tuple[Node, ...], node: Node, bar: Node
) -> Node:
    """bar * d node / d argument[position], of all but sums and products."""
    apply, constant = graph.apply, graph.constant
    a = arguments[0]
    match name, position:
        case ("sub", 0):
            return bar
        case ("sub", 1) | ("neg", 0):
            return apply("neg", bar)
        case ("div", 0):
            return apply("div", bar, arguments[1])
        # d(a/b)/db = -(a/b)/b: the quotient is a node already.
        case ("div", 1):
            return apply("neg", apply("mul", bar, apply("div", node, arguments[1])))
        case ("pow", 0):
            lower = apply("pow", a, apply("sub", arguments[1], constant(1.0)))
            return apply("mul", bar, apply("mul", arguments[1], lower))
        case ("pow", 1):
            return apply("mul", bar, apply("mul", node, apply("log", a)))
        case ("turn_cos" | "turn_sin", _):
            return _chain_turn(graph, name, position, arguments, bar)
        case ("arctan2" | "hypot", _):
            return _chain_polar(graph, name, position, arguments, node, bar)
        case (("arcsin" | "arccos" | "arctan"), 0):
            return _chain_arc(graph, name, a, bar)
        case ("square", 0):
            return apply("mul", bar, apply("mul", constant(2.0), a))
        case ("sqrt", 0):
            return apply("div", apply("mul", constant(0.5), bar), node)
        case ("sin", 0):
            return apply("mul", bar, apply("cos", a))
        case ("cos", 0):
            return apply("neg", apply("mul", bar, apply("sin", a)))
        case ("tan", 0):
            return apply("mul", bar, apply("add", constant(1.0), apply("square", node)))
        case ("exp", 0):
            return apply("mul", bar, node)
        case ("log", 0):
            return apply("div", bar, a)
        case ("abs", 0):
            return apply("mul", bar, apply("sign", a))
    return constant(0.0)  # sign is flat


def _chain_arc(graph: Graph, name: str, a: Node, bar: Node) -> Node:
    apply, one = graph.apply, graph.constant(1.0)
    if name == "arctan":
        return apply("div", bar, apply("add", one, apply("square", a)))
    # (1 - a)(1 + a) keeps its digits near |a| = 1, where 1 - a^2 loses them
    product = apply("mul", apply("sub", one, a), apply("add", one, a))
    slope = apply("div", bar, apply("sqrt", product))
    return slope if name == "arcsin" else apply("neg", slope)


def _chain_polar(
    graph: Graph, name: str, position: int, arguments: tuple[Node, ...], node: Node, bar: Node
) -> Node:
    apply = graph.apply
    if name == "hypot":
        return apply("mul", bar, apply("div", arguments[position], node))
    # d arctan2(s, c) = (c ds - s dc) / r^2; divided by r twice, because r^2 may overflow.
    radius = apply("hypot", *arguments)
    other = apply("div", apply("div", arguments[1 - position], radius), radius)
    term = apply("mul", bar, other)
    return term if position == 0 else apply("neg", term)


def _chain_turn(
    graph: Graph, name: str, position: int, arguments: tuple[Node, ...], bar: Node
) -> Node:
    apply, angle = graph.apply, arguments[2]
    if position == 2:
        other = apply("turn_sin" if name == "turn_cos" else "turn_cos", *arguments)
        term = apply("mul", bar, other)
        return apply("neg", term) if name == "turn_cos" else term
    cosine_first = (name == "turn_cos") == (position == 0)
    term = apply("mul", bar, apply("cos" if cosine_first else "sin", angle))
    return apply("neg", term) if name == "turn_cos" and position == 1 else term
