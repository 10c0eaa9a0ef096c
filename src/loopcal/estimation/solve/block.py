"""A block of poses: readings, corrections, known values and noise, sliced by pose in one place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.patterns import Poses
from loopcal.expressions.compiled_engine import native_noise
from loopcal.lazy import cached_property
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty


@dataclass(frozen=True)
class BlockNoise:
    """The uncertainty of a block, and the positions of its unmeasured and measured quantities.

    predicted: for each loop the reading that it predicts, where blocks are reduced by these
    (`whiten_images`); shared: the measured quantities beside these.
    """

    uncertainty: ReadingUncertainty
    unmeasured: tuple[int, ...]
    measured: tuple[int, ...]
    predicted: tuple[int, ...] = ()
    shared: tuple[int, ...] = ()

    @property
    def sd(self) -> Array:
        """Sds (k, 1) or (k, b) [SI]."""
        return self.uncertainty.sd

    @property
    def blocks(self) -> tuple[CovarianceBlock, ...]:
        """Quantities with a full covariance."""
        return self.uncertainty.blocks

    @cached_property
    def native(self) -> Any:
        """The same as the compiled engine takes it, made once for all its calls."""
        among = self.shared if self.predicted else self.measured
        blocks = [([among.index(i) for i in b.indices], b.factor) for b in self.blocks]
        return native_noise(
            self.sd, self.unmeasured, self.measured, blocks, self.predicted, self.shared
        )

    def of(self, chosen: NDArray[np.intp] | slice) -> BlockNoise:
        """The noise of some poses of the block."""
        return replace(self, uncertainty=self.uncertainty.of(chosen))


@dataclass(frozen=True)
class Block:
    """b poses in which the same loops hold.

    poses: their positions among all; parameters: (n_all,) [SI], at which the loops are evaluated;
    readings, corrections: (k, b) [SI]; pose_constants: (c, b) [SI].
    """

    poses: Poses
    parameters: Array
    readings: Array
    corrections: Array
    pose_constants: Array
    noise: BlockNoise

    @property
    def count(self) -> int:
        """How many poses these are."""
        return len(self.readings[0])

    @property
    def corrected(self) -> Array:
        """Corrected readings (k, b)."""
        return self.readings + self.corrections

    @property
    def read(self) -> Block:
        """At the readings as they are, with corrections for unmeasured quantities only."""
        corrections, rows = np.zeros(self.readings.shape), list(self.noise.unmeasured)
        corrections[rows] = self.corrections[rows]
        return self.at(corrections)

    def at(self, corrections: Array, parameters: Array | None = None) -> Block:
        """The same poses with other corrections (k, b), and other parameters (n_all,)."""
        parameters = self.parameters if parameters is None else parameters
        return Block(
            self.poses, parameters, self.readings, corrections, self.pose_constants, self.noise
        )

    def of(self, chosen: NDArray[np.intp] | slice) -> Block:
        """Some of the poses, by their positions in the block."""
        return Block(
            self.positions(chosen),
            self.parameters,
            self.readings[:, chosen],
            self.corrections[:, chosen],
            self.pose_constants[:, chosen],
            self.noise.of(chosen),
        )

    def positions(self, chosen: NDArray[np.intp] | slice) -> NDArray[np.intp]:
        """Positions among all poses of some of the block's."""
        if isinstance(self.poses, slice):
            return np.arange(self.poses.start, self.poses.stop)[chosen]
        return self.poses[chosen]
