"""A project of a whole robot: its tree of bodies, and what was observed between any two of them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.twists import mean_motion
from loopcal.estimation.mounted import Bodies, bodies_of, see_planes, see_points
from loopcal.estimation.problem.alignment import align
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.dh_table import Row, read_dh
from loopcal.files.recognition.fields import in_si
from loopcal.files.recognition.robots import joint_table
from loopcal.files.recognition.rows import (
    Observation,
    Rows,
    joints_in,
    later_rows,
    observations,
    reach,
    rows_of,
    seen_as,
    with_readings,
)
from loopcal.files.tables.writer import table_bytes
from loopcal.files.toml.reader import SCHEMA
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.frame import ChainFrame, matrices
from loopcal.mechanisms.instruments.camera import all_cameras
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.statistics.choice import FOLDS
from loopcal.workflow.beginning.begun import PROJECT, READINGS, Begun, drawn, joint_noise
from loopcal.workflow.beginning.images_project import six_of
from loopcal.workflow.beginning.later_images import refuse_another, refuse_unknown_eye
from loopcal.workflow.beginning.tree_images import Eyes, Pictures, see, sources_and_pictures

GUESSED = {"m": (0.1, "mm"), "rad": (0.5, "mrad"), "px": (0.3, "px")}
"""Where the learning of the sds of observations begins, gaps of things that touch among them."""
DRAWN_MM, DRAWN_MRAD = 2.0, 5.0
"""How far a robot is from its drawing, as sds: what stands between two hands tells some directions
apart by nothing else. Chosen: twice and more what arms of many makers are off by."""
TURNED_DEG = 60.0
"""How far an inclinometer is turned on its body, as an sd: as of any mounting."""
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
    looking = [replace(one, table=with_readings(one)) for one in looking]
    table = {**robot, "instrument": [dict(one.table) for one in looking]}
    mechanism = mechanism_from_data(dict(table), str(folder / PROJECT))
    sources, pictures = sources_and_pictures(entries, typed)
    eyes = Eyes(taken=tuple(one.name for one in looking))
    pixels = _seen_by_cameras(eyes, looking, pictures, mechanism, robot.get("units", {}))
    if eyes.instruments:
        looking = [one for one in looking if one.table["type"] != "camera"]
        looking += [_of_camera(instrument, typed) for instrument in eyes.instruments]
        table["instrument"] = [dict(one.table) for one in looking]
        mechanism = mechanism_from_data(dict(table), str(folder / PROJECT))
    rows, words = rows_of(sources, mechanism, looking, pixels)
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


def later_observed(entries: Sequence[Any], mechanism: Mechanism, observe: Sequence[str]) -> Dataset:
    """Readings of another day of a whole robot: files in the layout of the first ones.

    observe: what was observed, as typed at `init`. Lenses and boards are those of the calibration.
    Raises InputError for a camera or board that is not in it.
    """
    typed = observations(observe)
    cameras = all_cameras(mechanism)
    boards = {one.board.name: one.board for one in cameras}
    sources, pictures = sources_and_pictures(entries, typed, boards)
    eyes = Eyes(
        taken=tuple(one.name for one in typed),
        lenses={one.name: one.intrinsics for one in cameras},
    )
    seen = [one for one in typed if any(picture.is_of(one) for picture in pictures)]
    pixels = _seen_by_cameras(eyes, seen, pictures, mechanism, {})
    for table in eyes.instruments:
        refuse_unknown_eye(table["eye"], {one.name for one in cameras})
        refuse_another(Board(table["board"], table["points"]), boards)
    for words in eyes.doubts:
        warnings.warn(words, stacklevel=2)
    looking = [one for one in typed if one.table["type"] != "camera"]
    for family in mechanism.families:
        if family.form == PIXELS:
            looking.append(_of_camera({"type": "camera", "name": family.name}, typed))
    return later_rows(sources, mechanism, looking, pixels)


def _of_camera(table: Mapping[str, Any], typed: Sequence[Observation]) -> Observation:
    """An instrument, with the joints as its file names them."""
    origin = seen_as(table["name"], [one for one in typed if one.table["type"] == "camera"])
    return Observation(table, joints=origin.joints if origin else None)


def _seen_by_cameras(
    eyes: Eyes,
    looking: Sequence[Observation],
    pictures: Sequence[Pictures],
    mechanism: Mechanism,
    units: Mapping[str, str],
) -> dict[int, dict[str, Array]]:
    """Pixels of what cameras saw, by the identity of the table of poses; the rest is in `eyes`."""
    pixels = dict[int, dict[str, Array]]()
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    assert mechanism.tree is not None
    cameras = [one for one in looking if one.table["type"] == "camera"]
    for one in cameras:
        # A camera that sees several boards has an instrument for each, named NAME_BOARD.
        of_one = [f for f in mechanism.families if f"{f.name}_".startswith(f"{one.name}_")]
        family = min(of_one, key=lambda f: (f.form != PIXELS, len(f.name)))
        mine = [p for p in pictures if p.is_of(one)]
        for picture in mine:
            source = picture.source
            named = [one for one in looking if one.of_file(source.path)]
            joints = joints_in(source, mechanism, named)
            if missing := sorted(reach(mechanism, family) - joints.keys()):
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
    return pixels


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


def _refuse_unobserved(mechanism: Mechanism, rows: Rows, looking: Sequence[Observation]) -> None:
    for family in mechanism.families:
        if not any(q in rows.columns for q in family.readings):
            one = next(o for o in looking if o.name == family.name)
            needed = sorted(reach(mechanism, family))
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
    entries: dict[str, Any] = {}
    for one in looking:
        family, target = families[one.name], one.table.get("target")
        if one.table["type"] == "inclinometer":
            turns = [f"{one.name}_{axis}" for axis in ("rz", "ry", "rx")]
            stated = {"value": 0.0, "unit": "deg", "sd": TURNED_DEG}
            entries |= {name: stated for name in turns if name in nominal}
        if one.table["type"] == "contact":
            bodies[one.table.get("centre", f"{one.name}_2")] = family.against
            target = target or f"{one.name}_1"
        if target:
            denied = bodies.get(target) == "" or not _as_drawn(mechanism, family, readings)
            bodies[target] = "" if denied else family.on
    words = []
    for target, body in bodies.items():
        link = mechanism.tree.links.get(body)
        names = [f"{target}_{axis}" for axis in "xyz"]
        if not nominal.keys() >= {*names}:
            continue
        # Poses that hardly turn a hand leave its target open by hundreds of metres.
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
    """Where each plane is by the drawing: its `normal`, by name of the observation, and its
    distance as an entry of [parameters]; and where what hands hold is in the first of them, and
    cameras that see a plane on theirs.

    The plane with the least squares of distances from the touched points: a tilt is an angle about
    a nominal normal, which must not be 90 degrees off.
    """
    assert mechanism.tree is not None
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    families = {family.name: family for family in mechanism.families}
    normals: dict[str, dict[str, Any]] = {}
    places: dict[str, Any] = {}
    walls: dict[str, Any] = {}
    for one in looking:
        if one.table["type"] not in ("plane", "held-part", "seen-plane"):
            continue
        family = families[one.name]
        path = mechanism.tree.path(family.on, family.against)
        read = np.array([readings[q] for q in family.readings])
        touched = np.isfinite(read).all(axis=0)
        bodies = bodies_of(ChainFrame(path, readings, nominal), len(touched))
        touched &= bodies.complete
        if one.table["type"] == "seen-plane":
            plane = one.table.get("plane", f"{one.name}_plane")
            stated = one.table.get("normal", walls.get(plane))
            T, n, away = _seen_planes(bodies.take(touched), read[:, touched], stated)
            walls[plane] = [round(float(v), 3) + 0.0 for v in n] if stated is None else stated
            normals[one.name] = {"normal": walls[plane]}
            places |= six_of(one.name, T, near=(MOUNTED_MM, TURNED_DEG))
            places.setdefault(f"{plane}_distance", {"value": round(1e3 * away, 1), "unit": "mm"})
            continue
        points = bodies.origins[touched]
        if one.table["type"] == "held-part":
            first = rigid(bodies.rotations[touched], points)
            places |= six_of(one.name, mean_motion(inverse(first), np.ones(len(first))))
            continue
        middle, normal = points.mean(axis=0), one.table.get("normal")
        if normal is None:
            across = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
            across = across * np.sign(across[np.argmax(np.abs(across))])
            normal = [round(float(v), 3) + 0.0 for v in across]  # no -0
            normals[one.name] = {"normal": normal}
        n = np.array(normal) / np.linalg.norm(normal)
        away = round(1e3 * float(n @ middle), 1)
        places[f"{one.name}_distance"] = {"value": away, "unit": "mm"}
    return normals, places


def _seen_planes(
    bodies: Bodies, read: Array, normal: Sequence[float] | None
) -> tuple[Array, Array, float]:
    """`see_planes` of two angles and a distance (3, N)."""
    x, y = np.sin(read[:2])
    in_camera = np.stack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=1)
    n = None if normal is None else np.array(normal) / np.linalg.norm(normal)
    return see_planes(bodies, in_camera, read[2], n)


def _as_drawn(mechanism: Mechanism, family: Family, readings: Mapping[str, Array]) -> bool:
    """Whether measured points do not deny that the target is at the origin of its body.

    Of one in a socket the gaps are read, which are nothing.
    """
    if family.form not in ("point", "gap") or len(family.readings) != 3:
        return True
    assert mechanism.tree is not None
    seen = np.array([readings[q] for q in family.readings])
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    path = mechanism.tree.path(family.on, family.against)
    bodies = bodies_of(ChainFrame(path, readings, nominal), seen.shape[1])
    if family.form == "gap":
        held = np.isfinite(seen).all(axis=0)
        away, turns = bodies.origins[held], bodies.rotations[held]
        off, spread = away - away.mean(axis=0), turns - turns.mean(axis=0)
        target = np.linalg.lstsq(spread.reshape(-1, 3), -off.ravel(), rcond=None)[0]
        gain = np.mean(np.square(off).sum(axis=1) - np.square(off + spread @ target).sum(axis=1))
        return bool(gain <= (DENIED * DRAWN_MM * 1e-3) ** 2)
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
