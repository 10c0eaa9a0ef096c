"""What an engine is: it runs a linearised tape over blocks of poses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.derivative import Linearisation

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
