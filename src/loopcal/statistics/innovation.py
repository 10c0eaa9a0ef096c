"""What poses of another day say of a calibration: is the difference more than both explain?

At a machine that is held, with its instruments placed anew, the whitened misclosures are

    e = F d + A h + v,   h ~ N(0, 1),   v ~ N(0, 1),

F the columns of what was placed anew (flat), A A^T the covariance of the machine's parameters
where these poses see it. The square of what no d explains, in the metric of its covariance,

    chi^2 = min over d, h of |e - F d - A h|^2 + |h|^2,   degrees of freedom: R - rank F,

is the innovation of the machine (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 5.4). Where sds were learnt it follows F instead: with
nu_j = 2 s_j^4 / var(s_j^2) the degrees of freedom of a component and w_j its share of the
variance, those of the sum are 1 / sum_j (w_j^2 / nu_j) (Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal import chi_squared
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.replacing import DETERMINED, Replaced

Array = NDArray[np.float64]
_UNSEEN = 1e-9
"""An undetermined step that moves the loops by less of what its parts move does not count."""


@dataclass(frozen=True)
class Innovation:
    """The square of the innovation [sds] with its degrees of freedom.

    learnt_freedom: degrees of freedom of the sds themselves, None where all are stated; p_value:
    of a value at least this large if the machine is unchanged, None without degrees of freedom.
    """

    value: float
    degrees_of_freedom: int
    learnt_freedom: float | None
    p_value: float | None

    @classmethod
    def of(cls, value: float, freedom: int, learnt: float | None) -> Innovation:
        """With its p-value."""
        if freedom <= 0:
            return cls(value, max(freedom, 0), learnt, None)
        if learnt is None:
            return cls(value, freedom, None, chi_squared.tail(value, freedom))
        from scipy.special import fdtrc

        return cls(value, freedom, learnt, float(fdtrc(freedom, learnt, value / freedom)))


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of a held machine, and how what is placed anew answers to them.

    e (R,), F (R, g + d), A (R, r); root: (n_all, r) with root root^T the covariance of the
    parameters that are held; solve: (g + d, R) the least squares of F; rank: of F.
    """

    e: Array
    F: Array
    A: Array
    root: Array
    solve: Array
    rank: int

    @classmethod
    def of(cls, here: Replaced, known: Calibrated) -> Linearised:
        """Undetermined steps of the calibration are as free as the placement."""
        J = here.J
        held = ~here.anew[:, None]
        root = here.brought(root_of(known.covariance.matrix) * held)
        loose = here.brought(known.undetermined * held)
        seen = np.linalg.norm(J @ loose, axis=0)
        single = np.linalg.norm(J, axis=0) @ np.abs(loose)
        loose = loose[:, seen > _UNSEEN * np.maximum(single, 1e-300)]
        F = np.hstack([J @ here.directions, J @ loose])
        scale = np.linalg.norm(F, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        U, s, Vt = np.linalg.svd(F / scale, full_matrices=False)
        kept = s > DETERMINED * s.max(initial=0.0)
        solve = (Vt[kept].T / s[kept]) @ U[:, kept].T / scale[:, None]
        return cls(here.e, F, J @ root, root, solve, int(kept.sum()))

    def innovation(self, learnt: float | None) -> Innovation:
        """The statistic; learnt: degrees of freedom of the sds, None where they are stated."""
        left = self.e - self.F @ (self.solve @ self.e)
        A = self.A - self.F @ (self.solve @ self.A)
        r = A.shape[1]
        rows = np.vstack([A, np.eye(r)])
        right = np.concatenate([left, np.zeros(r)])
        h = np.linalg.lstsq(rows, right, rcond=None)[0]
        value = float(np.square(right - rows @ h).sum())
        return Innovation.of(value, len(self.e) - self.rank, learnt)


def root_of(covariance: Array) -> Array:
    """(n, r) a square root of a covariance, scaled first, without what is zero."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(sd > 0.0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale / scale[:, None])
    kept = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
    root: Array = scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root


def components_of(known: Calibrated, quantities: Sequence[str]) -> list[list[int]]:
    """Positions of the quantities of each learnt sd whose own uncertainty is known."""
    return [
        [quantities.index(q) for q in entry.quantities if q in quantities]
        for entry in known.noise
        if _freedom(entry.sd, entry.sd_of_sd, entry.source) is not None
    ]


def learnt_freedom(known: Calibrated, here: Replaced) -> float | None:
    """Degrees of freedom of the sds that weigh these poses; None where all are stated."""
    if known.residual is not None:
        return float(known.residual.freedom)
    own = [_freedom(entry.sd, entry.sd_of_sd, entry.source) for entry in known.noise]
    freedoms = [nu for nu in own if nu is not None]
    if not freedoms:
        return None
    shares = np.zeros(len(freedoms))
    for rows in here.rows:
        squares = np.square(rows.noise).sum(axis=(0, 1))
        np.add.at(shares, rows.owner, squares)
    shares /= max(len(here.e), 1)
    total = float((np.square(shares) / np.array(freedoms)).sum())
    return 1.0 / total if total > 0.0 else None


def _freedom(sd: float, sd_of_sd: float | None, source: str) -> float | None:
    """nu = 2 s^4 / var(s^2), with var(s^2) = 4 s^2 var(s)."""
    if source != "estimated" or not sd_of_sd or not sd:
        return None
    return 0.5 * (sd / sd_of_sd) ** 2
