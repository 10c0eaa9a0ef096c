"""Unmeasured quantities found in the loops of all poses of a pattern, block after block."""

from __future__ import annotations

from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.solve.block import Block
from loopcal.estimation.solve.sweep import Sweeper

_SIZE = 1024


def found_in_loops(sweeper: Sweeper, pattern: Pattern, block: Block) -> Block:
    """The block with unmeasured quantities where they close the loops best.

    The parameters are those of the sweeper.
    """
    rows, size = list(pattern.unmeasured), min(_SIZE, sweeper.problem.block)
    corrections = block.corrections.copy()
    for begin in range(0, block.count, size):
        some = slice(begin, begin + size)
        corrections[rows, some] += sweeper.kernel(pattern).search(block.of(some))
    return block.at(corrections)
