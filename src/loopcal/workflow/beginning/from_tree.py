"""A project of a whole robot: its tree of bodies, and what was observed between any two of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.estimation.mounted import bodies_of, see_points
from loopcal.estimation.problem.alignment import align
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.dh_table import Row, read_dh
from loopcal.files.recognition.fields import Field, Source, in_si, taken_in
from loopcal.files.recognition.joint_sets import named_joints
from loopcal.files.recognition.observations import Observation, observations
from loopcal.files.recognition.robots import joint_table
from loopcal.files.recognition.sources import sources_of
from loopcal.files.tables.readers import read_table
from loopcal.files.tables.writer import table_bytes
from loopcal.files.toml.reader import SCHEMA
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.frame import ChainFrame, matrices
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.statistics.choice import FOLDS
from loopcal.workflow.beginning.begun import PROJECT, READINGS, Begun, drawn, joint_noise
from loopcal.workflow.beginning.tree_images import Eyes, Pictures, see, sources_and_pictures

GUESSED = {"m": (0.1, "mm"), "rad": (0.5, "mrad"), "px": (0.3, "px")}
"""Where the learning of the sds of observations begins, gaps of things that touch among them."""
DRAWN_MM, DRAWN_MRAD = 2.0, 5.0
"""How far a robot is from its drawing, as sds: what stands between two hands tells some directions
apart by nothing else. Chosen: twice and more what arms of many makers are off by."""
MOUNTED_MM = 200.0
"""How far a target is from the origin of its body where no drawing says, as an sd: as of an arm's
tool."""
LARGE = 30_000
"""Parameters times poses from which one method is begun with. Chosen by one robot of two
arms: at 31,500 comparing all took more than 9.5 minutes on two cores, one method one minute."""
DENIED = 3.0
"""A target that takes up this many sds of the drawing, beside an unplaced one, sits elsewhere."""
NOWHERE = 1e-9
"""A body this near its parent's origin [m] is only turned. It says nothing of a target."""
SAME_PLACE = {"rad": 5e-3, "m": 5e-3}
"""Poses that are no farther apart in any joint are one place that was approached again."""
PLACE = "place"


@dataclass(eq=False)
class _Rows:
    """The poses of all files, one below the other: ids, and columns by quantity."""

    poses: list[str] = field(default_factory=list)
    columns: dict[str, list[Array]] = field(default_factory=dict)
    count: int = 0

    def add(self, ids: Sequence[str], columns: Mapping[str, Array]) -> None:
        """The poses of one file; what it does not have is blank."""
        for name in {**self.columns, **columns}:
            ahead = self.columns.setdefault(name, [np.full(self.count, np.nan)])
            ahead.append(columns.get(name, np.full(len(ids), np.nan)))
        self.poses += ids
        self.count += len(ids)

    def values(self, name: str) -> Array:
        """A column (N,), blank where no file has it."""
        return np.concatenate(self.columns.get(name, [np.full(self.count, np.nan)]))


def from_tree(
    entries: Sequence[Any],
    robot: Mapping[str, Any],
    looking: Sequence[Observation],
    folder: Path,
    remarks: tuple[str, ...] = (),
) -> Begun:
    """`init` of a robot of several bodies.

    robot: the [mechanism] table without instruments (`urdf_table`, `dh_table`); looking: what was
    observed; folder: where the project will lie. Raises InputError where something remains open.
    """
    typed = looking
    looking = [replace(one, table=_with_readings(one)) for one in looking]
    table = {**robot, "instrument": [dict(one.table) for one in looking]}
    mechanism = mechanism_from_data(dict(table), str(folder / PROJECT))
    sources, pictures = sources_and_pictures(entries)
    eyes, pixels = _seen_by_cameras(looking, pictures, mechanism, robot.get("units", {}))
    if eyes.instruments:
        looking = [one for one in looking if one.table["type"] != "camera"]
        looking += [Observation(instrument) for instrument in eyes.instruments]
        table["instrument"] = [dict(one.table) for one in looking]
        mechanism = mechanism_from_data(dict(table), str(folder / PROJECT))
    rows, words = _rows(sources, mechanism, looking, pixels)
    words += eyes.words
    used = [q for q in (*mechanism.quantities, *mechanism.pose_constants) if q in rows.columns]
    _refuse_unobserved(mechanism, rows, looking)
    units = {**mechanism.quantities, **mechanism.pose_constants}
    readings = {q: rows.values(q) for q in used}
    places = _places(mechanism, readings)
    facing, begun = _facing(mechanism, looking, readings)
    table["instrument"] = [{**one.table, **facing.get(one.name, {})} for one in looking]
    sitting, said = _sitting(mechanism, looking, readings)
    stated = drawn(mechanism, DRAWN_MM, DRAWN_MRAD, DRAWN_MRAD)
    guessed = stated | eyes.parameters | sitting | begun
    table["parameters"] = guessed | dict(robot.get("parameters", {}))
    words += said
    tables: dict[str, Any] = {
        "schema": SCHEMA,
        "title": " and ".join(dict.fromkeys(s.path.stem if s.path else s.name for s in sources)),
        "mechanism": table,
        "data": {
            "file": READINGS,
            "pose": "pose",
            "columns": {q: {"column": q, "unit": units[q]} for q in used if units[q] != "1"},
            "observe": [one.text for one in typed if one.text],
        },
        "noise": _noise(mechanism, used, eyes.noise),
    }
    fit: dict[str, Any] = {}
    open_ones = sum(not p.fixed for p in mechanism.parameters)
    if open_ones * rows.count > LARGE:
        fit["method"] = "implicit-loop"
        words += (
            f"{open_ones} parameters and {rows.count} poses: the method is implicit-loop, which "
            "takes a minute or two; delete the line to compare methods and model errors, which "
            "takes ten or more",
        )
    repeated = len(places) - len(set(places))
    if repeated:
        fit["validation"] = {"folds": FOLDS, "group": PLACE}
        words += (
            f"{len(set(places))} places, some approached again: validation leaves out whole places",
        )
    elif fit:  # auto validates by itself
        fit["validation"] = {"folds": FOLDS}
    if fit:
        tables["fit"] = fit
    columns: dict[str, Any] = {"pose": rows.poses, **readings, PLACE: places}
    beside = {READINGS: table_bytes(columns, ".csv")}
    dataset = Dataset.from_arrays(readings, units={q: units[q] for q in used}, poses=rows.poses)
    count = f"{rows.count} poses with {listed([one.name for one in looking], 8)}"
    return Begun(tables, beside, (*remarks, *words), dataset, count)


def later_rows(entries: Sequence[Any], mechanism: Mechanism, observe: Sequence[str]) -> Dataset:
    """Readings of another day: files in the layout of the first ones, perhaps of one arm alone.

    observe: what was observed, as typed at `init`. What a file does not hold was not read there.
    Raises InputError as `from_tree` does.
    """
    looking = [
        replace(one, table=_with_readings(one))
        for one in observations(observe)
        if one.table["type"] != "camera"
    ]
    sources = [source for i, entry in enumerate(entries) for source in sources_of(entry, i)]
    rows, _ = _rows(sources, mechanism, looking, {})
    units = {**mechanism.quantities, **mechanism.pose_constants}
    seen = [q for one in mechanism.families for q in one.readings]
    names = dict.fromkeys((*mechanism.joints, *seen, *rows.columns))
    readings = {q: rows.values(q) for q in names}
    return Dataset.from_arrays(readings, units={q: units[q] for q in names}, poses=rows.poses)


def urdf_table(relative: str, root: str | None) -> dict[str, Any]:
    """The [mechanism] of a URDF by its path in the project; its leaves are those observed."""
    return {"type": "tree", "file": relative, **({"root": root} if root else {})}


def dh_table(path: Path, root: str | None) -> tuple[dict[str, Any], tuple[str, ...]] | None:
    """The [mechanism] of a table with a column of bodies and one of their parents, and remarks.

    None where the table has no such columns.
    """
    table = read_dh(path)
    if not all(row.body and row.parent for row in table.rows):
        return None
    parents = {row.parent for row in table.rows} - {row.body for row in table.rows}
    if root is None and len(parents) != 1:
        raise InputError(
            f"the bodies hang on {listed(sorted(parents), 5)}"
            if parents
            else "no body is the root",
            code="invalid-value",
            place=path.name,
            remedy="let all hang on one root in the end, or name it: --base ROOT",
        )
    moved = {row.parent for row in table.rows if row.kind != "fixed"}
    bodies = [_body(row, last=row.body not in moved) for row in table.rows]
    made = {"type": "tree", "root": root or min(parents), "body": bodies}
    return {**made, "units": {"length": "mm", "angle": "deg"}}, table.remarks


def _body(row: Row, *, last: bool) -> dict[str, Any]:
    fixed = row.kind == "fixed"
    turning = replace(row, kind="revolute") if fixed else row
    joint = joint_table(row.body if fixed else row.name, turning, last=last or fixed, ahead={})
    body = {"name": row.body, "parent": row.parent, "row": joint}
    return {**body, "fixed": True} if fixed else body


def _with_readings(one: Observation) -> dict[str, Any]:
    """The table of an instrument whose readings are named after it: several may be of one kind."""
    table = dict(one.table)
    if table["type"] == "camera":
        table["points"] = {"0": [0.0, 0.0, 0.0]}  # until the files say which there are
    if table["type"] not in ("camera", "contact", "held-part", "inclinometer"):
        table.setdefault("target", f"{one.name}_target")
    if table["type"] in ("point", "pose") and "readings" not in table:
        table["readings"] = [f"{one.name}_{axis}" for axis in "xyz"]
    if table["type"] == "pose" and "columns" not in table:
        table["columns"] = [f"{one.name}_{part}" for part in ("qw", "qx", "qy", "qz")]
    return table


def _seen_by_cameras(
    looking: Sequence[Observation],
    pictures: Sequence[Pictures],
    mechanism: Mechanism,
    units: Mapping[str, str],
) -> tuple[Eyes, dict[int, dict[str, Array]]]:
    """What cameras saw, and its pixels by the number of the table of poses."""
    eyes, pixels = Eyes(taken=tuple(one.name for one in looking)), dict[int, dict[str, Array]]()
    families = {family.name: family for family in mechanism.families}
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    assert mechanism.tree is not None
    cameras = [one for one in looking if one.table["type"] == "camera"]
    for one in cameras:
        family = families[one.name]
        mine = [p for p in pictures if p.is_of(one)]
        for picture in mine:
            source = picture.source
            joints = _joints(source, mechanism, looking)
            if missing := sorted(_reach(mechanism, family) - joints.keys()):
                raise InputError(
                    f"no column holds the joint {missing[0]!r} between "
                    f"{family.on!r} and {family.against!r}",
                    code="missing-column",
                    place=source.name,
                    remedy="name the columns of joints that have other names in the file: "
                    f"joints={','.join(f'{joint}:COLUMN' for joint in missing)}; "
                    f"its columns are {listed([f.label for f in source.fields], 30)}",
                )
            seen = (family.on, family.against)
            board, eye = seen[::-1] if "on" in one.table else seen
            # What might carry the board instead, or the camera where the board is on the ground.
            key = "sees" if "sees" in one.table else "on"
            others = dict.fromkeys(other.table.get(key, eye) for other in cameras)
            pairs = {body: (body, eye) if key == "sees" else (board, body) for body in others}
            paths = {b: mechanism.tree.path(*pair) for b, pair in pairs.items() if len({*pair}) > 1}
            readings = in_si(joints, mechanism.joints)
            moving = {
                body: matrices(ChainFrame(path, readings, nominal), len(source))
                for body, path in paths.items()
                if {step.joint for step in path if step.joint} <= readings.keys()
            }
            pixels.setdefault(id(source), {}).update(see(eyes, one, picture, moving, units))
        if not mine:
            raise InputError(
                f"no file holds corners of what {one.name!r} sees",
                code="no-data",
                place="--observe",
                remedy=_seen_in(pictures),
            )
    for picture in pictures:
        if not any(picture.is_of(one) for one in cameras):
            raise InputError(
                "no observation is of these corners",
                code="missing-key",
                place=picture.files.corners.file,
                remedy="name the bodies that carry camera and board: "
                "--observe 'camera on=BODY sees=BODY', or leave the file out",
            )
    return eyes, pixels


def _seen_in(pictures: Sequence[Pictures]) -> str:
    """What to do where none of these files holds what a camera sees."""
    if not pictures:
        return "name a folder with corners, boards and a table of poses, or these files"
    tables = [picture.files.corners for picture in pictures]
    cameras = dict.fromkeys(name for table in tables for name in table.cameras)
    boards = dict.fromkeys(name for table in tables for name in table.boards)
    return (
        f"name what is there: camera={listed(list(cameras), 10)}, board={listed(list(boards), 10)}"
    )


def _rows(
    sources: Sequence[Source],
    mechanism: Mechanism,
    looking: Sequence[Observation],
    pixels: Mapping[int, Mapping[str, Array]],
) -> tuple[_Rows, tuple[str, ...]]:
    """The poses of all files, and what was read in which, in words.

    pixels: by the identity of a source, those of its rows.
    """
    rows, words = _Rows(), list[str]()
    families = {family.name: family for family in mechanism.families}
    units = {**mechanism.quantities, **mechanism.pose_constants}
    several = len(sources) > 1
    for source in sources:
        joints = _joints(source, mechanism, looking)
        read: dict[str, Field] = {}
        seen: dict[str, Array] = {}
        for one in looking:
            family = families[one.name]
            if one.table["type"] == "camera":
                mine = pixels.get(id(source), {})
                seen |= {q: mine[q] for q in family.readings if q in mine}
            elif one.of_file(source.path) and _reach(mechanism, family) <= joints.keys():
                columns = _columns(source, one, family, mechanism)
                if columns is not None:
                    read |= columns
                    seen |= _seen(columns, _where(source, one), family, mechanism)
        if not seen:
            raise InputError(
                "no observation stands in this file",
                code="missing-column",
                place=source.name,
                remedy="name it: --observe 'point on=BODY columns=x,y,z', or leave the file out; "
                f"its joints are {listed(list(joints), 30)}"
                if joints
                else "its columns are named "
                f"as no joint of the robot: joints are {listed(list(mechanism.joints), 30)}",
            )
        by_joint = in_si(joints, mechanism.joints)
        any_seen = np.any([np.isfinite(v) for v in seen.values()], axis=0)
        ids = source.ids or tuple(str(i) for i in range(1, len(source) + 1))
        stem = source.path.stem if source.path else source.name
        kept = np.flatnonzero(any_seen)
        rows.add(
            [f"{stem}:{ids[i]}" if several else ids[i] for i in kept],
            {name: v[kept] for name, v in {**by_joint, **seen}.items()},
        )
        met = [o.name for o in looking if any(q in seen for q in families[o.name].readings)]
        words.append(f"{source.name}: {len(kept)} poses with {listed(met, 8)}")
        for what, some in (("joints", joints), ("readings", read)):
            unstated = {q: f for q, f in some.items() if f.unit is None and units[q] != "1"}
            if unstated:
                taken = " and ".join(taken_in(unstated, units).values())
                words.append(f"{source.name}: {what} without a unit are taken in {taken}")
    return rows, tuple(words)


def _reach(mechanism: Mechanism, family: Family) -> set[str]:
    """The joints between the two bodies of an observation."""
    assert mechanism.tree is not None
    path = mechanism.tree.path(family.on, family.against)
    return {step.joint for step in path if step.joint}


def _joints(
    source: Source, mechanism: Mechanism, looking: Sequence[Observation]
) -> dict[str, Field]:
    """The joints that a file has columns for: those stated, and others by their names.

    Beside stated ones a name counts as it is written: r2 is not the joint R2.
    """
    stated: dict[str, Field] = {}
    for one in looking:
        columns = (one.joints or {}) if one.of_file(source.path) else {}
        by_column = named_joints(source.fields, columns.values())
        stated |= {
            joint: by_column[column]
            for joint, column in columns.items()
            if column in by_column and joint in mechanism.joints
        }
    named = named_joints(source.fields, mechanism.joints)
    if stated:
        named = {
            j: f for j, f in named.items() if f.label.startswith(j) and f not in stated.values()
        }
    return named | stated


def _columns(
    source: Source, one: Observation, family: Family, mechanism: Mechanism
) -> dict[str, Field] | None:
    """The columns of what an observation reads; None where the file does not have them."""
    constants = [c for c in mechanism.pose_constants if c.startswith(f"{one.name}_")]
    silent = [q for q in family.readings if q in mechanism.implied]
    spoken = [q for q in (*family.readings, *constants) if q not in silent]
    names = one.columns or tuple(spoken)
    if len(names) != len(spoken):
        raise InputError(
            f"{one.name!r} reads {len(spoken)} values, but {len(names)} columns are named",
            code="wrong-shape",
            place="--observe",
            remedy=f"name them in this order: {listed(spoken, 12)}",
        )
    fields = named_joints(source.fields, names)
    if absent := [name for name in names if name not in fields]:
        if one.columns and one.file:
            raise InputError(
                f"{source.name} has no column {absent[0]!r}",
                code="missing-column",
                place="--observe",
                remedy=f"its columns are {listed([f.label for f in source.fields], 30)}",
            )
        return None
    return {q: fields[name] for q, name in zip(spoken, names, strict=True)}


def _seen(
    columns: Mapping[str, Field], chosen: Any, family: Family, mechanism: Mechanism
) -> dict[str, Array]:
    """The readings of an observation in the chosen rows of a file, gaps of what touches as 0."""
    units = {**mechanism.quantities, **mechanism.pose_constants}
    silent = [q for q in family.readings if q in mechanism.implied]
    seen = {q: np.where(chosen, v, np.nan) for q, v in in_si(columns, units).items()}
    complete = np.all([np.isfinite(v) for v in seen.values()], axis=0) if seen else chosen
    return seen | {q: np.where(complete, 0.0, np.nan) for q in silent}


def _where(source: Source, one: Observation) -> Any:
    """The rows in which an observation was made."""
    if one.where is None:
        return np.ones(len(source), dtype=bool)
    label, value = one.where
    column = next((f for f in source.fields if label in (f.label, f.stem)), None)
    cells: Sequence[str]
    if column is not None:
        cells = [column.words(float(v)) for v in column.values]
    else:
        cells = _texts(source, label)
    return np.array([fnmatchcase(cell, value) for cell in cells])


def _texts(source: Source, label: str) -> Sequence[str]:
    """The cells of a column of words."""
    table = None if source.path is None else read_table(source.path)
    if table is None or label not in table.names or len(table.rows) != len(source):
        names = [f.label for f in source.fields] if table is None else list(table.names)
        raise InputError(
            f"{source.name} has no column {label!r} with a cell in each row",
            code="missing-column",
            place="--observe",
            remedy=f"its columns are {listed(names, 30)}",
        )
    return table.ids(table.names.index(label))


def _refuse_unobserved(mechanism: Mechanism, rows: _Rows, looking: Sequence[Observation]) -> None:
    for family in mechanism.families:
        if not any(q in rows.columns for q in family.readings):
            one = next(o for o in looking if o.name == family.name)
            needed = sorted(_reach(mechanism, family))
            raise InputError(
                f"no file holds {family.name!r} and the joints between "
                f"{family.on!r} and {family.against!r}: {listed(needed, 20)}",
                code="missing-column",
                place="--observe",
                remedy="name its columns, columns=x,y,z, and those of joints with other names, "
                "joints=S2:S,L2:L"
                if not one.columns
                else "name the columns of joints that have "
                "other names in the file: joints=S2:S,L2:L",
            )


def _places(mechanism: Mechanism, readings: Mapping[str, Array]) -> Array:
    """(N,) a number for each place: poses whose joints all but agree, seen in the same joints."""
    joints = [q for q in mechanism.joints if q in readings]
    x = np.array([readings[q] / SAME_PLACE[mechanism.joints[q]] for q in joints]).T
    unread = np.isnan(x)
    # What is unread is far from all that is read, and equal to itself.
    x = np.where(unread, 1e9, x)
    places = np.full(len(x), -1.0)
    for i in range(len(x)):
        if places[i] < 0.0:
            near = (np.abs(x[i:] - x[i]) <= 1.0).all(axis=1) & (places[i:] < 0.0)
            places[i:][near] = i
    return np.asarray(np.unique(places, return_inverse=True)[1] + 1.0)


def _sitting(
    mechanism: Mechanism, looking: Sequence[Observation], readings: Mapping[str, Array]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """State targets and centres of balls for which the drawing has a body.

    Such a body has no joint and a stated place on its parent. Poses that hardly turn a hand cannot
    separate its target from the station, so the drawing decides. Returns the entries of
    [parameters], and what they mean in words.
    """
    assert mechanism.tree is not None
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    families = {family.name: family for family in mechanism.families}
    bodies: dict[str, str] = {}
    # Of these, poses that hardly turn a hand leave the target open by hundreds of metres.
    seen = {one.table.get("target") for one in looking if one.table["type"] != "contact"}
    for one in looking:
        family, target = families[one.name], one.table.get("target")
        if one.table["type"] == "contact":
            bodies[one.table.get("centre", f"{one.name}_2")] = family.against
            target = target or f"{one.name}_1"
        if target:
            bodies[target] = family.on if _as_drawn(mechanism, family, readings) else ""
    entries: dict[str, Any] = {}
    words = []
    for target, body in bodies.items():
        link = mechanism.tree.links.get(body)
        names = [f"{target}_{axis}" for axis in "xyz"]
        if not nominal.keys() >= {*names}:
            continue
        if target in seen:
            entries |= {name: {"value": 0.0, "unit": "mm", "sd": MOUNTED_MM} for name in names}
        if link is None or any(step.joint for step in link.steps):
            continue
        if np.abs(bodies_of(ChainFrame(link.steps, {}, nominal), 1).origins).max() > NOWHERE:
            entries |= {name: {"value": 0.0, "unit": "mm", "sd": DRAWN_MM} for name in names}
            words.append(
                f"{target} is at the origin of {body!r} within {DRAWN_MM:g} mm, as drawn; if it "
                f"sits elsewhere on that body, delete {listed(names, 3)} below"
            )
    return entries, tuple(words)


def _facing(
    mechanism: Mechanism, looking: Sequence[Observation], readings: Mapping[str, Array]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Where each touched plane is by the drawing: its `normal`, by name of the observation, and
    its distance as an entry of [parameters].

    The plane with the least squares of distances from the touched points: a tilt is an angle about
    a nominal normal, which must not be 90 degrees off.
    """
    assert mechanism.tree is not None
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    families = {family.name: family for family in mechanism.families}
    normals: dict[str, dict[str, Any]] = {}
    distances: dict[str, Any] = {}
    for one in looking:
        if one.table["type"] != "plane":
            continue
        family = families[one.name]
        path = mechanism.tree.path(family.on, family.against)
        touched = np.isfinite(readings[family.readings[0]])
        bodies = bodies_of(ChainFrame(path, readings, nominal), len(touched))
        points = bodies.origins[touched]
        middle, normal = points.mean(axis=0), one.table.get("normal")
        if normal is None:
            across = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
            across = across * np.sign(across[np.argmax(np.abs(across))])
            normal = [round(float(v), 3) + 0.0 for v in across]  # no -0
            normals[one.name] = {"normal": normal}
        n = np.array(normal) / np.linalg.norm(normal)
        away = round(1e3 * float(n @ middle), 1)
        distances[f"{one.name}_distance"] = {"value": away, "unit": "mm"}
    return normals, distances


def _as_drawn(mechanism: Mechanism, family: Family, readings: Mapping[str, Array]) -> bool:
    """Whether measured points do not deny that the target is at the origin of its body."""
    if family.form != "point" or len(family.readings) != 3:
        return True
    assert mechanism.tree is not None
    seen = np.array([readings[q] for q in family.readings])
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    path = mechanism.tree.path(family.on, family.against)
    bodies = bodies_of(ChainFrame(path, readings, nominal), seen.shape[1])
    try:
        taken = align(bodies.origins.T, seen).rms ** 2 - see_points(bodies, seen.T[None]).rms ** 2
    except InputError:
        return True  # points that do not even place the station deny nothing
    return bool(taken <= (DENIED * DRAWN_MM * 1e-3) ** 2)


def _noise(mechanism: Mechanism, used: Sequence[str], stated: Mapping[str, Any]) -> dict[str, Any]:
    """Sds where learning begins: of joints of a kind, and of each observation but those stated."""
    noise = joint_noise({joint: si for joint, si in mechanism.joints.items() if joint in used})
    noise |= stated
    for family in mechanism.families:
        if family.name in stated:
            continue
        for si in dict.fromkeys(mechanism.quantities[q] for q in family.readings):
            sd, of = GUESSED[si]
            names = [q for q in family.readings if mechanism.quantities[q] == si]
            noise[",".join(names)] = {"sd": sd, "unit": of, "estimate": "group"}
    return noise
