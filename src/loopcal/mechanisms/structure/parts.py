"""What the structured model error of a mechanism consists of."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.mechanisms.structure.sag import Column, Sag
from loopcal.mechanisms.structure.smooth import Smooth


@dataclass(frozen=True)
class Structure:
    """sag: the arm that gives way, by these columns, None where it does not; smooth: what its
    discrepancy is made of; joints: those with harmonics.
    """

    sag: Sag | None = None
    columns: tuple[Column, ...] = ()
    smooth: Smooth | None = None
    joints: tuple[str, ...] = ()
