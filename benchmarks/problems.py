"""The benchmark's problems, as every program gets them, and what every program hands back.

Points and joints of N simulated poses are read with noise; every program starts from nominal
parameters, without priors, and corrects joints and points alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import geometric_arm
import numpy as np
import two_link
from chain import Chain
from numpy.typing import NDArray

from loopcal import Dataset, Mechanism, Noise, motoman_ma1400, planar_two_link

Array = NDArray[np.float64]
BLOCK = 4096
JOINT_SD, POINT_SD = 50e-6, 10e-6
"""Of the six-axis arm [rad, m]."""


@dataclass(frozen=True)
class Fit:
    """What every program finds, and how often it evaluated the model or its derivatives per pose.

    parameters: (n,) [SI]; seconds: of a program that tells them itself, so that its start does not
    count.
    """

    parameters: Array
    chi_squared: float
    evaluations: float
    seconds: float | None = None


@dataclass(frozen=True)
class Model:
    """Where an arm is, of joints (J, N) and parameters (n,), all poses at once.

    point: (P, N); its derivatives by_joint: (P, J, N), by_parameter: (P, n, N). chain: the same arm
    as a product of elementary transforms, for programs that go pose by pose.
    """

    point: Callable[[Array, Array], Array]
    by_joint: Callable[[Array, Array], Array]
    by_parameter: Callable[[Array, Array], Array]
    chain: Chain


@dataclass(frozen=True)
class Problem:
    """Readings of an arm with J joints in N poses.

    truth, nominal: (n,) in the order of the mechanism; joints: (J, N); points: (P, N);
    joint_sds, point_sds: (J,), (P,) [SI]; quantities: what is read, joints first; model: the arm
    in NumPy by hand.
    """

    name: str
    mechanism: Mechanism
    model: Model
    truth: Array
    nominal: Array
    quantities: tuple[str, ...]
    joints: Array
    points: Array
    joint_sds: Array
    point_sds: Array

    @property
    def sds(self) -> Array:
        """Of the joints and the coordinates, (J + P,) [SI]."""
        return np.concatenate([self.joint_sds, self.point_sds])

    @cached_property
    def dataset(self) -> Dataset:
        """The readings as loopcal takes them."""
        rows = np.vstack([self.joints, self.points])
        return Dataset.from_arrays(dict(zip(self.quantities, rows, strict=True)))

    @property
    def noise(self) -> Noise:
        """What is known of the sensors."""
        return Noise(dict(zip(self.quantities, self.sds.tolist(), strict=True)))


def six_axis(poses: int, seed: int = 1) -> Problem:
    """The MA1400 with 27 parameters: joints within 1.5 rad, read with 50 urad, points with 10 um.

    The true parameters lie up to 5 mm and 5 mrad from the nominal ones.
    """
    rng = np.random.default_rng(seed)
    mechanism = motoman_ma1400()
    nominal = np.array([p.nominal for p in mechanism.parameters])
    truth = nominal + 5e-3 * rng.uniform(-1, 1, nominal.size)
    model = _by_hand(geometric_arm)
    joints = rng.uniform(-1.5, 1.5, (6, poses))
    names = (*(f"theta_{i}" for i in range(1, 7)), "x", "y", "z")
    sds = np.full(6, JOINT_SD), np.full(3, POINT_SD)
    return _read("six-axis", mechanism, model, truth, nominal, names, joints, sds, rng)


def planar(poses: int, seed: int = 1) -> Problem:
    """The seed's two-link arm with 6 parameters, and the sds of its table 5.

    The first joint is read with 1 mrad, the second with 100 mrad, points with 0.1 mm. The second
    keeps 30 degrees away from the stretched arm, where a point is reached in two ways that such a
    reading cannot tell apart, and programs could rightly differ.
    """
    rng = np.random.default_rng(seed)
    nominal = np.array([1e-3, -1e-3, 0.802, 0.597, 5e-3, -5e-3])
    truth = np.array([0.0, 0.0, 0.8, 0.6, 0.0, 0.0])
    names = ("phi2", "phi3", "xP", "yP")
    parameters = ("xA", "yA", "l2", "l3", "phi20", "phi30")
    mechanism = planar_two_link(dict(zip(parameters, nominal.tolist(), strict=True)))
    model = _by_hand(two_link)
    joints = rng.uniform(0.0, np.pi / 2, (2, poses)) + np.array([[0.0], [np.pi / 6]])
    sds = np.array([1e-3, 100e-3]), np.full(2, 0.1e-3)
    return _read("planar", mechanism, model, truth, nominal, names, joints, sds, rng)


def _by_hand(arm: ModuleType) -> Model:
    return Model(arm.point, arm.by_joint, arm.by_parameter, arm.chain())


def _read(
    name: str,
    mechanism: Mechanism,
    model: Model,
    truth: Array,
    nominal: Array,
    names: tuple[str, ...],
    joints: Array,
    sds: tuple[Array, Array],
    rng: np.random.Generator,
) -> Problem:
    """The problem with noise on where the joints and the point truly are."""
    poses = joints.shape[1]
    starts = range(0, poses, BLOCK)
    points = np.hstack([model.point(joints[:, i : i + BLOCK], truth) for i in starts])
    joints = joints + sds[0][:, None] * rng.standard_normal(joints.shape)
    points += sds[1][:, None] * rng.standard_normal(points.shape)
    return Problem(name, mechanism, model, truth, nominal, names, joints, points, *sds)


PROBLEMS = {"planar": planar, "six-axis": six_axis}
"""By name, of so many poses."""
