"""The compiled engine: the same tape run by C++ with vectors of poses, on several threads.

Its code is in the folder `engine`, built with loopcal where there is a compiler. Results do not
depend on the width of the processor's vectors, the number of threads, or a pose's neighbours, to
the last bit; only functions of the C library (all but + - * /, sqrt, sin and cos) may differ from
machine to machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.choice import AVAILABLE
from loopcal.expressions.derivative import Linearisation
from loopcal.expressions.loop_values import LoopValues, Stage, arranged, stage_ends
from loopcal.expressions.operations import LEAVES
from loopcal.expressions.program import Program, program_of
from loopcal.expressions.rewriting import in_stages, varying
from loopcal.expressions.tape import Tape

if AVAILABLE:
    from loopcal.expressions import _compiled

Array = NDArray[np.float64]
_CONSTANT, _PARAMETER = -1, -2


class CompiledEngine:
    """Evaluates one linearised tape over blocks of at most `size` poses (`Engine`)."""

    def __init__(self, linearisation: Linearisation, size: int) -> None:
        self.size = size
        self.loops, self.parameters = linearisation.loops, len(linearisation.parameters)
        self._native = _native(linearisation)
        self._set: bytes | None = None
        self._linearisation = linearisation
        self._outputs = np.empty((len(linearisation.tape.outputs), size))

    def native(self, p: Array) -> _compiled.Engine:
        """The engine itself at parameters (n_all,), whose part is computed where they change."""
        present = p.tobytes()
        if present != self._set:
            self._native.at(np.ascontiguousarray(p, dtype=np.float64))
            self._set = present
        return self._native

    def evaluate(
        self,
        p: Array,
        x: Array,
        pose_constants: Array | None = None,
        stage: Stage = Stage.BY_PARAMETER,
    ) -> LoopValues:
        """Run a block of poses (`Engine.evaluate`)."""
        width = x.shape[1]
        out = self._outputs[:, :width]
        pose_constants = None if pose_constants is None else side_by_side(pose_constants)
        self.native(p).evaluate(side_by_side(x), pose_constants, int(stage), out)
        return arranged(out, self._linearisation, stage)


def side_by_side(rows: Array) -> Array:
    """Rows of float64 in which neighbouring poses are neighbours in memory."""
    if rows.strides[-1] == rows.itemsize and rows.dtype == np.float64:
        return rows
    return np.ascontiguousarray(rows, dtype=np.float64)


def native_noise(
    sd: Array,
    unmeasured: Sequence[int],
    measured: Sequence[int],
    blocks: Iterable[tuple[Sequence[int], Array]],
) -> _compiled.Noise:
    """The uncertainty of a block as the engine takes it.

    sd: (k, 1) or (k, b); unmeasured, measured: all quantities; blocks: places among the measured
    ones, and the factor (c, c) or (b, c, c) of their covariance.
    """
    places, factors = [], []
    for which, factor in blocks:
        places.append(which)
        factors.append(np.ascontiguousarray(factor))
    return _compiled.Noise(sd, unmeasured, measured, places, factors)


def _native(linearisation: Linearisation) -> _compiled.Engine:
    return _compiled.Engine(*_tables(linearisation))


@lru_cache(maxsize=64)
def _tables(linearisation: Linearisation) -> tuple[Any, ...]:
    """What an engine is made from; several threads make one each."""
    tape, varies, program = prepared(linearisation)
    used = sorted(
        {a for one in program.instructions for a in one.arguments if not varies[a]}
        | {output for output in tape.outputs if not varies[output]}
    )
    # Negative places are numbers of the parameters, rows of poses count from 0.
    place = {position: -1 - i for i, position in enumerate(used)} | program.rows
    once = _Once(tape, varies)
    shape = (linearisation.loops, len(linearisation.quantities), len(linearisation.parameters))
    inputs = (len(tape.quantities), len(tape.pose_constants))
    return (
        _instructions(program, place),
        program.ends,
        [place[output] for output in tape.outputs],
        shape,
        inputs,
        program.count - sum(inputs),
        once.rows,
        once.constants,
        [once.number[position] for position in used],
    )


def _codes() -> dict[str, int]:
    return {name: code for code, name in enumerate(_compiled.codes())}


def _instructions(program: Program, place: dict[int, int]) -> NDArray[np.int32]:
    """For each instruction its code, two rows for results, and where its four arguments stand."""
    codes = _codes()
    table = np.zeros((len(program.instructions), 7), dtype=np.int32)
    for row, one, results in zip(table, program.instructions, program.results, strict=True):
        arguments = [place[a] for a in one.arguments]
        row[0] = codes[one.name]
        row[1:3] = results  # of one result: twice
        row[3:] = arguments + arguments[:1] * (4 - len(arguments))
    return table


class _Once:
    """What depends on parameters alone.

    rows: (c, 3) code and up to two earlier places, or a leaf; constants: (c,); number: the place
    of each position of the tape.
    """

    def __init__(self, tape: Tape, varies: tuple[bool, ...]) -> None:
        codes = _codes()
        positions = [i for i, value in enumerate(varies) if not value]
        self.number = {position: i for i, position in enumerate(positions)}
        self.rows = np.zeros((len(positions), 3), dtype=np.int32)
        self.constants = np.zeros(len(positions))
        for i, position in enumerate(positions):
            name, payload = tape.operations[position]
            if name == "constant":
                self.rows[i, 0], self.constants[i] = _CONSTANT, payload[0]
            elif name in LEAVES:
                self.rows[i] = _PARAMETER, int(payload[0]), 0
            else:
                places = [self.number[int(p)] for p in payload]
                self.rows[i] = codes[name], places[0], places[-1]


@lru_cache(maxsize=64)
def prepared(linearisation: Linearisation) -> tuple[Tape, tuple[bool, ...], Program]:
    """The tape in stages, the operations that vary by pose, and the instructions."""
    ends = stage_ends(linearisation)
    tape = in_stages(linearisation.tape, ends)
    varies = varying(tape.operations)
    return tape, varies, program_of(tape, varies, ends)
