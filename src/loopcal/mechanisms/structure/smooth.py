"""Smooth functions of the joints, as few features: what a dense Gaussian process would add.

The product of periodic kernels exp((cos(q_d - q_d') - 1) / l_d^2) has the Fourier series
sum_k w_k cos(k . (q - q')) over vectors k of whole numbers, with the weights

    w_k = prod_d I_{k_d}(1 / l_d^2) exp(-1 / l_d^2),

I_k the modified Bessel functions. The M vectors k != 0 of largest weight, one of k and -k, give the
features a_k cos(k . q) and a_k sin(k . q). The a_k are scaled such that their squares sum to 1: if
all coefficients have the sd s, so has the function, in every pose.

Source: MacKay (1998) for the kernel; Rahimi and Recht (2007) for features of a kernel.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.frame import Values

DISCREPANCY = "discrepancy"
"""Name of the term of smooth shifts of the body; begins the names of its parameters."""
# 12 and 30 waves hold 45 and 62 % of the kernel's variance. On the MA1400 60 or 100 waves cost
# two to five times as much and predict regions not used worse; the rest of the waves is an error
# of the predictions (`estimation/noise/kenward_roger.py`).
FEATURES, FEW = 30, 12
"""Number of vectors k of a smooth function, and the number for fewer than `MANY_POSES` poses."""
MANY_POSES, POSES_EACH = 300, 5
"""Poses from which all features are used, and the fewest poses for each vector."""
_ROUNDED = 1e-14
# The first three joints move the arm on its longest levers, so they are resolved more finely.
NEAR, FAR = 1.0, 3.0
"""Length scales [rad] of the first three turning joints, and of the others."""
RANGE = 1.0
"""Range [m] of a slide without stated limits; half a turn stands for it."""


@dataclass(frozen=True)
class Harmonic:
    """A vector k of whole numbers by joint, and the root of its share of the variance."""

    orders: tuple[int, ...]
    amplitude: float


@dataclass(frozen=True)
class Smooth:
    """Features of the joints: names, with a factor each that makes turns [rad] of readings.

    body: which one of several is displaced; "" for the only one.
    """

    joints: tuple[str, ...]
    factors: tuple[float, ...]
    scales: tuple[float, ...]
    harmonics: tuple[Harmonic, ...]
    body: str = ""

    @classmethod
    def of(
        cls, joints: Sequence[tuple[str, str]], ranges: dict[str, float], count: int = FEATURES
    ) -> Smooth:
        """Features of joints, given by name and SI unit, from so many vectors k; ranges [m] of
        slides, where known."""
        turning = [name for name, unit in joints if unit == "rad"]
        scales = [NEAR if name not in turning[3:] else FAR for name, _ in joints]
        factors = [
            # A slide's range stands for half a turn: the periodic kernel does not tie its two ends
            # together.
            1.0 if unit == "rad" else math.pi / ranges.get(name, RANGE)
            for name, unit in joints
        ]
        names = tuple(name for name, _ in joints)
        return cls(names, tuple(factors), tuple(scales), harmonics(scales, count))

    def following(self, count: int) -> Smooth:
        """The waves that come after these, up to so many in all, on the same scale."""
        every = harmonics(self.scales, count)
        rest = every[len(self.harmonics) :]
        return replace(self, harmonics=rest)

    def coefficients(self, axis: str) -> list[str]:
        """Names of the parameters of the shift along an axis x, y, z, or of the turn rx, ry, rz."""
        return ["_".join(filter(None, (DISCREPANCY, self.body, axis, p))) for p in self.parts]

    def columns(self, names: Sequence[str]) -> list[list[int]]:
        """Positions among these names of the coefficients of each axis that has them all."""
        place = {name: i for i, name in enumerate(names)}
        each = [self.coefficients(axis) for axis in ("x", "y", "z", "rx", "ry", "rz")]
        return [[place[n] for n in row] for row in each if all(n in place for n in row)]

    def shifted(self, by_parameter: Array, readings: Values, names: Sequence[str]) -> Array:
        """What a shift of the body along each axis does, (N, o, a), from what its coefficients do.

        by_parameter: (N, o, n) derivatives by parameters of these names, at readings (N,). The
        squares of the features sum to 1, so that X = sum_k S_k a_k is what the shift itself does.
        """
        F = np.array(self.features(readings)).T
        rows = self.columns(names)
        each = [np.einsum("bof,bf->bo", by_parameter[:, :, row], F) for row in rows]
        return np.stack(each, axis=-1) if each else np.zeros((*by_parameter.shape[:2], 0))

    @property
    def parts(self) -> list[str]:
        """What the features are called, in their order: cos1, sin1, cos2, ..."""
        numbers = range(1, len(self.harmonics) + 1)
        return [f"{part}{i}" for i in numbers for part in ("cos", "sin")]

    def features(self, x: Values) -> list[Any]:
        """a_k cos(k . q) and a_k sin(k . q) for each k in turn."""
        values: list[Any] = []
        for harmonic in self.harmonics:
            phase: Any = 0.0
            for order, joint, factor in zip(
                harmonic.orders, self.joints, self.factors, strict=True
            ):
                if order:
                    phase = phase + (order * factor) * x[joint]
            values += [harmonic.amplitude * np.cos(phase), harmonic.amplitude * np.sin(phase)]
        return values


class WaveErrors(NamedTuple):
    """What waves of one sd that a fit leaves out do, (N, o, w): taken, S F, by the parameters that
    took them up; left, Z - S F, all in all."""

    taken: Array
    left: Array

    @property
    def changed(self) -> Array:
        """(N, o, o) by how much the covariance of what is left exceeds that of what is taken."""
        gained = self.left @ self.left.transpose(0, 2, 1)
        return np.asarray(gained - self.taken @ self.taken.transpose(0, 2, 1))


@dataclass(frozen=True, eq=False)
class FurtherWaves:
    """Waves that the discrepancy of a body leaves out, as errors that neighbouring poses share.

    smooth: the waves that the discrepancy has; sd: of each further amplitude [m]; moved: F (n, w),
    what amplitudes of one sd do to the parameters of the fit.
    """

    smooth: Smooth
    sd: float
    moved: Array

    def through(self, M: Array) -> FurtherWaves:
        """Of other parameters, which change by M (m, n) with these."""
        return replace(self, moved=M @ self.moved)

    def errors(self, S: Array, slopes: Array, readings: Values, names: Sequence[str]) -> WaveErrors:
        """S: (N, o, n) what parameters of these names do alone, and slopes with what follows."""
        X = self.smooth.shifted(S, readings, names)
        each = self.moved.shape[1] // (2 * X.shape[2])
        following = self.smooth.following(len(self.smooth.harmonics) + each)
        G = self.sd * np.array(following.features(readings)).T
        taken = slopes @ self.moved
        return WaveErrors(taken, (X[:, :, :, None] * G[:, None, None]).reshape(taken.shape) - taken)


def scaled(waves: Sequence[FurtherWaves], factor: float) -> tuple[FurtherWaves, ...]:
    """With variances times a factor."""
    s = math.sqrt(factor)
    return tuple(replace(one, sd=s * one.sd, moved=s * one.moved) for one in waves)


def wave_errors(
    waves: Sequence[FurtherWaves],
    S: Array,
    slopes: Array,
    readings: Values,
    names: Sequence[str],
) -> WaveErrors:
    """Of all bodies, side by side."""
    none = np.zeros((*S.shape[:2], 0))
    each = [WaveErrors(none, none), *(one.errors(S, slopes, readings, names) for one in waves)]
    return WaveErrors(*(np.concatenate(parts, axis=2) for parts in zip(*each, strict=True)))


def vectors_for(poses: int) -> int:
    """How many vectors k are worth their cost for a number of poses.

    Few already predict what was not measured better, and say how sure that is.

    >>> [vectors_for(n) for n in (4, 30, 100, 300)]
    [0, 6, 12, 30]
    """
    return min(FEATURES if poses >= MANY_POSES else FEW, poses // POSES_EACH)


def harmonics(scales: Sequence[float], count: int = FEATURES) -> tuple[Harmonic, ...]:
    """The vectors k of largest weight for these length scales, the largest first.

    Fewer where the others have no weight beside rounding, as with a single joint.
    """
    largest = itertools.islice(_by_weight(scales), count)
    kept = [(k, weight) for k, weight in largest if weight > _ROUNDED]
    total = sum(weight for _, weight in kept)
    return tuple(Harmonic(k, math.sqrt(weight / total)) for k, weight in kept)


def _by_weight(scales: Sequence[float]) -> Iterator[tuple[tuple[int, ...], float]]:
    """Vectors k != 0 with their weights, one of k and -k, in falling order of weight."""
    n = len(scales)
    tables = [_weights(scale) for scale in scales]

    def weight(k: Sequence[int]) -> float:
        return math.prod(float(t[abs(o)]) for t, o in zip(tables, k, strict=True))

    start = (0,) * n
    waiting = [(-weight(start), start)]
    met = {start}
    while waiting:
        least, k = heapq.heappop(waiting)
        used = [d for d in range(n) if k[d]]
        # cos k.q and cos(-k).q are one wave: the first order that is not 0 stays positive.
        for signs in itertools.product((1, -1), repeat=max(0, len(used) - 1)):
            signed = dict(zip(used, (1, *signs), strict=False))
            if used:
                yield tuple(o * signed.get(d, 1) for d, o in enumerate(k)), -least
        for d in range(n):
            following = (*k[:d], k[d] + 1, *k[d + 1 :])
            if following not in met and following[d] < len(tables[d]):
                met.add(following)
                heapq.heappush(waiting, (-weight(following), following))


def _weights(scale: float) -> Any:
    """I_k(z) exp(-z) for k = 0, 1, ..., z = 1 / scale^2, by its integral over a turn."""
    # I_k(z) = (1/pi) int_0^pi exp(z cos t) cos(k t) dt; the trapezoidal rule converges
    # geometrically for periodic integrands, so 256 points are exact to rounding for k up to 40.
    t = np.arange(256) * (2.0 * np.pi / 256)
    z = 1.0 / scale**2
    return np.cos(np.outer(np.arange(40), t)) @ np.exp(z * (np.cos(t) - 1.0)) / 256
