"""Finds out which operation of which loop met a value outside its domain, and in which pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol

from loopcal.arrays import Array
from loopcal.errors import DomainError
from loopcal.expressions.derivative import Linearisation, linearise
from loopcal.expressions.graph import LEAVES, OPERATIONS, evaluate_scalar
from loopcal.expressions.tape import Tape


def explain_domain(
    tape: Tape,
    x: Array,
    pose_constants: Array,
    parameters: Array,
    poses: Sequence[str],
    remedies: Mapping[str, str] | None = None,
) -> DomainError:
    """The error that names loop, pose and operation.

    x: (k, N), pose_constants: (c, N), parameters: (n_all,) [SI]; remedies: what to do where a loop
    cannot be evaluated, for loops that know.
    """
    for part, looked_at in (("", tape), ("the derivative of ", _with_derivatives(tape))):
        for column, pose in enumerate(poses):
            undefined = _first_undefined(
                looked_at, x[:, column], pose_constants[:, column], parameters
            )
            if undefined is not None:
                loop, text = undefined
                return DomainError(
                    f"{text} in {part}loop equation {loop!r} at pose {pose!r}",
                    remedy=(remedies or {}).get(loop)
                    or "check the readings and units of this pose, and the nominal "
                    "parameters; exclude the pose (data.exclude) if its reading is wrong",
                )
    return DomainError(
        "the loop equations overflow: some value is not finite",
        remedy="check units and nominal parameters",
    )


def _with_derivatives(tape: Tape) -> Tape:
    """The linearised tape, each output named by the loop equation it belongs to."""
    linearised = linearise(tape, tape.quantities, tape.parameters).tape
    m = len(tape.loops)
    return replace(
        linearised, loops=tuple(tape.loops[i % m] for i in range(len(linearised.outputs)))
    )


def _first_undefined(
    tape: Tape, x: Array, pose_constants: Array, p: Array
) -> tuple[str, str] | None:
    inputs = {"quantity": x, "known": pose_constants, "parameter": p}
    values: list[float] = []
    for position, (name, payload) in enumerate(tape.operations):
        if name in LEAVES:
            value = payload[0] if name == "constant" else float(inputs[name][payload[0]])
            values.append(value)
            continue
        arguments = [values[a] for a in payload]
        why = OPERATIONS[name].undefined(*arguments)
        value = evaluate_scalar(name, *arguments)
        if why is None and not math.isfinite(value):
            why = f"of {', '.join(f'{a:.6g}' for a in arguments)} is not finite"
        if why is not None:
            symbol = {"div": "division", "pow": "power"}.get(name, name)
            return tape.loops[_loop_with(tape, position)], f"{symbol} {why}"
        values.append(value)
    return None


def _loop_with(tape: Tape, wanted: int) -> int:
    """The first loop equation that contains an operation."""
    for loop, output in enumerate(tape.outputs):
        stack, seen = [output], set()
        while stack:
            node = stack.pop()
            if node == wanted:
                return loop
            if node in seen:
                continue
            seen.add(node)
            name, payload = tape.operations[node]
            if name not in LEAVES:
                stack.extend(payload)
    return 0


# What an engine is: it runs a linearised tape over blocks of poses.


@dataclass(frozen=True)
class LoopValues:
    """The loops of a block of b poses, linearised. The arrays are overwritten by the next block.

    f: (m, b) loop values [unit of each loop]; by_quantity: (k, m, b) partial derivatives by the
    chosen quantities; by_parameter: (n, m, b) by the chosen parameters.
    """

    f: Array
    by_quantity: Array
    by_parameter: Array


class Stage(IntEnum):
    """How far a tape is run: loop values alone, derivatives by quantities too, or all."""

    VALUES = 0
    BY_QUANTITY = 1
    BY_PARAMETER = 2


class Engine(Protocol):
    """Evaluates one linearised tape over blocks of at most `size` poses.

    One engine belongs to one thread: its registers are its own.
    """

    size: int

    def evaluate(
        self,
        p: Array,
        x: Array,
        pose_constants: Array | None = None,
        stage: Stage = Stage.BY_PARAMETER,
    ) -> LoopValues:
        """f(x, p) and its derivatives; b <= size.

        p: (n_all,) in the order of the tape [SI]; x: (k_all, b) [SI]; known constants: (c, b);
        stage: how far to go; derivatives beyond it are left out, as if none were chosen.

        Values outside an operation's domain come out as NaN or infinity, without a warning:
        the caller knows whether that is a failed trial step or a mistake to report.
        """


def stage_ends(linearisation: Linearisation) -> tuple[int, int, int]:
    """How many outputs there are at the end of each stage."""
    m, k = linearisation.loops, len(linearisation.quantities)
    return m, m + k * m, len(linearisation.tape.outputs)


def arranged(outputs: Array, linearisation: Linearisation, stage: Stage) -> LoopValues:
    """What a stage has of the outputs of a linearised tape, (count, b), by what they are."""
    m, b = linearisation.loops, outputs.shape[1]
    k = len(linearisation.quantities) if stage >= Stage.BY_QUANTITY else 0
    n = len(linearisation.parameters) if stage >= Stage.BY_PARAMETER else 0
    _, end, _ = stage_ends(linearisation)
    by_quantity, by_parameter = outputs[m : m + k * m], outputs[end : end + n * m]
    return LoopValues(outputs[:m], by_quantity.reshape(k, m, b), by_parameter.reshape(n, m, b))
