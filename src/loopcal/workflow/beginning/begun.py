"""A project as `init` understood it, ready to be written; also one before anything is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.document.findings import RegionRange
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.robots import Robot, by_hand
from loopcal.files.toml.reader import SCHEMA
from loopcal.files.toml.writer import document
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import GEOMETRY
from loopcal.presentation.shown import in_unit, unit_shown
from loopcal.statistics.region import ranges_of
from loopcal.units import from_si

PROJECT, READINGS = "project.toml", "readings.csv"
JOINTS = {"rad": (50e-6, "urad"), "m": (10e-6, "um")}
"""By unit of joints, a guess of their sd [SI] and the unit in which it is written: an encoder of 17
bits (2 pi / 2^17 = 48 urad), a linear scale."""
BEFORE = {"x": 50.0, "y": 0.0, "z": 100.0}
"""Where a target is taken to sit on the tool [mm] before it is measured: on the axis of the last
joint its turns could not be seen."""
SLIDE = (0.0, 0.5)
"""Where a sliding joint without limits is taken to move [m]; nothing says how long it is."""
_NO_LIMITS = (
    "[plan.ranges]: guesses, for nothing states limits: a quarter turn either way, 500 mm of a "
    "slide; write the real limits before you plan"
)
HEAD = "Written by loopcal init. Paths are relative to this file; change whatever is wrong."


@dataclass(frozen=True, eq=False)
class Begun:
    """What was understood: the tables of the project file, the files beside it, what was found in
    words, the readings, and in a line how many there are."""

    tables: Mapping[str, Any]
    beside: Mapping[str, bytes]
    remarks: tuple[str, ...]
    dataset: Dataset
    words: str

    @property
    def text(self) -> str:
        """Of the project file."""
        return document(
            self.tables, (HEAD,), {"data" if "data" in self.tables else "mechanism": self.remarks}
        )


def before_readings(robot: Robot, folder: Path) -> Begun:
    """A project without readings, to plan from: a point on the tool, seen by a laser tracker.

    Raises InputError for machines with closed loops: nothing says where their platform may go.
    """
    if robot.unread:
        raise by_hand(
            robot.table["type"],
            "has closed loops: nothing says where it may go before it is measured",
            "and plan from it: its [simulation.ranges] say where the machine may go",
        )
    robot = robot.apart or robot
    looking = {"type": "point", "name": "point", "target": "tool", "station": "base"}
    table = {**robot.table, "instrument": [{**looking, "readings": [*"xyz"]}]}
    mechanism = mechanism_from_data(dict(table), str(folder / PROJECT))
    lengths = {n: {"value": 1e3 * v, "unit": "mm"} for n, v in robot.lengths.items()}
    tool = {f"tool_{k}": {"value": v, "unit": "mm", "sd": 200.0} for k, v in BEFORE.items()}
    joints = {q: mechanism.quantities[q] for q in mechanism.joints}
    # A dataset has a pose: that of all joints at zero.
    zero = Dataset.from_arrays({q: np.zeros(1) for q in joints}, units=joints, poses=("zero",))
    ranges = {
        one.quantity: _guessed(one, joints[one.quantity])
        for one in ranges_of(mechanism, zero.readings, {})
        if one.source != "limits"
    }
    remarks = (
        *robot.remarks,
        "target on the tool, sds of the joints and of a laser tracker (x, y, z): guesses; write "
        "what you will measure with",
        *((_NO_LIMITS,) if ranges else ()),
    )
    tables = {
        "schema": SCHEMA,
        "title": Path(str(table.get("file", table["type"]))).stem,
        "mechanism": {**table, "parameters": {**lengths, **tool}},
        "noise": {**joint_noise(joints), "x,y,z": {"sd": 15.0, "unit": "um", "estimate": "group"}},
        **({"plan": {"ranges": ranges}} if ranges else {}),
    }
    words = f"{len(joints)} joints, no readings yet: choose the poses to measure"
    return Begun(tables, {}, remarks, zero, words)


def _guessed(one: RegionRange, si: str) -> dict[str, Any]:
    """[plan.ranges] of a joint without limits; si: its unit."""
    ends = (one.low, one.high) if one.source == "turn" else SLIDE
    low, high = (in_unit(end, si) for end in ends)
    return {"from": low, "to": high, "unit": unit_shown(si)}


def drawn(mechanism: Mechanism, length: float, twist: float, zero: float) -> dict[str, Any]:
    """[parameters]: how well the drawing states an arm's own ones, as sds [mm, mrad, mrad]."""
    sds = {"length": (length, "mm"), "zero": (zero, "mrad")}
    entries = {}
    for p in mechanism.parameters:
        # What was held beside free ones stays beside stated ones: each has its sd.
        if p.role in GEOMETRY and p.role != "scale":
            sd, of = sds.get(p.role, (twist, "mrad") if p.unit == "rad" else sds["length"])
            if p.unit == "m":
                sd, of = length, "mm"
            value = float(from_si(np.array(p.nominal), of))
            entries[p.name] = {"value": value, "unit": of, "sd": sd}
    return entries


def joint_noise(joints: Mapping[str, str]) -> dict[str, Any]:
    """[noise] of joints, name -> SI unit: a guess for those of a kind, which is learnt."""
    noise = {}
    for si, (sd, of) in JOINTS.items():
        if names := [name for name, kind in joints.items() if kind == si]:
            value = float(from_si(np.array(sd), of))
            noise[",".join(names)] = {"sd": round(value, 6), "unit": of, "estimate": "group"}
    return noise
