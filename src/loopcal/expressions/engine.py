"""The NumPy engine: runs a linearised tape over a block of poses, structure of arrays.

What depends on parameters alone is evaluated once per set of parameters with plain numbers;
the rest is a list of NumPy calls on arrays of poses, in registers that are reused as soon as
their value is spent, so that a block stays in the processor's cache.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.derivative import Linearisation, linearise
from loopcal.expressions.operations import LEAVES, OPERATIONS, evaluate_scalar
from loopcal.expressions.rewriting import half_angles, in_stages, varying
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


class Stage(IntEnum):
    """How far a tape is run: loop values alone, derivatives by quantities too, or all."""

    VALUES = 0
    BY_QUANTITY = 1
    BY_PARAMETER = 2


_Instructions = list[tuple[np.ufunc, tuple[Array, ...]]]


class NumpyEngine:
    """Evaluates one linearised tape over blocks of at most `size` poses.

    `at(p)` sets the parameters; `evaluate(x, known)` runs a block. One engine belongs to one
    thread: its registers are its own.
    """

    def __init__(self, linearisation: Linearisation, size: int) -> None:
        self.size = size
        self._loops = linearisation.loops
        self._ends = _stage_ends(linearisation)
        tape = _prepared(linearisation)
        self._operations = tape.operations
        self._varies = varying(tape.operations)
        once = [i for i, varies in enumerate(self._varies) if not varies]
        self._number = {position: number for number, position in enumerate(once)}
        self._once = [_renumbered(tape.operations[position], self._number) for position in once]
        self._numbers = np.zeros(len(once))
        self._inputs = np.zeros((len(tape.quantities) + len(tape.known), size))
        self._quantities = len(tape.quantities)
        self._outputs = np.zeros((len(tape.outputs), size))
        self._targets = tape.outputs
        self._row = {o: row for row, o in reversed(list(enumerate(tape.outputs)))}
        self._register, count = self._allocate()
        self._registers = np.zeros((count, size))
        self._bound: dict[int, list[_Instructions]] = {}

    def at(self, parameters: Array) -> None:
        """Set the parameters, (n_all,) in the order of the tape [SI], for the blocks to come."""
        numbers: list[float] = []
        for name, payload in self._once:
            if name == "constant":
                numbers.append(payload[0])
            elif name == "parameter":
                numbers.append(float(parameters[int(payload[0])]))
            else:
                numbers.append(evaluate_scalar(name, *[numbers[int(a)] for a in payload]))
        self._numbers[:] = numbers
        for row, output in enumerate(self._targets):
            if not self._varies[output]:
                self._outputs[row] = numbers[self._number[output]]

    def evaluate(
        self, x: Array, known: Array | None = None, stage: Stage = Stage.BY_PARAMETER
    ) -> LoopValues:
        """f and its derivatives at x, (k_all, b) [SI], known constants (c, b); b <= size.

        stage: how far to go; derivatives beyond it are left out, as if none were chosen.

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
            for instructions in self._bound[bound][: stage + 1]:
                for function, arrays in instructions:
                    function(*arrays)
        values, by_quantity, by_parameter = (
            self._outputs[begin : end if wanted <= stage else begin, :width]
            for wanted, begin, end in zip(Stage, (0, *self._ends), self._ends, strict=False)
        )
        shape = (-1, self._loops, width)
        return LoopValues(values, by_quantity.reshape(shape), by_parameter.reshape(shape))

    def _allocate(self) -> tuple[dict[int, int], int]:
        """A register for every value that varies and is not itself an output; and how many."""
        last_use: dict[int, int] = {}
        for position, (name, payload) in enumerate(self._operations):
            if name not in LEAVES:
                last_use |= {int(argument): position for argument in payload}
        register: dict[int, int] = {}
        free: list[int] = []
        count = 0
        for position, (name, payload) in enumerate(self._operations):
            if name in LEAVES or not self._varies[position]:
                continue
            for argument in {int(a) for a in payload}:
                if last_use[argument] == position and argument in register:
                    free.append(register[argument])
            if position in self._row:
                continue
            if not free:
                free.append(count)
                count += 1
            register[position] = free.pop()
        return register, count

    def _bind(self, width: int) -> list[_Instructions]:
        """The NumPy calls of each stage with their arrays, for blocks of `width` poses."""
        stages: list[_Instructions] = []
        done = row = 0
        for end in self._ends:
            needed = max(self._targets[:end], default=-1) + 1
            operations, rows = range(done, needed), range(row, end)
            stages.append([*self._calls(operations, width), *self._copies(rows, width)])
            done, row = needed, end
        return stages

    def _calls(self, positions: range, width: int) -> _Instructions:
        calls: _Instructions = []
        for position in positions:
            name, payload = self._operations[position]
            function = OPERATIONS[name].array if name not in LEAVES else None
            if function is not None and self._varies[position]:
                arrays = [self._place(int(a), width) for a in payload]
                calls.append((function, (*arrays, self._place(position, width))))
        return calls

    def _copies(self, rows: range, width: int) -> _Instructions:
        """The outputs that are readings, or are computed as another output."""
        copies: _Instructions = []
        for row in rows:
            output = self._targets[row]
            source, target = self._place(output, width), self._outputs[row, :width]
            if self._varies[output] and source.ctypes.data != target.ctypes.data:
                copies.append((np.positive, (source, target)))
        return copies

    def _place(self, position: int, width: int) -> Array:
        """Where the value of an operation stands: one number, or one for each pose."""
        name, payload = self._operations[position]
        if not self._varies[position]:
            number = self._number[position]
            return self._numbers[number : number + 1].reshape(())  # a view
        if name in LEAVES:
            offset = self._quantities if name == "known" else 0
            return self._inputs[offset + int(payload[0]), :width]
        if position in self._row:
            return self._outputs[self._row[position], :width]
        return self._registers[self._register[position], :width]


def _stage_ends(linearisation: Linearisation) -> tuple[int, int, int]:
    """How many outputs there are at the end of each stage."""
    m, k = linearisation.loops, len(linearisation.quantities)
    return m, m + k * m, len(linearisation.tape.outputs)


@lru_cache(maxsize=64)
def _prepared(linearisation: Linearisation) -> Tape:
    return in_stages(half_angles(linearisation.tape), _stage_ends(linearisation))


_engines = threading.local()


def engine_for(
    tape: Tape,
    parameters: tuple[str, ...],
    size: int,
    quantities: tuple[str, ...] | None = None,
) -> NumpyEngine:
    """This thread's engine for f and its derivatives by the given parameters and quantities (all).

    Made once and kept, because binding the registers takes longer than a small block.
    """
    kept: dict[Any, NumpyEngine] = _engines.__dict__.setdefault("kept", {})
    quantities = tape.quantities if quantities is None else quantities
    key = (tape, parameters, size, quantities)
    if key not in kept:
        if len(kept) > 32:
            kept.clear()
        kept[key] = NumpyEngine(linearise(tape, quantities, parameters), size)
    return kept[key]


def _renumbered(
    operation: tuple[str, tuple[float, ...]], number: dict[int, int]
) -> tuple[str, tuple[float, ...]]:
    name, payload = operation
    return name, payload if name in LEAVES else tuple(number[int(a)] for a in payload)
