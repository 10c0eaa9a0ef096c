"""Wrong corners: pixels that do not fit within images that do.

Ten per cent of wrong corners spoil nearly every image, so that no image can be left out for them.
The rest of an image says where each of its corners should be. So corners are set aside, those left
are fitted, and all are tested against that fit, until the same ones are set aside twice. With the
distance d between a corner and its prediction, s the sd of a coordinate from the median of d over
the corners of a camera,

    P(d > s sqrt(2 log(n / a))) = a / n      where all n corners are good.

Images that are blurred or far away scatter more. There s is that of the image itself, so that not
half of its corners are called wrong. An image most of whose corners are wrong by the scatter of the
others is wrong as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import Outlier
from loopcal.estimation.noise.prints import Prints
from loopcal.estimation.problem.problem import Problem, left_unmeasured
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.mechanism import PIXELS

LEVEL = 1e-3
"""Probability that any corner is set aside where all are good. Chosen: whoever finds corners
left out should be able to trust that they were wrong; those that matter are far beyond."""
HALF = 0.5
"""Share of its corners from which an image is wrong as a whole."""
_ROUNDS = 12
"""A tenth of the corners settles within six."""
_PATIENT = 3
"""Rounds in which a point that is off in most images is kept, until its place is learnt."""
_RAYLEIGH = float(np.sqrt(2.0 * np.log(2.0)))
"""Median distance of two normal coordinates over their sd."""


@dataclass(frozen=True)
class WrongCorners:
    """single: (k, N) readings of wrong corners in images that fit; images: (N,) images of which
    most corners are wrong; count: corners that were tested; sd: of a corner by camera [px];
    corrections: (k, N) [SI] that bring every corner to where the others have it; problem: without
    the single ones, the others at these sds."""

    single: NDArray[np.bool_]
    images: NDArray[np.bool_]
    count: int
    sd: dict[str, float]
    corrections: Array
    problem: Problem

    @property
    def corners(self) -> int:
        """How many single corners are wrong; both coordinates are marked."""
        return int(self.single.sum()) // 2

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """The single corners, worst first, each by the coordinate that is farther off."""
        names = self.problem.mechanism.tape.quantities
        entries = []
        for camera, pairs in _cameras(self.problem).items():
            for u, v in pairs:
                for n in np.flatnonzero(self.single[u]):
                    j = max((u, v), key=lambda i: abs(self.corrections[i, n]))
                    size = -float(self.corrections[j, n])
                    t = float(np.hypot(*self.corrections[[u, v], n])) / self.sd[camera]
                    pose, p = self.problem.poses[n], float(np.exp(-0.5 * t * t))
                    entries.append(Outlier(pose, names[j], t, p, None, size, "px", (), None, False))
                    entries[-1] = replace(entries[-1], instrument=camera)
        return tuple(sorted(entries, key=lambda one: -(one.statistic or 0.0)))


def wrong_corners(result: FitResult, level: float = LEVEL) -> WrongCorners:
    """The corners and images that do not fit the others."""
    problem = result.problem
    names = problem.mechanism.tape.quantities
    cameras = _cameras(problem)
    seen = np.isfinite(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    count = sum(int(seen[pairs[:, 0]].sum()) for pairs in cameras.values())
    none = np.zeros_like(seen)
    parameters = np.array([result.value[n] for n in problem.mechanism.parameters.names])
    corrections = np.array([result.corrections[q] for q in names])
    if not count or result.fit.solver.exact:
        return WrongCorners(none, np.asarray(none.any(axis=0)), count, {}, corrections, problem)
    limit = float(np.sqrt(2.0 * np.log(count / level)))
    aside, earlier, prints = none, [none], Prints.of(problem)
    for number in range(_ROUNDS):
        now, sds = np.zeros_like(seen), {}
        for name, pairs in cameras.items():
            distance = np.hypot(corrections[pairs[:, 0]], corrections[pairs[:, 1]])
            tested = seen[pairs[:, 0]]
            kept = tested & ~aside[pairs[:, 0]]
            sds[name] = max(float(np.median(distance[kept])) / _RAYLEIGH, 1e-9)
            far = tested & (distance > limit * sds[name])
            share = far.sum(axis=0) / np.maximum(tested.sum(axis=0), 1)
            usual = np.maximum(sds[name], _medians(distance, kept) / _RAYLEIGH)
            far &= (share > HALF) | (distance > limit * usual)
            if prints is not None and number < _PATIENT:
                # what is off in most images may be a point of the print that is elsewhere
                often = far.sum(axis=1) > HALF * np.maximum(tested.sum(axis=1), 1)
                far[often] = False
            now[pairs[:, 0]] = now[pairs[:, 1]] = far
        if any(np.array_equal(now, one) for one in earlier[-2:]):
            break
        earlier.append(now)
        aside = now
        weighed = replace(_weighed(problem, cameras, sds, aside), start=parameters)
        solution = result.fit.solver.safe.solve(weighed)
        parameters, corrections = solution.parameters, solution.corrections
        if prints is not None:
            prints = prints.updated(weighed, solution, common=False)
            if prints.kept.any():
                parameters = prints.held(parameters)
                solution = result.fit.solver.safe.solve(replace(weighed, start=parameters))
                parameters, corrections = solution.parameters, solution.corrections
    rows = np.concatenate([pairs.ravel() for pairs in cameras.values()])
    share = aside[rows].sum(axis=0) / np.maximum(seen[rows].sum(axis=0), 1)
    images: NDArray[np.bool_] = share > HALF
    single = aside & ~images
    cleaned = _weighed(problem, cameras, sds, single)
    return WrongCorners(single, images, count, sds, corrections, cleaned)


def _medians(distance: Array, kept: NDArray[np.bool_]) -> Array:
    """(N,) over the corners (n, N) of each image that are kept; 0 without any."""
    seen = np.where(kept, distance, np.nan)
    seen[:, ~kept.any(axis=0)] = 0.0
    return np.nanmedian(seen, axis=0)


def _cameras(problem: Problem) -> dict[str, NDArray[np.intp]]:
    """Positions (points, 2) of the readings u and v of each camera."""
    names = problem.mechanism.tape.quantities
    return {
        family.name: np.array([names.index(q) for q in family.readings]).reshape(-1, 2)
        for family in problem.mechanism.families
        if family.form == PIXELS
    }


def _weighed(
    problem: Problem,
    cameras: dict[str, NDArray[np.intp]],
    sds: dict[str, float],
    aside: NDArray[np.bool_],
) -> Problem:
    """The problem without the corners set aside, the others at the sds that they show."""
    sd = np.array(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    for name, pairs in cameras.items():
        rows = pairs.ravel()
        sd[rows] = np.where(np.isinf(sd[rows]), np.inf, sds[name])
    uncertainty = replace(problem.uncertainty, sd=sd)
    return left_unmeasured(replace(problem, uncertainty=uncertainty), aside)
