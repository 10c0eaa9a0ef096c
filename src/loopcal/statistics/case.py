"""A calibration as it was asked for, ready to be made of all its poses or of some."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate, may_be_faulty
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import Result
from loopcal.estimation.solve.solver import Progress
from loopcal.lazy import cached_property
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Case:
    """A calibration as it was asked for."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    fit: Fit
    near: Mapping[str, Array] | None = None
    """Corrections (N,) of what no sensor reads, where a fit of these readings ended."""
    trusted: bool = False
    """Whether faults of the file were sought, and there are none."""
    begin: Mapping[str, float] | None = None
    """Where the calibration of all poses begins [SI], as another one ended. That of some begins as
    asked: what it leaves open must not stand where the other poses put it."""

    @cached_property
    def copied(self) -> Index:
        """Positions of the rows that copy others."""
        mechanism = self.mechanism
        return copies(
            self.data, [*mechanism.quantities, *mechanism.pose_constants], mechanism.outputs
        ).copied

    @property
    def may_be_faulty(self) -> bool:
        """Whether its calibration would seek faults of the file."""
        return not self.trusted and may_be_faulty(self.mechanism, self.data, self.noise, self.fit)

    def discarding(self, outliers: Index) -> Case:
        """The case without the poses at these positions."""
        if not outliers.size:
            return self
        kept = np.setdiff1d(np.arange(len(self.data)), outliers)
        data, noise = self.data.without_outliers(outliers), taken(self.noise, kept)
        return replace(self, data=data, noise=noise)

    def calibrated(self, index: Index | None = None, progress: Progress | None = None) -> Result:
        """The calibration of these poses, by default of all; what copies are, all rows say.

        progress: called at every iteration.
        """
        data, fit = self.data, self.fit
        if index is None and self.begin is not None:
            fit = replace(fit, start=self.begin)
        if index is not None:
            index = index[~np.isin(index, self.copied)]
            # Copies were sought in all poses; a part might judge the same rows otherwise.
            data = replace(data, source=replace(data.source, judged=True)).take(index)
        noise = taken(self.noise, index)
        near = of_poses(self.near, index)
        return calibrate(
            self.mechanism,
            data,
            noise=noise,
            fit=fit,
            progress=progress,
            near=near,
            trusted=self.trusted,
        )


def of_poses(values: Mapping[str, Array] | None, index: Index | None) -> Mapping[str, Array] | None:
    """Columns at these positions; index None takes all."""
    if values is None or index is None:
        return values
    return {name: value[index] for name, value in values.items()}


def taken(noise: Noise | None, index: Index | None) -> Noise | None:
    """The noise of the poses at these positions; index None takes all."""
    return noise if noise is None or index is None else noise.take(index)
