"""What was understood, as the tables of a project file: instruments, columns, sensors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.mounted import NEAR, TURNED, Bodies, Mounted, see_points
from loopcal.files.outputs import relative
from loopcal.files.recognition.conditions import Conditions
from loopcal.files.recognition.converting import Reading, as_vector, readings_of, source_entry
from loopcal.files.recognition.fields import column_key, names_of
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.meanings import Meaning
from loopcal.files.recognition.robots import Robot
from loopcal.files.tables.registry import reader_of
from loopcal.files.toml.reader import SCHEMA
from loopcal.files.toml.writer import document
from loopcal.measurements.datasheet import PRESETS, Tracker, rounding_sd
from loopcal.mechanisms.placement import yaw_pitch_roll
from loopcal.mechanisms.structure.structured import MOUNTED
from loopcal.presentation.shown import significant, with_unit
from loopcal.units import from_si, to_si, unit
from loopcal.workflow.beginning.begun import HEAD, JOINTS, READINGS
from loopcal.workflow.beginning.searching import CLEARLY, Machine, Understood

SDS = " sd"
"""The end of the columns of sds in the file of converted readings."""
WIRE, CAMERA, TURN = 0.2e-3, 1e-3, 2e-3
"""Guesses of sds: a draw-wire encoder, a camera's position [m], its turns [rad]."""
_TRACKER = "leica-at500"
_POINTS = ("point", "spherical")
_NAMES = {
    "point": ("point", "point"),
    "planar": ("point", "point"),
    "pose": ("pose", "pose"),
    "length": ("wire", "draw-wire"),
    "spherical": ("tracker", "spherical"),
}
"""What an instrument of a kind is called in a project, and its type there."""
_LEVEL = 0.1
"""A fit finds smaller tilts [rad] of what reads x and y alone by itself."""
_EXPANDED = re.compile(r"u(nc|ncertainty)?(_?(95|exp|k_?2))?|expanded_uncertainty|messunsicherheit")
_SAME = 5e-3
"""Points of a body that lie so near [m] each other, found from the nominal machine, are one."""


@dataclass(frozen=True, eq=False)
class First:
    """The first files: their columns, and the sheet that was named."""

    fields: Fields
    sheet: str | None


@dataclass(frozen=True, eq=False)
class Statement:
    """A project ready to be written.

    tables: of the project file; remarks: name of a table -> comments above it; readings:
    quantity -> its column or values; converted: whether all go into a file of their own; fits:
    what the nominal machine misses, by instrument.
    """

    tables: Mapping[str, Any]
    remarks: Mapping[str, Sequence[str]]
    readings: Mapping[str, Reading]
    converted: bool
    fits: Mapping[str, Mounted]

    def remarked(self, section: str, *words: str) -> Statement:
        """With further comments on one of its sections."""
        further = {section: (*self.remarks.get(section, ()), *words)}
        return replace(self, remarks={**self.remarks, **further})

    @property
    def text(self) -> str:
        """Of the project file."""
        return document(self.tables, (HEAD,), self.remarks)


def stated(
    robot: Robot,
    machine: Machine,
    fields: Fields,
    understood: Understood,
    folder: Path,
    conditions: Conditions,
    first: First,
) -> Statement:
    """The project of what was understood.

    folder: where it will lie, for its paths; conditions: what is known of the poses beside the
    readings; first: the files as they are, for those of later days.
    """
    readings = {
        name: Reading(understood.joints[name], si, f, of)
        for name, f, si, of in zip(
            machine.joints, understood.layout.joints, machine.units, understood.units, strict=True
        )
    }
    looking: list[dict[str, Any]] = []
    seen: list[tuple[Meaning, tuple[str, ...]]] = []
    parameters: dict[str, Any] = {}
    fits: dict[str, Mounted] = {}
    noise: dict[str, Any] = {}
    guesses: list[str] = []
    _joint_noise(readings, noise, guesses)
    if robot.unread:
        noise[",".join(robot.unread)] = {"sd": math.inf}
        guesses.append(f"{', '.join(robot.unread)}: no sensor reads them.")
    several = len(understood.seen) > 1
    # A platform that never turns shows no place on it.
    still = bool(robot.unread) and not np.nanmax(np.ptp(understood.bodies.rotations, axis=0))
    places = _places(understood)
    stands: list[str] = []
    for number, (meaning, place) in enumerate(zip(understood.seen, places, strict=True), 1):
        end = f"_{number}" if several else ""
        instrument = _Instrument(meaning, end, place.target, place.station)
        looking.append(instrument.entry())
        fits[instrument.name] = meaning.fit or place.mounted
        mounted, at = place.mounted, place.at[: 0 if still else machine.dimension]
        if still and mounted.anchor is not None:
            # The target is held where the body is, so that the anchor is so much nearer.
            moved = mounted.anchor - understood.bodies.rotations[0] @ place.at
            mounted = replace(mounted, anchor=moved)
        if not still or mounted.anchor is not None:
            parameters |= instrument.parameters(mounted, at)
        columns = instrument.readings()
        seen.append((meaning, tuple(columns)))
        label = f" ({meaning.seen.station})" if meaning.seen.station else ""
        where = f"station {place.station}{label}"
        if mounted.anchor is not None:
            where = f"anchor {instrument.name}"
        stands.append(f"{', '.join(columns)}: target {place.target}, {where}")
        readings |= columns
        instrument.noise(columns, noise, guesses)
    point_of_robot = bool(robot.point) and [m.seen.kind for m in understood.seen] == ["point"]
    if point_of_robot:
        table = dict(robot.table)
        axes = zip(robot.point, "xyz", strict=True)
        drawn = robot.table.get("parameters", {})
        guesses_of_tool = {name: parameters[f"tool_{axis}"] for name, axis in axes}
        parameters = {n: v for n, v in guesses_of_tool.items() if n not in drawn}
    else:
        apart = robot.apart or robot
        table = {**apart.table, "instrument": looking}
        lengths = {n: {"value": 1e3 * v, "unit": "mm"} for n, v in apart.lengths.items()}
        parameters = {**lengths, **parameters}
    table |= conditions.table
    readings |= {
        name: Reading(to_si(field.values, of_column), unit(of_column).si, field, of_column)
        for name, (field, of_column) in conditions.columns.items()
    }
    converted = (
        any(r.field is None or r.field.computed for r in readings.values())
        or any(source.path is None for source in fields.sources)
        or any(meaning.seen.station for meaning in understood.seen)
    )
    data = _data(fields, readings, converted, folder)
    source = {}
    columns = {n: readings[n] for n in (*machine.joints, *conditions.columns)}
    # A single file is read as it stands.
    if converted or data[1:]:
        source = {"source": source_entry(first.fields, columns, seen, first.sheet)}
    remarks = {
        "mechanism": robot.remarks,
        "mechanism.parameters": ()
        if still or not parameters
        else (
            f"{', '.join(parameters)}: a guess, found by placing the nominal machine on the "
            f"readings; what is mounted is known to {with_unit(NEAR, 'm')} only (sd). Where a "
            f"drawing states it, write its values, with sd = {1e3 * MOUNTED['m']:g}.",
        ),
        "data": (
            *(*fields.remarks, *_inferred(understood), *understood.remarks, *_left_out(understood)),
            *conditions.remarks,
            *((f"Several instruments: {'; '.join(stands)}.",) if several else ()),
        ),
        "noise": tuple(guesses),
    }
    beginning = next((s.path.stem for s in fields.sources if s.path), "readings")
    title = f"{Path(str(table.get('file', table['type']))).stem}, {beginning}"
    tables = {
        "schema": SCHEMA,
        "title": title,
        "mechanism": {**table, "parameters": {**table.get("parameters", {}), **parameters}},
        "data": {**data[0], **({"join": data[1:]} if data[1:] else {}), **source},
        "noise": noise,
    }
    return Statement(tables, remarks, readings, converted, fits)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where an instrument stands and what it sees: names, how it was found, its target [m]."""

    station: str
    target: str
    mounted: Mounted
    at: Array


def _places(understood: Understood) -> list[_Place]:
    """One for each instrument.

    Points that fit from one place share a station. The same point of the body, seen from another,
    is the same target.
    """
    stations: list[list[Meaning]] = []
    joint: list[Mounted] = []
    for meaning in understood.seen:
        assert meaning.fit is not None
        for i, members in enumerate(stations):
            both = _together(understood.bodies, [*members, meaning])
            if both is not None:
                members.append(meaning)
                joint[i] = both
                break
        else:
            stations.append([meaning])
            joint.append(meaning.fit)
    places: dict[int, _Place] = {}
    for i, (members, mounted) in enumerate(zip(stations, joint, strict=True)):
        station = "base" if i == 0 else f"station_{i + 1}"
        for k, meaning in enumerate(members):
            at = mounted.targets[k]
            sightings = [
                p
                for other, p in ((m, places.get(id(m))) for m in understood.seen)
                if p is not None
                and p.station != station
                and (_reads_again(meaning, other) or _same(meaning, p, at))
            ]
            target = sightings[0].target if sightings else f"tool_{1 + len(places)}"
            places[id(meaning)] = _Place(
                station, target, mounted, sightings[0].at if sightings else at
            )
    if len({p.target for p in places.values()}) == 1:
        return [replace(places[id(m)], target="tool") for m in understood.seen]
    return [places[id(m)] for m in understood.seen]


def _together(bodies: Bodies, some: Sequence[Meaning]) -> Mounted | None:
    """Points placed together, None where they do not fit from one station."""
    if any(m.seen.kind not in _POINTS for m in some):
        return None
    try:
        both = see_points(bodies, np.array([m.position for m in some]))
    except InputError:  # they share no poses
        return None
    alone = float(np.sqrt(sum(m.fit.rms**2 for m in some if m.fit)))
    return both if both.rms <= CLEARLY * alone + _SAME else None


def _reads_again(meaning: Meaning, other: Meaning) -> bool:
    """Whether an instrument is another one in a further place: its columns are the same."""
    further, first = meaning.seen, other.seen
    return bool(further.station) and [f.heading for f in further.position] == [
        f.heading for f in first.position
    ]


def _same(meaning: Meaning, other: _Place, at: Array) -> bool:
    """Whether two points of the body are one: a reflector that two instruments see."""
    seen = meaning.seen.kind in _POINTS and other.mounted.turn is None
    return seen and bool(np.abs(at - other.at).max() < _SAME)


def _inferred(understood: Understood) -> tuple[str, ...]:
    """What no header states and the nominal machine decided."""
    joints = understood.layout.joints
    inferences = []
    if not all(f.unit for f in joints):
        inferences.append(understood.joint_words)
    for meaning in understood.seen:
        columns = (*meaning.seen.position, *meaning.seen.turned)
        if meaning.form or not all(f.unit for f in columns):
            inferences += meaning.words
    share = significant(100.0 * understood.share, 2)
    reason = f"with it the nominal machine misses the readings by {share} % of their spread"
    return (f"Inferred: {'; '.join(inferences)}: {reason}.",) if inferences else ()


def _left_out(understood: Understood) -> tuple[str, ...]:
    ignored = understood.layout.ignored
    words = [f"Columns that take no part: {names_of(ignored)}."] if ignored else []
    for f in ignored:
        if f.unit and unit(f.unit).si == "m" and _EXPANDED.fullmatch(f.stem):
            words.append(
                f"{f.label} may be the uncertainty of each point. Then write for each coordinate "
                f"sd_column = {f.label!r}, and coverage = 2 where it is expanded (k = 2)."
            )
    return tuple(words)


@dataclass(frozen=True, eq=False)
class _Instrument:
    """An instrument as a project states it."""

    meaning: Meaning
    end: str
    target: str
    station: str

    @property
    def kind(self) -> str:
        return self.meaning.seen.kind

    @property
    def name(self) -> str:
        return _NAMES[self.kind][0] + self.end

    def names(self) -> tuple[str, ...]:
        """Of its readings."""
        match self.kind:
            case "length":
                return (self.name,)
            case "spherical":
                return tuple(f"{self.name}_{w}" for w in ("range", "azimuth", "elevation"))
        axes = "xy" if self.kind == "planar" else "xyz"
        return tuple(f"{axis}{self.end}" for axis in axes)

    def numbers(self) -> tuple[str, ...]:
        """Names of the numbers of an orientation."""
        if self.kind != "pose":
            return ()
        usual = ("rvx", "rvy", "rvz") if as_vector(self.meaning) else ("qw", "qx", "qy", "qz")
        return tuple(f"{name}{self.end}" for name in usual)

    def entry(self) -> dict[str, Any]:
        kind = _NAMES[self.kind][1]
        made: dict[str, Any] = {"type": kind, "name": self.name, "target": self.target}
        if self.kind in ("point", "planar", "pose"):
            made |= {"station": self.station, "readings": list(self.names())}
        if self.kind == "spherical":
            made["station"] = self.station
        if self.kind == "pose":
            made["orientation"] = "rotation-vector" if as_vector(self.meaning) else "quaternion"
            made["columns"] = list(self.numbers())
        return made

    def parameters(self, mounted: Mounted, target: Array) -> dict[str, Any]:
        """Nominal values of what is mounted."""

        def length(value: float) -> dict[str, Any]:
            # Adding 0.0 makes 0.0 of -0.0.
            return {"value": round(1e3 * float(value), 1) + 0.0, "unit": "mm"}

        near = {"sd": 1e3 * NEAR}
        made = {f"{self.target}_{a}": length(v) | near for a, v in zip("xyz", target, strict=False)}
        if mounted.turn is not None:
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_matrix(mounted.turn).as_euler("ZYX", degrees=True)
            for motion, value in zip(("rz", "ry", "rx"), turned, strict=True):
                entry = {"value": round(float(value), 2) + 0.0, "unit": "deg"}
                entry["sd"] = float(significant(from_si(TURNED, "deg"), 2))
                made[f"{self.target}_{motion}"] = entry
        if mounted.stands is not None and len(target) == 3:
            # Alignment in its plane finds the rest.
            _, *tilts = yaw_pitch_roll(mounted.stands)
            if np.abs(tilts).max() > _LEVEL:
                made |= {
                    f"{self.station}_{motion}": {"value": round(np.degrees(a)) + 0.0, "unit": "deg"}
                    for motion, a in zip(("ry", "rx"), tilts, strict=True)
                }
        if mounted.anchor is not None:
            made |= {
                f"{self.name}_{a}": length(v) for a, v in zip("xyz", mounted.anchor, strict=True)
            }
            made[f"{self.name}_offset"] = length(mounted.zero)
        return made

    def readings(self) -> dict[str, Reading]:
        """Quantity -> its column, or converted values."""
        return readings_of(self.meaning, (*self.names(), *self.numbers()))

    def noise(
        self, columns: Mapping[str, Reading], noise: dict[str, Any], guesses: list[str]
    ) -> None:
        """Guesses of sds that the calibration learns; none where the file has them."""
        position = [columns[n] for n in self.names()]
        if all(r.sds is not None for r in position):
            names = ", ".join(self.names())
            guesses.append(
                f"The sds of {names} stand in columns of the file (sd_column above). For expanded "
                "uncertainties (k = 2) add coverage = 2 there, and to [[data.source.instrument]]."
            )
        else:
            sd, source = self._guess()
            shown = "mm" if sd > 1e-4 else "um"
            noise[",".join(self.names())] = (
                {"tracker": _TRACKER, "estimate": "group"}
                if self.kind == "spherical"
                else _entry(sd, "m", position, shown)
            )
            guesses.append(source)
        if self.kind == "pose":
            turns = ",".join(f"{self.name}_{w}" for w in ("wx", "wy", "wz"))
            noise[turns] = {"sd": 1e3 * TURN, "unit": "mrad", "estimate": "group"}

    def _guess(self) -> tuple[float, str]:
        if self.kind == "length":
            return WIRE, (
                f"{self.name}: a guess, {1e3 * WIRE:g} mm, 0.02 % of a wire of 1 m; the "
                "calibration learns it."
            )
        if self.kind == "pose":
            return CAMERA, (
                f"{self.name}: a guess, {1e3 * CAMERA:g} mm and {1e3 * TURN:g} mrad, usual of "
                "cameras; the calibration learns both."
            )
        ranges = np.sqrt(np.square(self.meaning.position).sum(axis=1))
        far = float(np.nanmedian(ranges))
        sd = float(Tracker.of(_TRACKER).transverse.at(np.array(far)))
        figure = PRESETS[_TRACKER].transverse
        return sd, (
            f"{', '.join(self.names())}: a guess, a laser tracker at {significant(far, 2)} m, half "
            f"the maximum permissible error of a Leica AT500 ({figure}); the calibration learns it."
        )


def _joint_noise(
    readings: Mapping[str, Reading], noise: dict[str, Any], guesses: list[str]
) -> None:
    for si, (sd, shown) in JOINTS.items():
        joints = {name: r for name, r in readings.items() if r.si == si}
        if joints:
            noise[",".join(joints)] = _entry(sd, si, list(joints.values()), shown)
            guesses.append(
                f"Joints: a guess, {from_si(sd, shown):g} {shown}, as of encoders with 17 bits per "
                "turn of the joint; the calibration learns it."
                if si == "rad"
                else f"Slides: a guess, {from_si(sd, shown):g} {shown}; the calibration learns it."
            )


def _entry(sd: float, si: str, readings: list[Reading], shown: str) -> dict[str, Any]:
    """An sd to be learnt, with the step to which the file rounds its readings."""
    steps = [r.field.resolution() * unit(r.unit).factor for r in readings if r.field]
    step = max(steps, default=0.0)
    # In quadrature half the sd adds 12 %, less than the guess is uncertain.
    if rounding_sd(step) <= 0.5 * sd:
        return {"sd": float(significant(from_si(sd, shown), 2)), "unit": shown, "estimate": "group"}
    unit_name = readings[0].unit
    rounded_sd = float(significant(from_si(sd, unit_name), 2))
    return {
        "sd": rounded_sd,
        "rounded_to": from_si(step, unit_name),
        "unit": unit_name,
        "estimate": "group",
    }


def _data(
    fields: Fields, readings: Mapping[str, Reading], converted: bool, folder: Path
) -> list[dict[str, Any]]:
    """A table for each file that holds readings."""
    if converted:
        # The unit in each name: columns of the user's files may be called as the quantities are.
        columns = {
            n: {"column": f"{n} [{r.si}]", "unit": r.si}
            | ({} if r.sds is None else {"sd_column": f"{n}{SDS}"})
            for n, r in readings.items()
        }
        return [{"file": READINGS, "pose": "pose", "columns": columns}]
    made = []
    used = {r.field.table for r in readings.values() if r.field}
    for number, source in enumerate(fields.sources):
        if number not in used or source.path is None:
            continue
        entry: dict[str, Any] = {"file": relative(source.path, folder)}
        if source.sheet is not None:
            entry[reader_of(source.path).part] = source.sheet
        several = len(used) > 1
        if several and fields.by_order:
            entry["pose"] = 0
        elif source.pose is not None:
            entry["pose"] = source.pose
        columns = {}
        for name, reading in readings.items():
            if reading.field is None or reading.field.table != number:
                continue
            column: dict[str, Any] = {
                "column": column_key(source.names, reading.field.position),
                "unit": reading.unit,
            }
            if reading.sds is not None:
                step = reading.sds.resolution()
                column["sd_column"] = column_key(source.names, reading.sds.position)
                if reading.sds.unit not in (None, reading.unit):
                    column["sd_unit"] = reading.sds.unit
                if step:
                    column["sd_at_least"] = float(significant(rounding_sd(step), 2))
            columns[name] = column
        made.append({**entry, "columns": columns})
    return made
