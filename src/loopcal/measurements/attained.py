"""Poses that a robot was commanded to and attained, cycle after cycle."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.arrays import Array


@dataclass(frozen=True, eq=False)
class AttainedPoses:
    """One row per measurement; all arrays have N rows.

    pose, cycle, direction, block: ids of the commanded pose, of the cycle, of the direction of
    approach and of the block of cycles for drift. The last two are None where no column holds them.
    conditions: column header -> value per row (payload, speed). commanded, measured: positions
    (N, 3) [m]; commanded_turns, measured_turns: rotation matrices (N, 3, 3), None without
    orientations; time: (N,) [s], None without. notes: what a reader must know of how the table
    was understood. planar: only x and y were commanded and measured; z is 0.
    """

    file: str
    pose: tuple[str, ...]
    cycle: tuple[str, ...]
    commanded: Array
    measured: Array
    commanded_turns: Array | None = None
    measured_turns: Array | None = None
    direction: tuple[str, ...] | None = None
    block: tuple[str, ...] | None = None
    time: Array | None = None
    conditions: dict[str, tuple[str, ...]] | None = None
    notes: tuple[str, ...] = ()
    planar: bool = False

    def __len__(self) -> int:
        return len(self.pose)
