"""Columns of derivatives that are multiples of a common one, which makes sums of products cheap.

A smooth function of the joints that moves the body is a sum of features times coefficients: the
derivatives by its coefficients are features times the derivative by the motion. With D_i = f_i C
in all loops of a pose,

    D_i^T D_j = f_i f_j C^T C',

so one product of common columns serves all pairs of their multiples. Such columns are seen on the
tape, whatever made them: their derivatives of all loops are products with the same factor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from loopcal.expressions.derivative import Linearisation
from loopcal.expressions.domain import stage_ends
from loopcal.expressions.tape import Tape

# Chosen, not derived: blocks of sums are four columns wide.
FEWEST = 8
"""Fewer multiples of a column are summed as columns of their own."""

_ONE = -1
"""Stands for the number 1, which every value is a multiple of."""
_Column = tuple[tuple[int, bool], ...]
"""Of each loop the position on the tape, and whether its value is meant with the other sign."""


@dataclass(frozen=True)
class Multiples:
    """The multiples among the columns by parameters of a linearised tape.

    tape: its outputs are the loops, derivatives by quantities, columns of parameters alone, common
    columns and factors, then the multiples; ends: how many there are without columns by parameters
    as in `stage_ends`, without multiples, and in all. places: of the outputs in the order of the
    linearised tape, of common columns and of factors; factors: how many; members: of each common
    column, its multiples by position with the number of their factor.
    """

    tape: Tape
    ends: tuple[int, ...]
    places: tuple[int, ...]
    factors: int
    members: tuple[tuple[tuple[int, int], ...], ...]


@lru_cache(maxsize=64)
def multiples(linearisation: Linearisation) -> Multiples:
    """Each column is a multiple of one at most: that of which the most columns could be."""
    tape, m = linearisation.tape, linearisation.loops
    values, begin, end = stage_ends(linearisation)
    columns = range(begin, end, m) if m > 1 else ()  # of one loop nothing is saved
    splits = [_splits(tape, tape.outputs[i : i + m]) for i in columns]
    candidates = Counter(column for some in splits for column in some)
    shared: dict[_Column, list[tuple[int, int]]] = {}
    for parameter, some in enumerate(splits):
        if some:
            column = max(some, key=candidates.__getitem__)
            shared.setdefault(column, []).append((parameter, some[column]))
    shared = {column: some for column, some in shared.items() if len(some) >= FEWEST}
    factors = sorted({factor for some in shared.values() for _, factor in some})
    number = {factor: i for i, factor in enumerate(factors)}
    operations, position = list(tape.operations), dict[tuple[int, bool], int]()
    for one, negative in dict.fromkeys(part for column in shared for part in column):
        made = negative or one == _ONE
        position[one, negative] = len(operations) if made else one
        if made:
            sign = ("constant", (-1.0 if negative else 1.0,))
            operations.append(sign if one == _ONE else ("neg", (one,)))
    common = [position[part] for column in shared for part in column]
    members = {parameter for some in shared.values() for parameter, _ in some}
    last = dict.fromkeys(begin + p * m + i for p in sorted(members) for i in range(m))
    first = [i for i in range(end) if i not in last]
    outputs = [*tape.outputs, *common, *factors]
    order = [*first, *range(end, len(outputs)), *last]
    place = {i: at for at, i in enumerate(order)}
    return Multiples(
        replace(tape, operations=tuple(operations), outputs=tuple(outputs[i] for i in order)),
        (values, begin, len(order) - len(last), len(order)),
        tuple(place[i] for i in range(len(order))),
        len(factors),
        tuple(tuple((p, number[factor]) for p, factor in some) for some in shared.values()),
    )


def _splits(tape: Tape, outputs: Sequence[int]) -> dict[_Column, int]:
    """The columns of which these loops are a multiple, each with its factor."""
    parts = [_factors(tape, output) for output in outputs]
    moving = [some for some in parts if some is not None]
    if not moving:
        return {}
    zeros = [(output, False) for output in outputs]
    return {
        tuple(
            zero if some is None else some[factor] for some, zero in zip(parts, zeros, strict=True)
        ): factor
        for factor in sorted(set(moving[0]).intersection(*moving[1:]))
    }


def _factors(tape: Tape, position: int) -> dict[int, tuple[int, bool]] | None:
    """What each factor of a value multiplies; None for zero, of which anything is a factor."""
    name, payload = tape.operations[position]
    if name == "constant" and payload[0] == 0.0:
        return None
    factors = {position: (_ONE, False)}
    if negative := name == "neg":
        factors[payload[0]] = _ONE, True
        name, payload = tape.operations[payload[0]]
    if name == "mul":
        a, b = payload
        factors |= {a: (b, negative), b: (a, negative)}
    return factors
