"""What no sensor is to blame for: a disturbance of the machine model, as a quantity of its own.

A machine bends, its gears are not round. Such errors belong to the model, not to an encoder. They
enter as further quantities, read as zero in every pose with an sd. So the same estimation weighs,
corrects and learns them: the end point reached is the modelled one plus this
disturbance, isotropic where its coordinates share one sd. A mechanism without outputs gets one
disturbance for each loop equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from loopcal.errors import InputError
from loopcal.expressions.graph import LEAVES, Graph, Node
from loopcal.expressions.tape import Tape
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.quantity import Quantity


def disturbances(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of the disturbances that the mechanism has, or would be given: model_OUTPUT."""
    if mechanism.disturbances:
        return mechanism.disturbances
    taken = {*mechanism.quantities, *mechanism.pose_constants}
    names = [f"model_{name}" for name in (mechanism.outputs or mechanism.tape.loops)]
    while not taken.isdisjoint(names):
        names = [f"{name}_" for name in names]
    return tuple(names)


def with_model_error(mechanism: Mechanism) -> Mechanism:
    """The mechanism with a disturbance of each output, or of each loop equation without outputs.

    Its units are those of the outputs; a loop's own disturbance is a plain number in the unit of
    the loop. Their readings are zero in every pose. Raises InputError where outputs differ in unit.
    """
    if mechanism.disturbances:
        return mechanism
    names = disturbances(mechanism)
    units = {mechanism.quantities[q] for q in mechanism.outputs}
    if len(units) > 1:
        both = " and ".join(sorted(units))
        raise InputError(
            f"a model error is one sd for all outputs, but these are in {both}",
            code="wrong-unit",
            remedy="read points in x, y, z with the instrument's covariance, or leave it out",
        )
    changed = mechanism.with_tape(lambda tape: _disturbed(tape, mechanism.outputs, names))
    output_units = [mechanism.quantities[name] for name in mechanism.outputs] or ["1"] * len(names)
    added = [Quantity(n, u, "disturbance") for n, u in zip(names, output_units, strict=True)]
    return replace(changed, variables=(*mechanism.variables, *added))


def _disturbed(tape: Tape, outputs: Sequence[str], names: Sequence[str]) -> Tape:
    """The loops with these disturbances of the outputs, or of each loop without outputs."""
    graph = Graph()
    offset = len(tape.quantities)
    read = {tape.quantities.index(name): i for i, name in enumerate(outputs)}
    place: list[Node] = []
    for name, payload in tape.operations:
        if name not in LEAVES:
            place.append(graph.apply(name, *(place[int(a)] for a in payload)))
            continue
        node = graph.leaf(name, payload[0])
        if name == "quantity" and int(payload[0]) in read:
            # y - v in place of y: where the loop closes, the modelled output plus v is the one that
            # is read.
            disturbance = graph.leaf("quantity", offset + read[int(payload[0])])
            node = graph.apply("sub", node, disturbance)
        place.append(node)
    loops = [place[output] for output in tape.outputs]
    if not outputs:
        loops = [
            graph.apply("add", loop, graph.leaf("quantity", offset + i))
            for i, loop in enumerate(loops)
        ]
    return Tape.from_graph(
        graph,
        loops,
        quantities=[*tape.quantities, *names],
        pose_constants=tape.pose_constants,
        parameters=tape.parameters,
        loops=tape.loops,
    )
