"""The NumPy engine: runs a linearised tape over a block of poses, structure of arrays.

What depends on parameters alone is evaluated once per set of parameters with plain numbers;
the rest is a list of NumPy calls on arrays of poses, in registers that are reused as soon as
their value is spent, so that a block stays in the processor's cache.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.derivative import Linearisation, linearise
from loopcal.expressions.operations import LEAVES, OPERATIONS, evaluate_scalar
from loopcal.expressions.tape import Tape

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopValues:
    """The loops of a block of b poses, linearised. The arrays are overwritten by the next block.

    f: (m, b) loop values [unit of each loop]; by_quantity: (k, m, b) partial derivatives by the
    chosen quantities; by_parameter: (n, m, b) by the chosen parameters.
    """

    f: Array
    by_quantity: Array
    by_parameter: Array


class NumpyEngine:
    """Evaluates one linearised tape over blocks of at most `size` poses.

    `at(p)` sets the parameters; `evaluate(x, known)` runs a block. One engine belongs to one
    thread: its registers are its own.
    """

    def __init__(self, linearisation: Linearisation, size: int) -> None:
        tape = linearisation.tape
        self.size = size
        self._linearisation = linearisation
        self._operations = tape.operations
        self._stage = _stages(tape)
        self._constants = {
            i: payload[0] for i, (name, payload) in enumerate(tape.operations) if name == "constant"
        }
        self._fixed = np.zeros(len(tape.operations))
        self._inputs = np.zeros((len(tape.quantities) + len(tape.known), size))
        self._quantities = len(tape.quantities)
        self._outputs = np.zeros((len(tape.outputs), size))
        self._first_row, self._copies = _output_rows(tape.outputs)
        self._register, count = self._allocate(tape)
        self._registers = np.zeros((count, size))
        self._bound: dict[int, list[tuple[Any, ...]]] = {}

    def at(self, parameters: Array) -> None:
        """Set the parameters, (n_all,) in the order of the tape [SI], for the blocks to come."""
        values = [0.0] * len(self._operations)
        for position, (name, payload) in enumerate(self._operations):
            if self._stage[position] == _POSE:
                continue
            if name == "constant":
                values[position] = payload[0]
            elif name == "parameter":
                values[position] = float(parameters[int(payload[0])])
            else:
                values[position] = evaluate_scalar(name, *(values[int(a)] for a in payload))
            self._fixed[position] = values[position]
        for position, row in self._first_row.items():
            if self._stage[position] != _POSE:
                self._outputs[row] = values[position]
                for source, copy in self._copies:
                    if source == row:
                        self._outputs[copy] = values[position]

    def evaluate(self, x: Array, known: Array | None = None) -> LoopValues:
        """f and its derivatives at x, (k_all, b) [SI], known constants (c, b); b <= size.

        Values outside an operation's domain come out as NaN or infinity, without a warning:
        the caller knows whether that is a failed trial step or a mistake to report.
        """
        width = x.shape[1]
        self._inputs[: self._quantities, :width] = x
        if known is not None and known.size:
            self._inputs[self._quantities :, :width] = known
        bound = self.size
        while bound >= 2 * width and bound > 64:
            bound //= 2  # few widths, because binding one takes longer than running it
        if bound not in self._bound:
            self._bound[bound] = self._bind(bound)
        with np.errstate(all="ignore"):
            for instruction in self._bound[bound]:
                instruction[0](*instruction[1:])
        out = self._outputs[:, :width]
        m = self._linearisation.loops
        k, n = len(self._linearisation.quantities), len(self._linearisation.parameters)
        return LoopValues(
            out[:m],
            out[m : m + k * m].reshape(k, m, width),
            out[m + k * m :].reshape(n, m, width),
        )

    def _allocate(self, tape: Tape) -> tuple[dict[int, int], int]:
        """A register for every pose-dependent value that is not itself an output."""
        last_use: dict[int, int] = {}
        for position, (name, payload) in enumerate(tape.operations):
            if name not in LEAVES:
                for argument in payload:
                    last_use[int(argument)] = position
        register: dict[int, int] = {}
        free: list[int] = []
        count = 0
        for position, (name, payload) in enumerate(tape.operations):
            if name in LEAVES or self._stage[position] != _POSE:
                continue
            for argument in {int(a) for a in payload}:
                if last_use[argument] == position and argument in register:
                    free.append(register[argument])
            if position in self._first_row:
                continue
            if not free:
                free.append(count)
                count += 1
            register[position] = free.pop()
        return register, count

    def _bind(self, width: int) -> list[tuple[Any, ...]]:
        """The instructions with their arrays, for blocks of `width` poses."""

        def place(position: int) -> Array:
            name, payload = self._operations[position]
            if self._stage[position] != _POSE:
                return self._fixed[position : position + 1]
            if name in LEAVES:
                offset = self._quantities if name == "known" else 0
                return self._inputs[offset + int(payload[0]), :width]
            if position in self._first_row:
                return self._outputs[self._first_row[position], :width]
            return self._registers[self._register[position], :width]

        instructions: list[tuple[Any, ...]] = []
        for position, (name, payload) in enumerate(self._operations):
            if name in LEAVES or self._stage[position] != _POSE:
                continue
            arguments = [place(int(a)) for a in payload]
            instructions.append((OPERATIONS[name].array, *arguments, place(position)))
        for position, row in self._first_row.items():
            if self._operations[position][0] in ("quantity", "known"):
                target = self._outputs[row, :width]
                leaf = self._operations[position]
                offset = self._quantities if leaf[0] == "known" else 0
                source = self._inputs[offset + int(leaf[1][0]), :width]
                instructions.append((np.copyto, target, source))
        for source_row, copy in self._copies:
            position = next(p for p, row in self._first_row.items() if row == source_row)
            if self._stage[position] == _POSE:
                target, source = self._outputs[copy, :width], self._outputs[source_row, :width]
                instructions.append((np.copyto, target, source))
        return instructions


_FIXED, _POSE = 0, 1
_engines = threading.local()


def engine_for(tape: Tape, parameters: tuple[str, ...], size: int) -> NumpyEngine:
    """This thread's engine for f, its derivatives by all quantities and the given parameters.

    Made once and kept, because binding the registers takes longer than a small block.
    """
    kept: dict[tuple[Tape, tuple[str, ...], int], NumpyEngine] = _engines.__dict__.setdefault(
        "kept", {}
    )
    key = (tape, parameters, size)
    if key not in kept:
        if len(kept) > 32:
            kept.clear()
        kept[key] = NumpyEngine(linearise(tape, tape.quantities, parameters), size)
    return kept[key]


def _stages(tape: Tape) -> list[int]:
    """For each operation, whether it varies from pose to pose."""
    stages: list[int] = []
    for name, payload in tape.operations:
        if name in LEAVES:
            stages.append(_POSE if name in ("quantity", "known") else _FIXED)
        else:
            stages.append(max(stages[int(a)] for a in payload))
    return stages


def _output_rows(outputs: tuple[int, ...]) -> tuple[dict[int, int], list[tuple[int, int]]]:
    """Where each distinct output is computed, and which rows are copies of which."""
    first: dict[int, int] = {}
    copies: list[tuple[int, int]] = []
    for row, position in enumerate(outputs):
        if position in first:
            copies.append((first[position], row))
        else:
            first[position] = row
    return first, copies
