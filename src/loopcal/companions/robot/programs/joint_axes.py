"""The joints of an arm as programs write them: degrees and millimetres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.tables.readers import Column


@dataclass(frozen=True, eq=False)
class JointAxes:
    """joints: name -> SI unit, from base to tip; columns: of tables, by joint; pose: the column of
    ids, if any; pulses: per degree or millimetre of each joint, for programs in pulses."""

    joints: Mapping[str, str]
    columns: Mapping[str, Column] = field(default_factory=dict)
    pose: str | int | None = "pose"
    pulses: tuple[float, ...] = ()

    @property
    def scale(self) -> Array:
        """(n,) SI per degree or millimetre."""
        return np.array([1e-3 if u == "m" else math.radians(1.0) for u in self.joints.values()])

    def pulses_each(self, name: str) -> Array:
        """(n,) pulses per degree or millimetre. Raises InputError, naming the program, where not
        every joint has them."""
        n, stated = len(self.joints), np.array(self.pulses, dtype=float)
        if len(stated) != n or not np.isfinite(stated).all() or (stated == 0.0).any():
            raise InputError(
                f"positions are in pulses, and {len(stated)} numbers of pulses are stated",
                code="missing-key",
                place=name,
                remedy=f"state those of all {n} joints, per degree: --pulses-per-degree N,N,...",
            )
        return stated
