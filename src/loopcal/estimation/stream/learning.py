"""A stream whose fit learns sds of terms: from poses thinned evenly, in memory, and shown on all.

A pass over all poses with the columns of a model error costs a hundred times as much as one without
them, and learning takes dozens. Some thousand poses say what a machine model lacks; more of them
would lower the part of single readings' noise alone, which is small beside it. The last pass judges
all poses, most of which took no part in the fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.model_error import used_noise, weighed
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.result import Result
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.solution import End
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.stream.chunks import Chunk, Stream, joined
from loopcal.estimation.stream.merit import Ratios
from loopcal.mechanisms.mechanism import Mechanism

# docs/decisions/0016.
ENOUGH = 5_000
"""Poses that take part in the fit, at most."""
NEARLY = 1e-2
"""A fit of some of the poses converges to so many sds: others would have moved it by more."""


@dataclass(frozen=True, eq=False)
class AsFitted:
    """A stream with the noise and the readings that a fit of a mechanism uses."""

    stream: Stream
    mechanism: Mechanism
    fit: Fit

    @property
    def poses(self) -> int:
        return self.stream.poses

    @property
    def count(self) -> int:
        return self.stream.count

    def chunk(self, number: int) -> Chunk:
        chunk = self.stream.chunk(number)
        noise = used_noise(self.fit, self.mechanism, chunk.data, chunk.noise)
        if noise is None:
            return chunk
        _, data = with_model(self.mechanism, weighed(self.fit, chunk.data), noise)
        return Chunk(data, noise)


@dataclass(frozen=True, eq=False)
class Learnt:
    """What was learnt from some poses.

    part: their calibration; every: one pose of so many took part; sizes: poses of each chunk.
    """

    part: Result
    every: int
    sizes: tuple[int, ...]

    @property
    def mechanism(self) -> Mechanism:
        """With the learnt sds of its terms."""
        return self.part.mechanism

    @property
    def ratios(self) -> Ratios:
        """On the variances of sensors."""
        if (estimate := self.part.estimate) is None:
            return ()
        learnt = zip(estimate.stated, estimate.variances.ratios.tolist(), strict=True)
        return tuple((component.quantities, ratio) for component, ratio in learnt)

    @property
    def stands_for_all(self) -> bool:
        """Whether the fit of these poses stands for all: with terms, a pass over all costs much
        more; and where it failed, that of all would."""
        learns_terms = bool(self.mechanism.learnt_terms)
        return learns_terms or bool(self.part.faults) or not self.part.status.converged

    @property
    def end(self) -> End[bool]:
        """Where the fit of the part ended, as the end of a stream."""
        end = self.part.solution.with_state(True)
        return replace(end, sums=without_state(end.sums))

    def annotated(self, result: Result) -> Result:
        """The result of all poses, with what was learnt and from how many."""
        part = self.part
        if self.every > 1:
            share = f"{part.solution.poses} of these poses, one of every {self.every}. "
            if self.stands_for_all:
                result = result.noted(f"The fit used {share}The accuracy is that of all poses.")
            else:
                result = result.noted(f"The sds were learnt from {share}The fit used all poses.")
        return replace(result, stated=part.stated, estimate=part.estimate, faults=part.faults)


def learn(
    mechanism: Mechanism, stream: Stream, fit: Fit, progress: Progress | None = None
) -> Learnt:
    """The calibration of at most `ENOUGH` poses of a stream, thinned evenly.

    Raises InputError as `calibrate` does.
    """
    every = -(-stream.poses // ENOUGH)
    parts, sizes = list[Chunk](), list[int]()
    for number in range(stream.count):
        chunk = stream.chunk(number)
        # The stride goes on from chunk to chunk; otherwise each would bring its own first pose.
        thinned = np.arange(-sum(sizes) % every, len(chunk.data), every)
        sizes.append(len(chunk.data))
        if thinned.size:
            parts.append(chunk.take(thinned))
    part = joined(parts)
    if every > 1:
        fit = fit.changed(tolerance=fit.tolerance or NEARLY)
        part = replace(part, noise=part.noise.begun_at({}))  # as near as those of nearly the same
    options: dict[str, Any] = {"noise": part.noise, "fit": fit, "progress": progress}
    return Learnt(calibrate(mechanism, part.data, **options), every, tuple(sizes))
