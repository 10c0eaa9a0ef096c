"""The engine that was chosen, made for a tape.

The NumPy engine: runs a linearised tape over a block of poses, structure of arrays.

What depends on parameters alone is evaluated once per set of parameters with plain numbers. The
rest is a list of NumPy calls on arrays of poses. Their registers are reused as soon as a value is
spent, so that a block stays in the processor's cache.
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.expressions.choice import chosen_engine, use_threads
from loopcal.expressions.compiled_engine import CompiledEngine
from loopcal.expressions.derivative import Linearisation, linearise
from loopcal.expressions.domain import Engine, LoopValues, Stage, arranged, stage_ends
from loopcal.expressions.graph import LEAVES, OPERATIONS, evaluate_scalar
from loopcal.expressions.rewriting import half_angles, in_stages, varying
from loopcal.expressions.tape import Tape, moved

__all__ = ["Engine", "LoopValues", "Stage", "engine_class", "engine_for"]

_engines = threading.local()


def engine_class() -> type[NumpyEngine] | type[CompiledEngine]:
    """The one place where an engine is selected."""
    return CompiledEngine if chosen_engine() == "compiled" else NumpyEngine


def engine_for(
    tape: Tape,
    parameters: tuple[str, ...],
    size: int,
    quantities: tuple[str, ...] | None = None,
) -> Engine:
    """This thread's engine for f and its derivatives by the given parameters and quantities (all).

    Made once and kept, because binding the registers takes longer than a small block; made anew for
    blocks of more poses than it takes.
    """
    kept: dict[Any, NumpyEngine | CompiledEngine] = _engines.__dict__.setdefault("kept", {})
    quantities = tape.quantities if quantities is None else quantities
    kind = engine_class()
    use_threads()
    key = (kind, tape, parameters, quantities)
    present = kept.pop(key, None)
    if present is None or present.size < size:
        # Studies make tapes without end; a mechanism at work needs a handful of engines.
        if len(kept) > 32:
            del kept[next(iter(kept))]
        present = kind(linearise(tape, quantities, parameters), size)
    kept[key] = present  # the last used is the last to go
    return present


_Instructions = list[tuple[np.ufunc, tuple[Array, ...]]]


class NumpyEngine:
    """Evaluates one linearised tape over blocks of at most `size` poses.

    One engine belongs to one thread: its registers are its own.
    """

    def __init__(self, linearisation: Linearisation, size: int) -> None:
        self.size = size
        self._linearisation = linearisation
        self._ends = stage_ends(linearisation)
        tape = _prepared(linearisation)
        self._operations = tape.operations
        self._varies = varying(tape.operations)
        once = [i for i, varies in enumerate(self._varies) if not varies]
        self._number = {position: number for number, position in enumerate(once)}
        self._once = [moved(tape.operations[position], self._number) for position in once]
        self._numbers = np.zeros(len(once))
        self._inputs = np.zeros((len(tape.quantities) + len(tape.pose_constants), size))
        self._quantities = len(tape.quantities)
        self._outputs = np.zeros((len(tape.outputs), size))
        self._targets = tape.outputs
        # Of an output that stands in several rows the first holds it; `_copies` fills the others.
        self._row = {o: row for row, o in reversed(list(enumerate(tape.outputs)))}
        self._register, count = self._allocate()
        self._registers = np.zeros((count, size))
        self._bound: dict[int, list[_Instructions]] = {}
        self._set: bytes | None = None

    def _prepare(self, parameters: Array) -> None:
        """What depends on parameters alone, computed once for all blocks at the same ones."""
        present = parameters.tobytes()
        if present == self._set:
            return
        self._set = present
        numbers: list[float] = []
        for name, payload in self._once:
            if name == "constant":
                numbers.append(payload[0])
            elif name == "parameter":
                numbers.append(float(parameters[payload[0]]))
            else:
                numbers.append(evaluate_scalar(name, *[numbers[a] for a in payload]))
        self._numbers[:] = numbers
        for row, output in enumerate(self._targets):
            if not self._varies[output]:
                self._outputs[row] = numbers[self._number[output]]

    def evaluate(
        self,
        p: Array,
        x: Array,
        pose_constants: Array | None = None,
        stage: Stage = Stage.BY_PARAMETER,
    ) -> LoopValues:
        """Run a block of poses (`Engine.evaluate`)."""
        self._prepare(p)
        width = x.shape[1]
        self._inputs[: self._quantities, :width] = x
        if pose_constants is not None and pose_constants.size:
            self._inputs[self._quantities :, :width] = pose_constants
        bound = self.size
        while bound >= 2 * width and bound > 64:
            bound //= 2  # few widths, because binding one takes longer than running it
        if bound not in self._bound:
            self._bound[bound] = self._bind(bound)
        with np.errstate(all="ignore"):
            for instructions in self._bound[bound][: stage + 1]:
                for function, arrays in instructions:
                    function(*arrays)
        return arranged(self._outputs[:, :width], self._linearisation, stage)

    def _allocate(self) -> tuple[dict[int, int], int]:
        """A register for every value that varies and is not itself an output; and how many."""
        last_use: dict[int, int] = {}
        for position, (name, payload) in enumerate(self._operations):
            if name not in LEAVES:
                last_use |= dict.fromkeys(payload, position)
        register: dict[int, int] = {}
        free: list[int] = []
        count = 0
        for position, (name, payload) in enumerate(self._operations):
            if name in LEAVES or not self._varies[position]:
                continue
            for argument in set(payload):
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
                arrays = [self._place(a, width) for a in payload]
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
            return self._inputs[offset + payload[0], :width]
        if position in self._row:
            return self._outputs[self._row[position], :width]
        return self._registers[self._register[position], :width]


@lru_cache(maxsize=64)
def _prepared(linearisation: Linearisation) -> Tape:
    return in_stages(half_angles(linearisation.tape), stage_ends(linearisation))
