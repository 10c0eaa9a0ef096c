"""A robot with every way to read the columns on it, in the convention that fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopcal.errors import InputError
from loopcal.files.recognition.conditions import Conditions, apart
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.layouts import Layout, layouts, with_points_for_turns
from loopcal.files.recognition.robots import CONVENTIONS, Robot
from loopcal.measurements.checks import refuse_lost
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.masses import in_space
from loopcal.presentation.shown import significant
from loopcal.workflow.beginning.begun import PROJECT
from loopcal.workflow.beginning.counting import percent
from loopcal.workflow.beginning.searching import (
    CLEARLY,
    PLAUSIBLE,
    Machine,
    Understood,
    every_way,
    machine_of,
)
from loopcal.workflow.beginning.understanding import USUAL as NEAR_ENOUGH


@dataclass(frozen=True, eq=False)
class Readable:
    """A robot with every way to read the columns on it, the best first."""

    robot: Robot
    machine: Machine
    fields: Fields
    conditions: Conditions
    layouts: Sequence[Layout]
    ways: list[Understood]

    @property
    def share(self) -> float:
        return self.ways[0].share if self.ways else np.inf

    def better_than(self, classical: Readable) -> Readable:
        """With a sentence on why the table is read in this convention."""
        words = (
            "The table states no convention. In the modified one the nominal machine misses the "
            f"readings by {significant(100 * self.share, 2)} % of their spread, in the classical "
            f"one by {significant(100 * classical.share, 2)} %."
        )
        robot = replace(self.robot, remarks=(*self.robot.remarks, words))
        return replace(self, robot=robot)


def in_the_better_convention(
    robot: Robot, fields: Fields, columns: tuple[Field, ...], folder: Path
) -> Readable:
    """The robot as its file states it, or in the other convention where the file states none.

    Raises InputError where only the convention that the file does not state fits.
    """
    one = readable(robot, fields, columns, folder)
    enough = PLAUSIBLE if robot.convention else NEAR_ENOUGH
    if robot.otherwise is None or one.share <= enough:
        return one
    other = readable(robot.otherwise, fields, columns, folder)
    if not (CLEARLY * other.share < one.share and other.share < 1.0):  # both explain nothing
        return one
    if not robot.convention:
        return other.better_than(one)
    if other.share <= PLAUSIBLE:
        raise _of_the_other_convention(robot.convention, one, other)
    return one


def _of_the_other_convention(stated: str, one: Readable, other: Readable) -> InputError:
    (better,) = {*CONVENTIONS.values()} - {stated}
    return InputError(
        f"the robot's table states the {stated} convention of Denavit and Hartenberg, but is of "
        f"the {better} one: so the nominal machine misses the readings by {percent(other.share)} "
        f"of their spread, as stated by {percent(one.share)}",
        code="implausible-readings",
        remedy="correct the convention: in a table the headers a and alpha leave it open, a_i-1 "
        "and alpha_i-1 state the modified one; in a mechanism file each joint has a form, "
        '"dh" or "mdh"',
    )


def readable(robot: Robot, fields: Fields, columns: tuple[Field, ...], folder: Path) -> Readable:
    """The robot with every way to read the columns on it.

    Raises InputError for points of an instrument that read 0, 0, 0 in some rows.
    """
    machine = machine_of(robot, str(folder / PROJECT))
    fields, conditions = apart(fields, robot.names, arm=in_space(machine.mechanism))
    every_layout = layouts(fields.fields, robot.joints, robot.names, columns)
    _refuse_zeros(every_layout, fields)
    ways = sorted(every_way(machine, every_layout), key=lambda u: u.share)
    if not (ways and ways[0].share <= PLAUSIBLE):
        others = tuple(o for one in every_layout if (o := with_points_for_turns(one)))
        further = sorted(every_way(machine, others), key=lambda u: u.share)
        if further and further[0].share <= PLAUSIBLE:
            every_layout, ways = others, further
    return Readable(robot, machine, fields, conditions, every_layout, ways)


def _refuse_zeros(some: Sequence[Layout], fields: Fields) -> None:
    """Raise InputError for points of an instrument that read 0, 0, 0 in some rows."""
    for seen in {id(s): s for layout in some for s in layout.seen}.values():
        if len(seen.position) == 3:
            readings = {f.label: f.values for f in seen.position}
            lost = np.all([f.values == 0.0 for f in seen.position], axis=0)
            if lost.any() and not lost.all() and len(readings) == 3:
                dataset = Dataset.from_arrays(readings, poses=fields.poses)
                gone = ",".join(dataset.poses[i] for i in np.flatnonzero(lost))
                try:
                    refuse_lost(dataset, list(readings), lost, "or leave these poses out")
                except InputError as error:
                    raise error.offering("--exclude", gone) from None
