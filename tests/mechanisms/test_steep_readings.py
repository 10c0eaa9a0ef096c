"""What is redundant follows from the loops alone: whatever their units, and however steep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.instruments import SIX
from loopcal.mechanisms.origins import joint_chain
from loopcal.mechanisms.redundancy import fix_redundant, redundant
from tests.reference.cameras import camera

SCALES = [1e-6, 1e-3, 1.0, 1e3, 1e6]


def rank(rows: list[list[Fraction]]) -> int:
    """Of a matrix of rational numbers, by exact elimination."""
    found = 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(found, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[found], rows[pivot] = rows[pivot], rows[found]
        for i in range(found + 1, len(rows)):
            share = rows[i][column] / rows[found][column]
            rows[i] = [a - share * b for a, b in zip(rows[i], rows[found], strict=True)]
        found += 1
    return found


@dataclass(frozen=True)
class Own:
    """u = sum p_i t_i, v = u / (5 + q_0 + sum of odd p_i t_i / 7)^3, t_i = prod q_j^powers_ij.

    Some powers come twice, so that the loops know only the sum of two parameters; one is unused.
    """

    powers: NDArray[Any]
    idle: int

    @classmethod
    def drawn(cls, seed: int) -> Own:
        rng = np.random.default_rng(seed)
        count = int(rng.integers(6, 11))
        powers = rng.integers(0, 3, (count, 3))
        for twin in rng.choice(range(2, count, 2), 2, replace=False):
            powers[twin] = powers[twin - 2]
        return cls(powers, int(rng.integers(0, count)))

    def terms(self, q: Any) -> list[Any]:
        found: list[Any] = [
            math.prod((joint ** int(n) for joint, n in zip(q, row, strict=True)), start=1)
            for row in self.powers.tolist()
        ]
        found[self.idle] = 0
        return found

    def outputs(self, q: Any, p: Any) -> tuple[Any, Any]:
        t = self.terms(q)
        u = sum(value * term for value, term in zip(p, t, strict=True))
        w = 5 + q[0] + sum(p[i] * t[i] for i in range(1, len(t), 2)) / 7
        return u, u / w**3

    def exact_rank(self, poses: int = 12) -> int:
        """Of the Jacobian by the parameters, at rational points, by derivatives written out."""
        rng = np.random.default_rng(3)
        p = [Fraction(int(n), 101) for n in rng.integers(-97, 97, len(self.powers)).tolist()]
        rows: list[list[Fraction]] = []
        for _ in range(poses):
            q = [Fraction(int(n), 103) for n in rng.integers(-97, 97, 3).tolist()]
            t = [Fraction(term) for term in self.terms(q)]
            u = sum(value * term for value, term in zip(p, t, strict=True))
            w = 5 + q[0] + sum(p[i] * t[i] for i in range(1, len(t), 2)) / Fraction(7)
            rows += [t, [s / w**3 - 3 * u * (s * (i % 2) / 7) / w**4 for i, s in enumerate(t)]]
        return rank(rows)


@pytest.mark.parametrize("seed", range(8))
def test_as_many_parameters_stay_as_the_exact_rank_in_any_unit(seed: int) -> None:
    own = Own.drawn(seed)
    count = len(own.powers)
    exact = own.exact_rank()
    assert exact < count
    rng = np.random.default_rng(seed)
    names = [f"p{i}" for i in range(count)]
    for _ in range(4):
        machine, read = in_units(own, rng, names)
        assert len(fix_redundant(machine, readings=read).parameters.free) == exact


def in_units(
    own: Own, rng: np.random.Generator, names: list[str]
) -> tuple[lc.Mechanism, dict[str, NDArray[np.float64]]]:
    """The function with inputs, outputs and parameters in units of their own, and poses of it."""
    joints = own.powers.shape[1]
    out, into, by = (rng.choice(SCALES, n) for n in (2, joints, len(names)))

    def loops(x: Any, p: Any) -> list[Any]:
        q = [x[f"q{j}"] / into[j] for j in range(joints)]
        values = own.outputs(q, [p[n] / s for n, s in zip(names, by, strict=True)])
        return [s * v - x[u] for s, v, u in zip(out, values, "uv", strict=True)]

    machine = lc.Mechanism.from_function(
        loops,
        {**{f"q{j}": "1" for j in range(joints)}, "u": "1", "v": "1"},
        {n: (float(s * rng.uniform(-1, 1)), "1") for n, s in zip(names, by, strict=True)},
        outputs=("u", "v"),
    )
    read = {f"q{j}": into[j] * rng.uniform(-1, 1, 60) for j in range(joints)}
    return machine, {**read, "u": np.zeros(60), "v": np.zeros(60)}


def seen(pixels: tuple[float, float], focal: float = 2000.0) -> lc.Mechanism:
    """A six-axis arm with a mark on its hand, seen by a camera that stands still."""
    nominal = {"camera_x": 0.2, "camera_y": -0.1, "camera_z": 3.0, "camera_rx": 0.1, "mark_x": 0.04}
    return lc.assemble(
        joint_chain(SIX), [camera(pixels=pixels, focal=focal)], {**nominal, "mark_y": 0.02}
    )


@pytest.mark.parametrize(
    ("pixels", "focal"), [((1.0, 1.0), 2000.0), ((1e-6, 1e6), 2000.0), ((1e3, 1.0), 0.004)]
)
def test_a_camera_fixes_what_motion_does_not_show_and_nothing_else(
    pixels: tuple[float, float], focal: float
) -> None:
    """4 of each joint and 6, less 3 turns of a point and the scale of all lengths; its own 4."""
    arm = seen(pixels, focal)
    found = redundant(arm, first=[n for n in arm.parameters.names if n.startswith("camera")])
    assert len(arm.parameters.free) - len(found) == 4 * 6 + 6 - 3 - 1 + 4
    assert not [r for r in found if not r.instead]
