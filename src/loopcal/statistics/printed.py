"""What the points of prints leave open beside the parameters of a machine.

Offsets d of points follow the error dp of the parameters and err besides, by F dp + R u with u of
sd 1 (`PrintedEntry`, R = [U V]). Parameters and offsets together have the covariance

    (1 + F) C (1 + F)^T + R R^T,

F with rows at the offsets, C that of the parameters. So J of all at a reading is J (1 + F) of the
parameters, and J R of what the offsets leave open besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import PrintedEntry
from loopcal.small_samples import LearntCovariance


@dataclass(frozen=True, eq=False)
class Offsets:
    """Among n parameters: follow: F (n, n); root: R (n, k); prior_sd: (n,) of the offsets, inf of
    all others."""

    follow: Array
    root: Array
    prior_sd: Array

    @classmethod
    def of(cls, entry: PrintedEntry, names: Sequence[str], estimated: Sequence[str]) -> Offsets:
        """names: of all parameters, offsets among them; estimated: those that they follow."""
        place = {name: i for i, name in enumerate(names)}
        rows, n = np.array([place[name] for name in entry.names], dtype=np.intp), len(names)
        follow, prior_sd = np.zeros((n, n)), np.full(n, np.inf)
        columns = np.array([place[name] for name in estimated], dtype=np.intp)
        follow[np.ix_(rows, columns)] = entry.follow
        prior_sd[rows] = entry.prior
        points = [name.rpartition("_")[0] for name in entry.names]
        number = {point: i for i, point in enumerate(dict.fromkeys(points))}
        alone = np.zeros((len(points), len(number), 3))
        alone[np.arange(len(points)), [number[point] for point in points]] = entry.alone
        root = np.zeros((n, len(entry.together) + alone[0].size))
        root[rows, : len(entry.together)] = np.array(entry.together).reshape(-1, len(points)).T
        root[rows, len(entry.together) :] = alone.reshape(len(points), -1)
        return cls(follow, root, prior_sd)

    @property
    def carried(self) -> Array:
        """1 + F."""
        return np.asarray(np.eye(len(self.follow)) + self.follow)

    def beside(self, covariance: LearntCovariance) -> LearntCovariance:
        """Of parameters and offsets, from that of the parameters."""
        part = self.root @ self.root.T
        added = LearntCovariance(part, part, np.zeros((len(covariance.slopes), *part.shape)))
        return covariance.through(self.carried).plus(added)

    def through(self, M: Array) -> Offsets:
        """Of another description, whose parameters change by M (m, n) with these; each offset of
        it is one of these."""
        same = np.abs(M) > 0.0
        prior_sd = np.where(same, self.prior_sd, np.inf).min(axis=1, initial=np.inf)
        return Offsets(M @ self.follow @ np.linalg.pinv(M), M @ self.root, prior_sd)
