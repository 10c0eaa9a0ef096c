"""Random machines with random covariances, for laws that must hold whatever the machine is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, serial_arm
from tests.reference.simulated import Simulated, arm_at, planar_arm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A machine in known poses with the covariance of every pose's readings, (N, k, k)."""

    simulated: Simulated
    covariances: Array

    @property
    def truth(self) -> Mechanism:
        """The machine with its true parameters."""
        return self.simulated.truth

    @property
    def noise(self) -> Noise:
        """What is told to the estimator: one full covariance per pose."""
        return Noise({self.truth.tape.quantities: self.covariances})

    def draw(self, seed: int) -> Dataset:
        """Readings with a correction drawn from each pose's covariance."""
        exact = np.array([self.simulated.exact[q] for q in self.truth.tape.quantities])
        z = np.random.default_rng(seed).normal(size=exact.T.shape)
        readings = exact - np.einsum("bij,bj->ib", np.linalg.cholesky(self.covariances), z)
        return Dataset.from_arrays(dict(zip(self.truth.tape.quantities, readings, strict=True)))

    def with_poses(self, order: Any) -> Case:
        """Some of the poses, or all in another order."""
        exact = {q: v[order] for q, v in self.simulated.exact.items()}
        return Case(Simulated(self.truth, exact), self.covariances[order])


def random_covariances(machine: Mechanism, poses: int, level: float, seed: int) -> Array:
    """Full, differing from pose to pose, correlated across kinds; sds about `level` [m, rad]."""
    rng = np.random.default_rng(seed)
    k = len(machine.quantities)
    sds = level * rng.uniform(0.3, 2.0, (poses, k))
    roots = rng.normal(size=(poses, k, k)) / np.sqrt(k) + 0.3 * np.eye(k)
    factors = sds[:, :, None] * roots
    covariances: Array = factors @ np.swapaxes(factors, 1, 2)
    return covariances


def random_arm(seed: int, joints: int = 3, poses: int = 40) -> Simulated:
    """A serial arm of revolute transitions about random axes, each unlike the one before."""
    rng = np.random.default_rng(seed)
    axes = [str(rng.choice(list("xyz")))]
    while len(axes) < joints:
        axes.append(str(rng.choice([a for a in "xyz" if a != axes[-1]])))
    chain = [
        Joint(f"q{i}", f"transition-{axis}", direction=int(rng.choice([-1, 1])))
        for i, axis in enumerate(axes, 1)
    ]
    arm = serial_arm(chain, {}, name=f"random arm {seed}")
    values = {
        p.name: rng.uniform(-0.5, 0.5) if p.unit == "m" else rng.uniform(-0.3, 0.3)
        for p in arm.parameters
    }
    return arm_at(arm.with_nominal(values), rng.uniform(-2.5, 2.5, (joints, poses)))


def four_bar(poses: int = 40) -> Simulated:
    """A crank, a coupler and a rocker on a frame of known length, all three angles read."""

    def loops(x: Any, p: Any) -> Any:
        crank, coupler, rocker = x.crank + p.crank0, x.coupler + p.coupler0, x.rocker + p.rocker0
        return (
            p.a * np.cos(crank) + p.b * np.cos(coupler) - p.c * np.cos(rocker) - p.d,
            p.a * np.sin(crank) + p.b * np.sin(coupler) - p.c * np.sin(rocker),
        )

    a, b, c, d, zeros = 0.2, 0.55, 0.45, 0.6, (0.03, -0.02, 0.05)
    truth = Mechanism.from_function(
        loops,
        dict.fromkeys(("crank", "coupler", "rocker"), "rad"),
        {
            **{name: (value, "m") for name, value in (("a", a), ("b", b), ("c", c))},
            "d": Parameter("d", d, "m", fixed=True),
            **{
                f"{n}0": (v, "rad")
                for n, v in zip(("crank", "coupler", "rocker"), zeros, strict=True)
            },
        },
        name="four-bar",
    )
    crank = np.linspace(0, 2 * np.pi, poses, endpoint=False)
    # the rocker's end lies on circles about the crank's end and about the frame's far end
    x, y = d - a * np.cos(crank), -a * np.sin(crank)
    diagonal = np.hypot(x, y)
    inner = np.arccos((b**2 + diagonal**2 - c**2) / (2 * b * diagonal))
    coupler = np.arctan2(y, x) + inner
    rocker = np.arctan2(b * np.sin(coupler) - y, b * np.cos(coupler) - x)
    angles = zip(("crank", "coupler", "rocker"), (crank, coupler, rocker), zeros, strict=True)
    return Simulated(truth, {name: np.unwrap(v) - zero for name, v, zero in angles})


def cases(level: float = 1e-4) -> dict[str, Case]:
    """Machines by name, each with random covariances about this level of sd [m, rad]."""
    machines = {
        "planar": planar_arm(40),
        "three joints": random_arm(1),
        "two joints": random_arm(2, joints=2),
        "four joints": random_arm(3, joints=4, poses=60),
        "four-bar": four_bar(),
    }
    return {
        name: Case(m, random_covariances(m.truth, len(next(iter(m.exact.values()))), level, i))
        for i, (name, m) in enumerate(machines.items())
    }
