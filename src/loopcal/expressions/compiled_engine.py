"""The compiled engine: the same tape run by C++ with vectors of poses, on several threads.

Its code is in the folder `engine`, built with loopcal where there is a compiler. Results do not
depend on the width of the processor's vectors, the number of threads, or a pose's neighbours, to
the last bit; only functions of the C library (all but + - * /, sqrt, sin and cos) may differ from
machine to machine.

A linearised tape as instructions for the compiled engine, fused where that saves work.

cos and sin of one angle are one instruction, and so is a sum of two products. The two sums of a
plane rotation, a c - b d and a d + b c, are one together. Rounding stays as on the tape.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.expressions.choice import AVAILABLE
from loopcal.expressions.derivative import Linearisation
from loopcal.expressions.domain import LoopValues, Stage, arranged
from loopcal.expressions.graph import LEAVES
from loopcal.expressions.multiples import multiples
from loopcal.expressions.rewriting import in_stages, varying
from loopcal.expressions.tape import Tape

if AVAILABLE:
    from loopcal.expressions import _compiled

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
        if len(out):  # a limb that no instrument sees has no loops
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
    predicted: Sequence[int] = (),
    shared: Sequence[int] = (),
) -> _compiled.Noise:
    """The uncertainty of a block as the engine takes it.

    sd: (k, 1) or (k, b); unmeasured, measured: all quantities; blocks: places among the measured
    ones, and the factor (c, c) or (b, c, c) of their covariance; predicted: for each loop the
    reading that it predicts, or none; shared: the others of the measured, among which places then
    count.
    """
    places, factors = [], []
    for which, factor in blocks:
        places.append(which)
        factors.append(np.ascontiguousarray(factor))
    return _compiled.Noise(sd, unmeasured, measured, places, factors, predicted, shared)


def _native(linearisation: Linearisation) -> _compiled.Engine:
    return _compiled.Engine(*_tables(linearisation))


@lru_cache(maxsize=64)
def _tables(linearisation: Linearisation) -> tuple[Any, ...]:
    """What an engine is made from; several threads make one each."""
    tape, varies, program = prepared(linearisation)
    shared = multiples(linearisation)
    used = sorted(
        {a for one in program.instructions for a in one.arguments if not varies[a]}
        | {output for output in tape.outputs if not varies[output]}
    )
    # Negative places are numbers of the parameters, rows of poses count from 0.
    place = {position: -1 - i for i, position in enumerate(used)} | program.rows
    once = _Once(tape, varies)
    outputs = [place[tape.outputs[i]] for i in shared.places]
    ahead = len(outputs) - shared.factors
    shape = (linearisation.loops, len(linearisation.quantities), len(linearisation.parameters))
    inputs = (len(tape.quantities), len(tape.pose_constants))
    return (
        _instructions(program, place),
        program.ends,
        outputs[:ahead],
        shape,
        inputs,
        program.count - sum(inputs),
        once.rows,
        once.constants,
        [once.number[position] for position in used],
        outputs[ahead:],
        [[parameter for parameter, _ in members] for members in shared.members],
        [[factor for _, factor in members] for members in shared.members],
    )


def _codes() -> dict[str, int]:
    return {name: code for code, name in enumerate(_compiled.codes())}


def _instructions(program: Program, place: dict[int, int]) -> NDArray[np.int32]:
    """For each instruction its code, two rows for results, and where its four arguments stand."""
    codes = _codes()
    table: list[int] = []
    for one, results in zip(program.instructions, program.results, strict=True):
        arguments = [place[a] for a in one.arguments]
        table += codes[one.name], results[0], results[-1]  # of one result: twice
        table += arguments + arguments[:1] * (4 - len(arguments))
    return np.array(table, dtype=np.int32).reshape(-1, 7)


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
                self.rows[i] = _PARAMETER, payload[0], 0
            else:
                places = [self.number[p] for p in payload]
                self.rows[i] = codes[name], places[0], places[-1]


@lru_cache(maxsize=64)
def prepared(linearisation: Linearisation) -> tuple[Tape, tuple[bool, ...], Program]:
    """The tape in stages, the operations that vary by pose, and the instructions.

    Its outputs are those of `multiples`.
    """
    shared = multiples(linearisation)
    tape = in_stages(shared.tape, shared.ends)
    varies = varying(tape.operations)
    return tape, varies, program_of(tape, varies, shared.ends)


Position = int
"""Of an operation on the tape."""


class Instruction(NamedTuple):
    """One step: the values it makes, from those it takes, all as positions on the tape.

    An unwanted second result is None.
    """

    name: str
    results: tuple[Position | None, ...]
    arguments: tuple[Position, ...]


@dataclass(frozen=True)
class Program:
    """Instructions over rows of poses.

    rows: where values that vary by pose stand, inputs first; count: of rows; ends: how many
    instructions each stage needs.
    """

    instructions: tuple[Instruction, ...]
    ends: tuple[int, ...]
    rows: dict[Position, int]
    results: tuple[tuple[int, ...], ...]
    count: int


def program_of(tape: Tape, varies: Sequence[bool], ends: Sequence[int]) -> Program:
    """The program of a tape in stages; ends: how many outputs there are at the end of each."""
    instructions = _turns(_sums(tape, varies))
    made = {r: i for i, one in enumerate(instructions) for r in one.results if r is not None}
    stage_ends = [
        max((made.get(o, -1) for o in tape.outputs[:end]), default=-1) + 1 for end in ends
    ]
    return _in_rows(tape, instructions, stage_ends)


def _sums(tape: Tape, varies: Sequence[bool]) -> list[Instruction]:
    """Instructions in the order of the tape, with sums of products and pairs of cos and sin."""
    operations = tape.operations
    uses = [0] * len(operations)
    for name, payload in operations:
        if name not in LEAVES:
            for a in payload:
                uses[a] += 1
    for output in tape.outputs:
        uses[output] += 1
    inside: set[Position] = set()
    for position, (name, payload) in enumerate(operations):
        # A product that is used elsewhere has to be kept anyway: fusing it would compute it twice.
        if (name == "add" or name == "sub") and varies[position]:
            a, b = payload
            if (
                uses[a] == uses[b] == 1
                and operations[a][0] == operations[b][0] == "mul"
                and varies[a]
                and varies[b]
                and a != b
            ):
                inside.add(a)
                inside.add(b)
    return list(_fused(tape, varies, inside))


def _fused(tape: Tape, varies: Sequence[bool], inside: set[Position]) -> Iterator[Instruction]:
    other, operations = {"sin": "cos", "cos": "sin"}, tape.operations
    where = {one: i for i, one in enumerate(operations) if one[0] in other}
    done: set[Position] = set()
    for position, (name, arguments) in enumerate(operations):
        if name in LEAVES or not varies[position] or position in inside or position in done:
            continue
        if name in other:
            pair = {name: position, other[name]: where.get((other[name], arguments))}
            done.update(p for p in pair.values() if p is not None)
            yield Instruction("sincos", (pair["sin"], pair["cos"]), arguments)
        elif (name == "add" or name == "sub") and inside.issuperset(arguments):
            factors = operations[arguments[0]][1] + operations[arguments[1]][1]
            yield Instruction("plus" if name == "add" else "minus", (position,), factors)
        else:
            yield Instruction(name, (position,), arguments)


def _turns(instructions: Iterable[Instruction]) -> tuple[Instruction, ...]:
    """The same, a c - b d and a d + b c made together where the first of them was."""
    instructions = list(instructions)
    sums = {_pairs(one.arguments): i for i, one in enumerate(instructions) if one.name == "plus"}
    turned: dict[int, Instruction] = {}
    gone: set[int] = set()
    for i, one in enumerate(instructions):
        if one.name != "minus":
            continue
        a, c, b, d = one.arguments
        # The partner of a c - b d is a d + b c; products commute, so a and c may change places.
        for order in ((a, b, c, d), (c, b, a, d)):
            partner = sums.get(_pairs((order[0], d, b, order[2])))
            if partner is not None and partner not in gone and partner not in turned:
                results = (*one.results, *instructions[partner].results)
                turned[min(i, partner)] = Instruction("turn", results, order)
                gone.add(max(i, partner))
                break
    return tuple(turned.get(i, one) for i, one in enumerate(instructions) if i not in gone)


def _pairs(factors: Sequence[Position]) -> frozenset[tuple[Position, ...]]:
    """What a sum of two products is made of, in whatever order."""
    return frozenset((tuple(sorted(factors[:2])), tuple(sorted(factors[2:]))))


def _in_rows(tape: Tape, instructions: Sequence[Instruction], ends: Sequence[int]) -> Program:
    """A row for every value: inputs have theirs, outputs keep theirs, others pass them on."""
    rows: dict[Position, int] = {}
    for position, (name, payload) in enumerate(tape.operations):
        if name in ("quantity", "known"):
            rows[position] = payload[0] + (len(tape.quantities) if name == "known" else 0)
    count = len(tape.quantities) + len(tape.pose_constants)
    # of each position: whether its row stays its own, and the last instruction that takes it
    kept, last = bytearray(len(tape.operations)), [-1] * len(tape.operations)
    for position in (*rows, *tape.outputs):
        kept[position] = True
    for i, (_, _, arguments) in enumerate(instructions):
        for argument in arguments:
            last[argument] = i
    free: list[int] = []
    results: list[tuple[int, ...]] = []
    for i, (_, made, arguments) in enumerate(instructions):
        for argument in set(arguments):
            if last[argument] == i and not kept[argument] and argument in rows:
                free.append(rows[argument])
        result_rows = []
        for _ in made:
            if not free:
                free.append(count)
                count += 1
            result_rows.append(free.pop())
        for result, row in zip(made, result_rows, strict=True):
            if result is not None:
                rows[result] = row
            if result is None or (last[result] < 0 and not kept[result]):
                free.append(row)
        results.append(tuple(result_rows))
    return Program(tuple(instructions), tuple(ends), rows, tuple(results), count)
