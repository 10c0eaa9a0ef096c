"""A linearised tape as instructions for the compiled engine, fused where that saves work.

cos and sin of one angle are one instruction, and so is a sum of two products. The two sums of a
plane rotation, a c - b d and a d + b c, are one together. Rounding stays as on the tape.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from loopcal.expressions.operations import LEAVES
from loopcal.expressions.tape import Tape

Position = int
"""Of an operation on the tape."""


@dataclass(frozen=True)
class Instruction:
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
    uses = Counter(a for name, payload in tape.operations if name not in LEAVES for a in payload)
    uses.update(tape.outputs)
    inside: set[Position] = set()
    for position, (name, payload) in enumerate(tape.operations):
        # A product that is used elsewhere has to be kept anyway: fusing it would compute it twice.
        if (name == "add" or name == "sub") and varies[position]:
            a, b = int(payload[0]), int(payload[1])
            if (
                a != b
                and uses[a] == uses[b] == 1
                and tape.operations[a][0] == tape.operations[b][0] == "mul"
                and varies[a]
                and varies[b]
            ):
                inside |= {a, b}
    return list(_fused(tape, varies, inside))


def _fused(tape: Tape, varies: Sequence[bool], inside: set[Position]) -> Iterator[Instruction]:
    other = {"sin": "cos", "cos": "sin"}
    where = {one: i for i, one in enumerate(tape.operations) if one[0] in other}
    done: set[Position] = set()
    for position, (name, payload) in enumerate(tape.operations):
        if name in LEAVES or not varies[position] or position in inside or position in done:
            continue
        arguments = tuple([int(a) for a in payload])
        if name in other:
            pair = {name: position, other[name]: where.get((other[name], payload))}
            done.update(p for p in pair.values() if p is not None)
            yield Instruction("sincos", (pair["sin"], pair["cos"]), arguments)
        elif name in ("add", "sub") and inside.issuperset(arguments):
            factors = tuple(int(f) for a in arguments for f in tape.operations[a][1])
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
            rows[position] = int(payload[0]) + (len(tape.quantities) if name == "known" else 0)
    count = len(tape.quantities) + len(tape.pose_constants)
    # of each position: whether its row stays its own, and the last instruction that takes it
    kept, last = bytearray(len(tape.operations)), [-1] * len(tape.operations)
    for position in (*rows, *tape.outputs):
        kept[position] = True
    for i, one in enumerate(instructions):
        for argument in one.arguments:
            last[argument] = i
    free: list[int] = []
    results: list[tuple[int, ...]] = []
    for i, one in enumerate(instructions):
        for argument in set(one.arguments):
            if last[argument] == i and not kept[argument] and argument in rows:
                free.append(rows[argument])
        result_rows = []
        for _ in one.results:
            if not free:
                free.append(count)
                count += 1
            result_rows.append(free.pop())
        for result, row in zip(one.results, result_rows, strict=True):
            if result is not None:
                rows[result] = row
            if result is None or (last[result] < 0 and not kept[result]):
                free.append(row)
        results.append(tuple(result_rows))
    return Program(tuple(instructions), tuple(ends), rows, tuple(results), count)
