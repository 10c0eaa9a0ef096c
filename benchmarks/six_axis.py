"""The benchmark's problem: the MA1400 arm, 27 parameters, well-spread simulated poses.

Joints read with an sd of 50 urad, the point with 10 um; the true parameters lie up to 5 mm and
5 mrad from the nominal ones, which every program starts from. Priors are flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import geometric_arm
import numpy as np
from numpy.typing import NDArray

from loopcal import Dataset, Mechanism, Noise, motoman_ma1400

Array = NDArray[np.float64]
JOINT_SD, POINT_SD = 50e-6, 10e-6
OFF = 5e-3
RANGE = 1.5
"""Half the range of every joint [rad]."""


@dataclass(frozen=True)
class Fit:
    """What every program finds, and how often it evaluated the model or its derivatives per pose.

    parameters: (27,) [SI].
    """

    parameters: Array
    chi_squared: float
    evaluations: float


@dataclass(frozen=True)
class SixAxis:
    """The problem for N poses, ready for every program: joints (6, N), points (3, N)."""

    mechanism: Mechanism
    truth: Array
    joints: Array
    points: Array

    @property
    def nominal(self) -> Array:
        """Nominal parameters in the order of the mechanism, (27,) [SI]."""
        return np.array([p.nominal for p in self.mechanism.parameters])

    @property
    def sds(self) -> Array:
        """Of the six joints and the three coordinates, (9,) [SI]."""
        return np.array([JOINT_SD] * 6 + [POINT_SD] * 3)

    @cached_property
    def dataset(self) -> Dataset:
        """The readings as loopcal takes them."""
        rows = np.vstack([self.joints, self.points])
        return Dataset.from_arrays(dict(zip(self.mechanism.tape.quantities, rows, strict=True)))

    @property
    def noise(self) -> Noise:
        """What is known of the sensors."""
        return Noise({"theta_*": JOINT_SD, "xyz": POINT_SD})


def six_axis(poses: int, seed: int = 1) -> SixAxis:
    """Simulated readings of so many poses."""
    rng = np.random.default_rng(seed)
    mechanism = motoman_ma1400()
    nominal = np.array([p.nominal for p in mechanism.parameters])
    truth = nominal + OFF * rng.uniform(-1, 1, nominal.size)
    joints = rng.uniform(-RANGE, RANGE, (6, poses))
    points = np.hstack(
        [geometric_arm.point(joints[:, i : i + 4096], truth) for i in range(0, poses, 4096)]
    )
    joints += JOINT_SD * rng.standard_normal((6, poses))
    points += POINT_SD * rng.standard_normal((3, poses))
    return SixAxis(mechanism, truth, joints, points)
