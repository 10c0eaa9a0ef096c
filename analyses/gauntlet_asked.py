"""What the command line answers on a first day and on a later one, beside what is true.

The commands are those of a user, with files in a folder; `loopcal.cli.main`, which the command
`loopcal` calls, runs in this process, so that Python and its packages start once.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import shutil
import signal
import subprocess
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from analyses.gauntlet_cameras import Photographed
from analyses.gauntlet_days import Day, Planted, afterwards, made
from analyses.gauntlet_kinds import KINDS, Kind
from analyses.gauntlet_rivals import Rival, rival
from analyses.gauntlet_truth import Array
from analyses.kept import Draw
from analyses.lives_truth import BOXES, Machine, away, placement, write_readings
from loopcal.cli import main as loopcal

CALIBRATION = "calibration/project-result"
FRESH = 200
PATIENCE = 600
"""Seconds after which a user gives up."""
THE_FLEET = "the fleet"
"""The kind of first day whose machines later days verify."""
STATED = {"day 2: tool": ("--remounted",)}
"""What the user of `update` states of a day; `update` follows every later day."""
RIVALS = ("nominal", "least squares")
RIVAL_POINTS = "rivals.json"
QUESTIONS = ("sound", "valid", "better")

DELTA_PROJECT = """schema = 1
[mechanism]
file = "mechanism.toml"
[data]
file = "../day-1.csv"
pose = "pose"
[data.columns]
theta_1 = { column = "J1 [deg]", unit = "deg" }
theta_2 = { column = "J2 [deg]", unit = "deg" }
theta_3 = { column = "J3 [deg]", unit = "deg" }
x = { column = "x [mm]", unit = "mm" }
y = { column = "y [mm]", unit = "mm" }
z = { column = "z [mm]", unit = "mm" }
[noise]
"theta_*" = { sd = 50, unit = "urad", estimate = "group" }
xyz = { sd = 20, unit = "um", estimate = "group" }
"platform_*" = { sd = inf }
"""
"""What the user of a delta has made of `loopcal new`."""


def asked(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What `loopcal ARGUMENTS` prints and how it ends, run in a folder by this process."""
    out, err = io.StringIO(), io.StringIO()

    def given_up(*_: Any) -> None:
        raise TimeoutError(f"no answer in {PATIENCE} s")

    before, earlier = Path.cwd(), signal.signal(signal.SIGALRM, given_up)
    os.chdir(folder)
    signal.alarm(PATIENCE)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = loopcal(arguments)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, earlier)
        os.chdir(before)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def answered(name: str, draw: int, root: Path) -> Draw:
    """What became of one day; root: where the machines of later days are kept."""
    kind, begun = KINDS[name], time.process_time()
    answer: Draw = {"kind": name, "draw": draw}
    try:
        if kind.photographed is not None:
            answer |= _images(kind, kind.photographed, draw, root)
        else:
            answer |= _later(kind, draw, root) if kind.later else _first(kind, draw, root)
    except Exception as error:  # an error of the gauntlet's own is counted and ends nothing
        answer["failed"] = repr(error)[:300]
    return answer | {"cpu": round(time.process_time() - begun, 2)}


def _seed(name: str, draw: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(name.encode()), draw])


def _first(kind: Kind, draw: int, root: Path) -> Draw:
    user, rng = kind.machine(draw), _seed(kind.name, draw)
    folder = place(root, draw) if kind.name == THE_FLEET else root / f"{kind.name}-{draw}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    day, planted = made(user, user.poses, rng, kind.event, kind.tamper, user.stations)
    write_readings(folder / "day-1.csv", user, day.joints, day.points, day.columns)
    done = _calibrate(user, folder)
    answer = {"planted": planted.document(), "exit": done.returncode, "family": user.family}
    answer |= {"order": user.order, "wear": user.wear, "described": user.described}
    if not (folder / CALIBRATION / "result.json").exists():
        return answer | {"refused": True, "told": done.stderr[-4000:]}
    result = json.loads((folder / CALIBRATION / "result.json").read_text("utf-8"))
    answer |= {question: result["verdict"][question]["passed"] for question in QUESTIONS}
    answer |= {"codes": [result["verdict"][question]["code"] for question in QUESTIONS]}
    told = [line for line in done.stdout.splitlines() if line.startswith("- Inferred")]
    told += [f"{one['code']} {one['words']}" for one in result["findings"]]
    answer["told"] = "\n".join([*told, *result["warnings"]])
    answer["findings"] = [{"place": one["place"]} for one in result["findings"]]
    rivals = _rivals(user, day)
    boxes = {"inside": user.box} | (
        {"outside": BOXES[user.family]} if kind.fixed.get("share") else {}
    )
    for where, box in boxes.items():
        q, read = _posed(user, box)
        now = afterwards(day, FRESH)
        true = now.seen(user.bodies(q, now)[1])[:, 0]
        columns = user.columns(now)
        write_readings(folder / f"{where}.csv", user, read, None, columns)
        stated = predicted(CALIBRATION, folder, where)
        answer[where] = None if stated is None else _beside(*stated, true, placed=kind.placed)
        points = {name: one.points(read) for name, one in rivals.items()}
        for name, its in points.items():
            answer[f"{name} {where}"] = _rms(away(its, true) if kind.placed else _far(its, true))
    if kind.name == THE_FLEET:
        kept = {name: its.tolist() for name, its in points.items()}
        (folder / RIVAL_POINTS).write_text(json.dumps(kept))
    else:
        shutil.rmtree(folder)
    return answer


def _images(kind: Kind, photographed: Photographed, draw: int, root: Path) -> Draw:
    """A folder of corners, board and poses that `init` calibrates."""
    folder = root / f"{re.sub('[^a-z0-9]+', '-', kind.name)}-{draw}"
    shutil.rmtree(folder, ignore_errors=True)
    shots, planted = photographed.written(draw, folder / "images", _seed(kind.name, draw))
    robot = ["--dh", "images/dh.csv"] if (folder / "images" / "dh.csv").exists() else []
    done = asked(folder, "init", "images", *robot, "--out", "calibration", "--run")
    answer: Draw = {"planted": planted.document(), "exit": done.returncode}
    answer |= {"family": shots.rig.family, "told": done.stdout}
    path = folder / CALIBRATION / "result.json"
    if not path.exists():
        return answer | {"refused": True, "told": done.stdout + done.stderr[-4000:]}
    result = json.loads(path.read_text("utf-8"))
    answer |= {question: result["verdict"][question]["passed"] for question in QUESTIONS}
    answer |= {"codes": [result["verdict"][question]["code"] for question in QUESTIONS]}
    answer["findings"] = [{"place": one["place"]} for one in result["findings"]]
    shutil.rmtree(folder)
    return answer


def _later(kind: Kind, draw: int, root: Path) -> Draw:
    user, folder, rng = kind.machine(draw), place(root, draw), _seed(kind.name, draw)
    if not (folder / RIVAL_POINTS).exists():
        return {"unmade": True}
    day, planted = made(user, int(rng.integers(20, 41)), rng, kind.event, kind.tamper)
    name = re.sub(r"[^a-z0-9]+", "-", kind.name)
    file = f"{name}.csv"
    write_readings(folder / file, user, day.joints, day.points, day.columns, kind.cell)
    done = asked(folder, "verify", CALIBRATION, file, "--json")
    answer: Draw = {"planted": planted.document(), "exit": done.returncode, "family": user.family}
    answer |= {"wear": user.wear, "order": user.order, "told": done.stderr[-600:]}
    now = afterwards(day, FRESH)
    true = user.points(_posed(user, user.box)[0], now)
    for rival_name, points in json.loads((folder / RIVAL_POINTS).read_text()).items():
        answer[f"{rival_name} inside"] = _rms(away(np.array(points), true))
    answer["true"] = _true(CALIBRATION, folder, true)
    try:
        answer |= _compact(json.loads(done.stdout), planted)
    except json.JSONDecodeError:
        answer["refused"] = True
    out = f"{name}-updated"
    shutil.rmtree(folder / out, ignore_errors=True)
    (folder / f"{out}-inside.csv").unlink(missing_ok=True)
    options = ["--out", out, "--no-report", *STATED.get(kind.name, ())]
    done = asked(folder, "update", CALIBRATION, file, *options)
    answer["updated"] = {"exit": done.returncode, "error": done.stderr[-400:]}
    if (folder / out / "result.json").exists():
        result = json.loads((folder / out / "result.json").read_text("utf-8"))
        answer["updated"] |= {"sound": result["verdict"]["sound"]["passed"]}
        answer["updated"] |= {"code": result["verdict"]["sound"]["code"]}
        answer["updated"] |= _updated(out, folder, true)
    return answer


def place(root: Path, draw: int) -> Path:
    """Where the files of a machine are that later days need."""
    return root / f"machine-{draw:03d}"


def _calibrate(user: Machine, folder: Path) -> subprocess.CompletedProcess[str]:
    """The first calibration, by `init` or, where it does not describe the machine, by a project."""
    run = ["calibrate", "calibration/project.toml", "--out", CALIBRATION, "--no-report", "--force"]
    if user.described == "project":
        asked(folder, "new", "calibration", "--mechanism", "rotary-delta")
        (folder / "calibration" / "project.toml").write_text(DELTA_PROJECT, "utf-8")
        return asked(folder, *run)
    init = ["init", "day-1.csv", *user.description(folder), "--out", "calibration"]
    if user.stated is None:
        return asked(folder, *init, "--run")
    done = asked(folder, *init)
    if not done.returncode:
        _state_sds(user, folder / "calibration" / "project.toml")
        done = asked(folder, *run)
    return done


def _state_sds(user: Machine, project: Path) -> None:
    """The user fixes all sds, by a factor beside what is true."""
    factor = user.stated or 1.0
    sds = {"urad": 1e6 * factor * user.encoder, "um": 1e6 * factor * user.tracker}
    learnt = r'sd = [\d.]+, unit = "(u\w+)", estimate = "group"'
    text = project.read_text("utf-8")
    text = re.sub(learnt, lambda m: f'sd = {sds[m[1]]:g}, unit = "{m[1]}"', text)
    project.write_text(text, "utf-8")


def _posed(user: Machine, box: Array) -> tuple[Array, Array]:
    """Joints of poses that nobody measures, as they truly are and as the controller has them."""
    rng = np.random.default_rng([44, user.number])
    q = replace(user, box=box, repeats=0).posed(FRESH, rng)
    return q, user.recorded(q, rng)


def _rivals(user: Machine, day: Day) -> dict[str, Rival]:
    stations = np.unique(day.conditions.shift, axis=0, return_inverse=True)[1][day.rows]
    stations = stations if user.stations > 1 else 0 * stations
    return {
        name: rival(user, day.joints, day.points[:, :3], stations, fitted=name != "nominal")
        for name in RIVALS
    }


def predicted(result: str, folder: Path, fresh: str) -> tuple[Array, Array, Array] | None:
    """Points at fresh poses by a calibration, their sds and half-widths [m]; None without any."""
    out = folder / f"{result.split('/')[0]}-{fresh}.csv"
    if not out.exists():
        if not (folder / result / "result.json").exists():
            return None
        if asked(folder, "predict", result, f"{fresh}.csv", "--out", out.name).returncode:
            return None
    table = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    first = [name.removesuffix("_[m]") for name in (table.dtype.names or ())[1:4]]
    points, sds, halves = (
        np.column_stack([table[f"{c}_{what}[m]"] for c in first])
        for what in ("", "sd_", "+-_95_%_")
    )
    return points, sds, halves


def _beside(points: Array, sds: Array, halves: Array, true: Array, *, placed: bool) -> Draw:
    """True error and stated sd [m], root mean squares, and the share of true coordinates held."""
    if placed:
        R, shift = placement(points, true)
        points = points @ R.T + shift
    held = float((np.abs(points - true) <= halves).mean())
    return {
        "error": _rms(_far(points, true)),
        "sd": _rms(np.linalg.norm(sds, axis=1)),
        "held": held,
    }


def _true(result: str, folder: Path, true: Array) -> float | None:
    """The error of a calibration on a later day, wherever its instrument stands [m]."""
    stated = predicted(result, folder, "inside")
    return None if stated is None else _rms(away(stated[0], true))


def _updated(result: str, folder: Path, true: Array) -> Draw:
    """The same of an update, beside the sd that its predictions state [m]."""
    stated = predicted(result, folder, "inside")
    if stated is None:
        return {"true": None}
    return {"true": _rms(away(stated[0], true)), "sd": _rms(np.linalg.norm(stated[1], axis=1))}


def _far(points: Array, true: Array) -> Array:
    distance: Array = np.linalg.norm(points - true, axis=1)
    return distance


def _rms(distance: Array) -> float:
    return math.sqrt(float(np.square(distance).mean()))


def _compact(document: dict[str, Any], planted: Planted) -> dict[str, Any]:
    """Of a verification what rates are counted from, without its candidates."""
    consistent = document["verdict"]["consistent"]
    changes = document.get("changes") or {}
    smallest = [
        one["smallest"]
        for one in changes.get("candidates", ())
        if one["name"] in planted.parameters and one.get("smallest")
    ]
    keys = ("code", "severity", "question", "place", "words")
    return {
        "passed": consistent["passed"],
        "code": consistent["code"],
        "words": consistent["words"],
        "findings": [{k: one.get(k) for k in keys} for one in document["findings"]],
        "changes": changes.get("found", []),
        "accuracy": {k: v["rms"] for k, v in document["accuracy"].items() if isinstance(v, dict)},
        "smallest": min(smallest, default=None),
    }
