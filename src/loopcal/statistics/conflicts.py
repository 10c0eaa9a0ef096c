"""Whether one observation contradicts the others, and by how much.

Directions z of the parameters are scaled, so that all equations and priors together have the
information 1. The equations of one observation have the information F (k, k) and the gradient g.
The others and the priors have 1 - F and -g. Take an eigenvector of F, with the eigenvalue f. Along
it the observation alone gives one estimate, and all others give another one:

    z_one = g / f,   z_others = -g / (1 - f),   z_one - z_others ~ N(0, s^2 / f + 1 / (1 - f)),

s^2 is the variance of the residuals that the observation leaves in a fit by itself. Of an
observation that shares a pose with others, only what it adds to them counts. An observation that
contradicts the others, such as a contact of a ball with a wrong radius, gets a large learnt sd,
and no residual stands out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import ConflictEntry
from loopcal.estimation.dependence.seen import instruments
from loopcal.estimation.problem.error_modes import units_of
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.mechanism import Family
from loopcal.small_samples import f_tail

# A ball a millimetre too large lets its learnt sd grow to a millimetre, beside which a tracker's
# equations weigh 1e5 times as much: chosen beyond that, and above rounding.
_LEAST = 1e-7
"""A direction of which either side knows a smaller share of all compares nothing."""
# Chosen, not derived: as many as show the scatter of what is left to a quarter.
_SPARE = 10
"""Equations that an observation must have beyond what it determines by itself."""
# Chosen, not derived: eigenvectors of so many readings of each pose take milliseconds.
_MOST = 40
"""Readings of an observation from which it is not told apart from others in the same pose."""


def conflicts(result: FitResult) -> tuple[ConflictEntry, ...]:
    """Each observation beside the others; none where there is but one."""
    families = instruments(result.problem)
    if len(families) < 2 or result.all_poses is not None:
        return ()
    equations, root = result.pose_equations(), result.solution.spectrum.root
    entries = [_entry(result.problem, one, families, equations, root) for one in families]
    return tuple(one for one in entries if one is not None)


def _entry(
    problem: Problem,
    family: Family,
    families: Sequence[Family],
    equations: Sequence[PoseEquations],
    root: Array,
) -> ConflictEntry | None:
    parts = list(_added(problem, family, families, equations, root))
    if not parts:
        return None
    E = np.concatenate([part[0] for part in parts])
    A = np.concatenate([part[1] for part in parts])
    shown, count = sum(part[2] for part in parts), sum(part[3] for part in parts)
    shares, vectors = np.linalg.eigh(A.T @ A)
    g = vectors.T @ (A.T @ E)
    seen = shares > _LEAST
    spare = count - int(seen.sum())
    compared = seen & (shares < 1.0 - _LEAST)
    if spare < _SPARE or not compared.any():
        return None
    square = float(E @ E)
    by_itself = max(square - float((np.square(g[seen]) / shares[seen]).sum()), 0.0) / spare
    f, g = shares[compared], g[compared]
    scale = np.maximum(f * (1.0 - f) * (by_itself * (1.0 - f) + f), 1e-300)
    p_value = f_tail(float((np.square(g) / scale).sum()), len(f), spare)
    # An error of one sd moves its equation by less than 1 where joints err too.
    (sd,) = units_of(problem, [problem.mechanism.tape.quantities.index(family.readings[0])])
    unit = float(sd) / max(math.sqrt(shown / count), 1e-300)
    return ConflictEntry(
        family.name,
        unit * math.sqrt(square / count),
        unit * math.sqrt(by_itself),
        problem.mechanism.quantities[family.readings[0]],
        p_value,
    )


def _added(
    problem: Problem,
    family: Family,
    families: Sequence[Family],
    equations: Sequence[PoseEquations],
    root: Array,
) -> Iterator[tuple[Array, Array, float, int]]:
    """The equations that an observation adds to the others, by parts: E (m,), A (m, k), the squares
    by which its own errors of one sd move them, summed, and their number, those that an image
    leaves out with them."""
    names = problem.mechanism.tape.quantities
    own_rows = [names.index(q) for q in family.readings]
    sds = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    aside = [names.index(q) for one in families if one is not family for q in one.readings]
    units = units_of(problem, own_rows)
    for block in equations:
        read = np.isfinite(sds[own_rows][:, block.poses])
        if not read.any():
            continue
        alone = not np.isfinite(sds[aside][:, block.poses]).any()
        X = block.X[:, :, own_rows] * read.T[:, None, :] * units
        if alone and len(own_rows) >= block.rows:
            shown = float((block.squares[:, own_rows] * read.T * np.square(units)).sum())
            count = block.E.size if block.beside is None else int(block.count.sum())
            A = rows_times(block.D, root).reshape(-1, root.shape[1])
            yield block.E.ravel(), A, shown, count
        elif len(own_rows) <= _MOST:
            values, vectors = np.linalg.eigh(X.transpose(0, 2, 1) @ X)
            kept = values > 1e-9 * values.max(axis=1, keepdims=True)
            Q = X @ (vectors / np.sqrt(np.where(kept, values, 1.0))[:, None, :])
            turned = Q.transpose(0, 2, 1)
            E = np.einsum("bqr,br->bq", turned, block.E)[kept]
            A = (turned @ rows_times(block.D, root))[kept]
            yield E, A, float(values[kept].sum()), len(E)
