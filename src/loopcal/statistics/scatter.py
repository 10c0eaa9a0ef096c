"""The covariance of the parameters that the scatter of the poses themselves shows.

Every pose pulls the parameters by g_i = C D_i^T E_i, and poses drawn alike pull independently,
whatever their errors come from: noise, or a machine model that lacks something. So

    C_s = sum_i g~_i g~_i^T + C P C,   g~_i = C D_i^T (I - H_i)^(-1/2) E_i,   H_i = D_i C D_i^T,

is valid where noise and model are wrong (White 1980), P the prior's precision; the root makes up
for what the fit took from the residuals (Bell and McCaffrey 2002: CR2). It says nothing of poses
elsewhere, and few poses know it badly: as well as a Wishart matrix whose elements vary as much,

    nu = (1 - n / equations) (tr(P)^2 + tr(P^2)) / sum_i (tr(H_i)^2 + tr(H_i^2)),   P = C sum D^T D,

degrees of freedom (Tipton and Pustejovsky 2015, for good noise): so many as poses less what the
fit took, and fewer where some poses decide more than others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.document.fit import CovarianceEntry
from loopcal.document.plain import lower, symmetric
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult

# A pose that alone determines a direction has redundancy 0 there, and its root no bound.
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class Scatter:
    """matrix (n, n) [SI], which varies as a Wishart matrix with so many degrees of freedom."""

    matrix: Array
    freedom: float

    def added_to(self, entry: CovarianceEntry) -> CovarianceEntry:
        """The covariance of a document with this."""
        return replace(entry, scatter=lower(self.matrix), scatter_freedom=self.freedom)

    @classmethod
    def of(cls, entry: CovarianceEntry) -> Scatter | None:
        """From a document."""
        if entry.scatter is None or entry.scatter_freedom is None:
            return None
        return cls(symmetric(entry.scatter), entry.scatter_freedom)

    def through(self, S: Array) -> Scatter:
        """Of S times the parameters."""
        return Scatter(S @ self.matrix @ S.T, self.freedom)


def scatter(result: FitResult) -> Scatter | None:
    """Of a calibration; None of a stream, under a robust loss, without an optimum, and where learnt
    terms carry the error of the model."""
    if result.all_poses is not None or result.fit.robust_loss is not None:
        return None
    if result.learns_terms or not result.status.converged:
        return None
    problem, solution = result.problem, result.solution
    covariance, rank = result.spectrum.covariance(), result.spectrum.rank
    # C P C: the pull of the prior, which no pose shows.
    matrix = covariance @ (problem.precision[:, None] * covariance)
    whole, single = np.zeros_like(covariance), 0.0
    for block in result.pose_equations():
        turned = rows_times(block.D, covariance)
        redundancy = np.eye(block.E.shape[1]) - turned @ block.D.transpose(0, 2, 1)
        values, vectors = np.linalg.eigh(redundancy)
        whole += np.einsum("brn,brm->nm", turned, block.D)
        # 1 - values are the eigenvalues of H_i.
        single += float(np.square((1.0 - values).sum(axis=1)).sum() + np.square(1.0 - values).sum())
        root = vectors / np.sqrt(np.maximum(values, _LEAST))[:, None, :]
        freed = root @ (np.swapaxes(vectors, 1, 2) @ block.E[:, :, None])
        pulls = (np.swapaxes(turned, 1, 2) @ freed)[:, :, 0]
        matrix = matrix + pulls.T @ pulls
    poses = (np.trace(whole) ** 2 + np.trace(whole @ whole)) / max(single, 1e-300)
    left = 1.0 - rank / max(solution.equations, 1)
    return Scatter(matrix, max(float(poses) * left, 1.0))
