"""Simulated readings of arms whose truth is known, exact or with normal noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from tests.reference.plain_tape import loop_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """truth: the machine with its true parameters; exact: quantity -> (N,) true values [SI]."""

    truth: Mechanism
    exact: Mapping[str, Array]

    @property
    def values(self) -> dict[str, float]:
        """The true parameters."""
        return {p.name: p.nominal for p in self.truth.parameters}

    def read(self, sds: Mapping[str, float] | None = None, seed: int = 0) -> Dataset:
        """Readings: true values less a normal correction of these sds [SI]."""
        rng = np.random.default_rng(seed)
        noisy = {
            q: v - rng.normal(0.0, (sds or {}).get(q, 0.0), len(v)) for q, v in self.exact.items()
        }
        return Dataset.from_arrays(noisy)

    def off(self, lengths: float, angles: float, seed: int = 0) -> Mechanism:
        """The machine with every parameter off by up to so much [m, rad]."""
        rng = np.random.default_rng(seed)
        return self.truth.with_nominal(
            {
                p.name: p.nominal + rng.uniform(-1, 1) * (lengths if p.unit == "m" else angles)
                for p in self.truth.parameters
            }
        )


def arm_at(truth: Mechanism, joints: Array) -> Simulated:
    """An arm whose loops are reached minus measured point, at joints (k - o, N) [SI]."""
    names = truth.tape.quantities
    inputs = [name for name in names if name not in truth.outputs]
    exact = dict(zip(inputs, joints, strict=True))
    x = np.array([exact.get(name, np.zeros(joints.shape[1])) for name in names])
    p = np.array([parameter.nominal for parameter in truth.parameters])
    points = loop_values(truth.tape, x, np.broadcast_to(p[:, None], (len(p), x.shape[1])))
    exact |= dict(zip(truth.outputs, points, strict=True))
    return Simulated(truth, {name: exact[name] for name in names})


def planar_arm(poses: int = 60, seed: int = 1) -> Simulated:
    """The seed's arm, its joints anywhere."""
    truth = planar_two_link(
        {"xA": 0.02, "yA": -0.03, "l2": 0.81, "l3": 0.59, "phi20": 0.012, "phi30": -0.021}
    )
    joints = np.random.default_rng(seed).uniform(-np.pi, np.pi, (2, poses))
    return arm_at(truth, joints)


def away_from_zero(simulated: Simulated, least: float = 0.05, seed: int = 4) -> Simulated:
    """The same poses with every parameter at least so large, so that relative means something."""
    rng = np.random.default_rng(seed)
    small = {n: v for n, v in simulated.values.items() if abs(v) < least}
    moved = {n: float(rng.choice([-1, 1]) * rng.uniform(least, 2 * least)) for n in small}
    truth = simulated.truth.with_nominal(moved)
    joints = [v for q, v in simulated.exact.items() if q not in truth.outputs]
    return arm_at(truth, np.array(joints))


MA1400_RANGES = np.array(
    [[-1.6, 1.6], [-0.8, 1.4], [-0.9, 1.8], [-2.4, 2.4], [-1.5, 1.5], [-2.9, 2.9]]
)
"""Joint angles S to T [rad] that are well inside those of the real machine."""


def ma1400(poses: int = 100, seed: int = 2) -> Simulated:
    """The six-axis arm as it might come out of the shop, in well-spread poses."""
    rng = np.random.default_rng(seed)
    nominal = motoman_ma1400({"z1": 0.45, "x6B": 0.05, "z6B": -0.45})
    truth = nominal.with_nominal(
        {
            p.name: p.nominal + rng.normal(0.0, 2e-3 if p.unit == "m" else 4e-3)
            for p in nominal.parameters
        }
    )
    low, high = MA1400_RANGES.T
    return arm_at(truth, rng.uniform(low, high, (poses, 6)).T)
