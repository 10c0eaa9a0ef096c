"""What the readings of one calibration say of the machine itself, without its prior.

A calibration with prior sds s of the machine, P = diag(1 / s^2), found p with the covariance G. The
readings alone have the information G^-1 - P. With G = R R^T, R^T P R = V diag(1 - f) V^T and f the
shares of the readings, they say

    p + D P (p - nominal),   D = R V diag(1 / f) V^T R^T,

with the covariance D. What the stated covariance C has beyond G becomes A (C - G) A^T, A = 1 + D P.
Where f is nothing, the readings determine nothing. Machines of one type are compared by what their
own readings say: priors that they share would make them alike. Priors of mounting and model error
stay: what these leave open is part of the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.innovation import root_of

_ELSEWHERE = ("placement", "mounting", "model error")
_SHARE = 1e-3
"""Of the information: where readings give less, they determine nothing."""
# Share of an undetermined direction below which a parameter takes no part in it.
_TOUCHED = 1e-6


@dataclass(frozen=True, eq=False)
class MeasuredMachine:
    """names: of the parameters of the machine itself; values (n,), covariance (n, n) [SI].

    determined: (n,) whether the readings determine each; fixed: (n,) whether it was not estimated;
    poses: how many were measured; data: identifies the readings; fewest: how many
    poses have as many equations as parameters.
    """

    name: str
    mechanism: Mechanism
    names: tuple[str, ...]
    values: Array
    covariance: Array
    determined: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    poses: int
    data: str | None
    fewest: int

    @classmethod
    def of(cls, calibrated: Calibrated, poses: int, *, updated: bool = False) -> MeasuredMachine:
        """From a calibration; updated: its prior is of this machine too, and stays."""
        mechanism, all_ = calibrated.mechanism, calibrated.mechanism.parameters
        estimates = np.array([p.nominal for p in all_])
        names = machine_parameters(mechanism)
        positions = [all_.names.index(name) for name in names]
        P = np.zeros(len(estimates))
        if not updated:
            P[positions] = 1.0 / np.square(calibrated.prior_sd[positions])
        P = np.where([p.fixed for p in all_], 0.0, P)
        G = calibrated.unwidened
        R = root_of(G)
        # 1 - R^T P R has the eigenvalues f: what is left of the information without the prior.
        shares, V = np.linalg.eigh(np.eye(R.shape[1]) - R.T @ (P[:, None] * R))
        seen = shares > _SHARE
        half = R @ V[:, seen] / np.sqrt(shares[seen])
        D = half @ half.T
        A = np.eye(len(estimates)) + D * P
        covariance = D + A @ (calibrated.by_residuals.covariance.matrix - G) @ A.T
        values = estimates + D @ (P * (estimates - calibrated.nominal))
        open_ = np.hstack([calibrated.undetermined, R @ V[:, ~seen]])
        sds = np.sqrt(np.square(np.hstack([R, calibrated.undetermined])).sum(axis=1))
        scaled = open_ / np.where(sds > 0.0, sds, 1.0)[:, None]
        sizes = np.abs(scaled).max(axis=0, initial=1e-300)
        loose = (np.abs(scaled) / sizes).max(axis=1, initial=0.0) > _TOUCHED
        at, free = np.ix_(positions, positions), len(all_) - sum(p.fixed for p in all_)
        return cls(
            calibrated.name,
            mechanism,
            names,
            values[positions],
            covariance[at],
            ~loose[positions],
            np.array([all_[all_.names[i]].fixed for i in positions], dtype=bool),
            poses,
            calibrated.data,
            # Rounded up: so many poses have at least as many equations as parameters.
            -(-free // max(len(mechanism.outputs), 1)),
        )


def machine_parameters(mechanism: Mechanism) -> tuple[str, ...]:
    """The parameters that no instrument, mounting or structured model error brings."""
    return tuple(p.name for p in mechanism.parameters if p.role not in _ELSEWHERE)
