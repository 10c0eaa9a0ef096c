"""What does the command line say of machines over their lives, day by day?

Each machine (`analyses.lives_truth`, no code of loopcal's) is built off its drawing, by zeros of
0.1 to 0.6 degrees, twists of 0.5 to 2 mrad and lengths of 0.1 to 1 mm; most of them sag, some have
gears or backlash. Of 30 there are 20 arms (four calibrated from two stations, four with two loads),
5 palletisers and 5 deltas, with poses at random, sorted by the first joint or as a raster. A user
has CSV files and a table of Denavit-Hartenberg parameters or a URDF (of a delta: a project):

    loopcal init day-0.csv --dh dh.csv --out calibration --run

On each later day the tracker stands elsewhere, and 20 to 40 new poses are measured and verified:

    loopcal verify calibration/project-result day-2.csv --json

Every second day nothing happened; on the others one change was planted (`analyses.lives_days`).
After a day whose joint zero moved, `loopcal update` follows it. Of each day is kept what was
answered, and the true error of the calibrated machine: rms distance at 200 fresh poses of that
day, predicted by `loopcal predict` and moved rigidly onto the truth. Counted are

- alarms: answers to "is the machine as calibrated?" other than yes; so are clean files that are
  refused, and others that are refused for what was planted;
- named: the change is named first, or as not distinguishable from what is, with a size between
  half and twice the true one (zeros, links); or it is spoken of (`lives_days.KINDS`), with its
  pose, and no change that it is not;
- absurd: a change of more than five times the planted size of its unit, or, where nothing of its
  unit was planted, of more than 20 mm or 2 degrees;
- wrong: "as calibrated" where the true error is above 1.5 times the expected one.

    python -m analyses.lives [--machines 30] [--first 0] [--days 10] [--processes 2] [--only WORD]
        [--command PATH] [--folder FOLDER] [--again] [--write FILE.md]

The folder keeps the files and the calibration of each machine, and what was answered. --again
keeps the former and asks anew; --only takes machines and days whose words have this one.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import time
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analyses.gauntlet_truth import Array
from analyses.kept import Draw, complete
from analyses.lives_days import CLEAN, KINDS, PLANTED, Planted, afterwards, kinds, made
from analyses.lives_truth import DEGREE, Machine, away, machine, write_readings
from analyses.rates import interval
from analyses.written import write_block

FOLDER = Path(".cache/lives")
CALIBRATION = "calibration/project-result"
FRESH = 200
BEYOND = 1.5
"""True error over the expected one, from which "as calibrated" is wrong."""
LARGEST = {"m": 0.02, "rad": 2.0 * DEGREE}
"""Changes that no machine has by itself."""
NEAR = 2
"""By how many poses a slip may be dated wrongly."""
PATIENCE = 600
"""Seconds after which a user gives up."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "LOOPCAL_THREADS": "1"}


DELTA_PROJECT = """schema = 1
[mechanism]
file = "mechanism.toml"
[data]
file = "../day-0.csv"
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


def answered(command: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What a command prints and how it ends, run in a folder where no person looks."""
    try:
        return subprocess.run(
            [command, *arguments],
            cwd=folder,
            env=os.environ | ONE_THREAD,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(arguments, 124, "", f"no answer in {PATIENCE} s")


def calibrated(_: str, number: int, folder: Path, command: str) -> Draw:
    """A machine on its first day: its files, its calibration, predictions at fresh poses."""
    user, folder = machine(number), place(folder, number)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([42, number])
    q, conditions = user.posed(user.poses, rng), user.conditions(user.poses)
    first = user.measured(q, conditions, rng, user.stations)
    columns = user.columns(conditions, user.stations)
    write_readings(folder / "day-0.csv", user.joints, *first, columns)
    columns = user.columns(user.conditions(FRESH))
    write_readings(folder / "fresh.csv", user.joints, *_fresh(user), columns)
    begun = time.monotonic()
    done = _begun(user, folder, command)
    about: Draw = {"kind": "calibrated", "draw": number, "exit": done.returncode}
    about |= {"family": user.family, "wear": user.wear, "order": user.order, "poses": user.poses}
    about |= {"described": user.described, "seconds": round(time.monotonic() - begun, 2)}
    result = folder / CALIBRATION / "result.json"
    if not result.exists():
        return about | {"failed": done.stderr[-600:]}
    answers = json.loads(result.read_text("utf-8"))["verdict"]
    about |= {question: answers[question]["passed"] for question in ("sound", "valid", "better")}
    points = predicted(CALIBRATION, folder, command)
    return about | {"true": None if points is None else _rms(away(points, _fresh(user)[1]))}


def _begun(user: Machine, folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """The first calibration, by `init` or, where it does not describe the machine, by a project."""
    if user.described != "project":
        described = user.description(folder)
        init = ["init", "day-0.csv", *described, "--out", "calibration", "--force", "--run"]
        return answered(command, *init, folder=folder)
    shutil.rmtree(folder / "calibration", ignore_errors=True)
    answered(command, "new", "calibration", "--mechanism", "rotary-delta", folder=folder)
    (folder / "calibration" / "project.toml").write_text(DELTA_PROJECT, "utf-8")
    run = ["calibrate", "calibration/project.toml", "--out", CALIBRATION, "--no-report", "--force"]
    return answered(command, *run, folder=folder)


def place(folder: Path, number: int) -> Path:
    """Where the files of a machine are."""
    return folder / f"machine-{number:03d}"


def _fresh(user: Machine) -> tuple[Array, Array]:
    """Recorded joints of poses that nobody measures, and their points on the first day."""
    rng = np.random.default_rng([44, user.number])
    q = user.posed(FRESH, rng)
    p = user.points(q, user.conditions(FRESH))
    return q + user.encoder * rng.standard_normal(q.shape), p


def _posed(user: Machine) -> Array:
    """Joints of the fresh poses as they truly are."""
    return user.posed(FRESH, np.random.default_rng([44, user.number]))


def predicted(result: str, folder: Path, command: str) -> Array | None:
    """Points at the fresh poses by a calibration [m]; None where there are none."""
    out = folder / f"{result.split('/')[0]}-fresh.csv"
    if not out.exists():
        asked = ["predict", result, "fresh.csv", "--out", out.name]
        if answered(command, *asked, folder=folder).returncode:
            return None
    table = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    # of several stations the first stands where all later days are measured from
    end = "" if "x_[m]" in table.dtype.names else "_1"
    columns = [f"{c}{end}_[m]" for c in "xyz"]
    return np.column_stack([table[c] for c in columns])


def lived(kind: str, number: int, folder: Path, command: str) -> Draw:
    """What `verify` answers to the file of one day, and `update` where a zero has moved.

    number: 1000 times the machine's, and the day.
    """
    number, day = divmod(number, 1000)
    user, folder = machine(number), place(folder, number)
    measured, planted = made(user, day, kind)
    file = f"day-{day}.csv"
    write_readings(folder / file, user.joints, measured.joints, measured.points, measured.columns)
    begun = time.monotonic()
    done = answered(command, "verify", CALIBRATION, file, "--json", folder=folder)
    answer: Draw = {
        "kind": kind,
        "draw": 1000 * number + day,
        "planted": planted.document(),
        "exit": done.returncode,
        "seconds": round(time.monotonic() - begun, 2),
        "error": done.stderr[-400:],
    }
    true = user.points(_posed(user), afterwards(measured, FRESH))
    points = predicted(CALIBRATION, folder, command)
    answer["true"] = None if points is None else _rms(away(points, true))
    try:
        answer |= _compact(json.loads(done.stdout), planted)
    except json.JSONDecodeError:
        answer["refused"] = True
    if kind == "zero":
        answer["updated"] = _updated(day, file, true, folder, command)
    return answer


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


def _updated(day: int, file: str, true: Array, folder: Path, command: str) -> dict[str, Any]:
    """The true error once `update` has followed what changed."""
    out = f"updated-{day}"
    (folder / f"{out}-fresh.csv").unlink(missing_ok=True)
    asked = ["update", CALIBRATION, file, "--out", out, "--no-report", "--force"]
    done = answered(command, *asked, folder=folder)
    points = predicted(out, folder, command) if (folder / out / "result.json").exists() else None
    error = None if points is None else _rms(away(points, true))
    return {"exit": done.returncode, "true": error, "error": done.stderr[-400:]}


def alarmed(answer: dict[str, Any]) -> bool:
    """Whether the answer to "is the machine as calibrated?" is other than yes.

    A file that is refused for another reason than what was planted answers nothing.
    """
    if answer.get("refused"):
        return answer["kind"] == CLEAN or _speaks(answer)
    return answer.get("passed") is not True


def named(answer: dict[str, Any]) -> bool:
    """Whether an alarm speaks of what was planted."""
    return alarmed(answer) and _speaks(answer)


def _speaks(answer: dict[str, Any]) -> bool:
    """Whether changes or words of an answer are those of what was planted."""
    planted, pattern = answer["planted"], KINDS[answer["kind"]].names
    findings = answer.get("findings", [])
    changes = answer.get("changes", [])
    words = " ".join(
        [
            answer.get("words", answer["error"]),
            *(f"{one['code']} {one['words']}" for one in findings),
            *(one["name"] for one in changes[:1]),
        ]
    )
    if not pattern:
        return any(_is_it(one, planted) for one in changes[:1])
    spoken = [words, *(f"{one['name']} {one.get('kind', '')}" for one in changes)]
    if not all(re.search(pattern, text, re.IGNORECASE) for text in spoken):
        return False
    if KINDS[answer["kind"]].column and not any(name in words for name in planted["parameters"]):
        return False
    if planted["pose"] is None:
        return True
    slack = NEAR if answer["kind"] == "slip" else 0
    return any(abs(pose - planted["pose"]) <= slack for pose in _poses(words, findings))


def _is_it(change: dict[str, Any], planted: dict[str, Any]) -> bool:
    """Whether a change has the planted one's name, or is not distinguishable from it, and size."""
    names = {change["name"], *change.get("alike", ())}
    share = (change.get("value") or 0.0) / planted["size"]
    same = change["name"] in planted["parameters"]
    return bool(names & {*planted["parameters"]}) and (not same or 0.5 <= share <= 2.0)


def _poses(words: str, findings: Sequence[dict[str, Any]]) -> set[int]:
    """Poses that an answer speaks of."""
    spoken = re.findall(r"poses? (\d+)", words)
    placed = [p for one in findings for p in (one["place"] or {}).get("poses", ())]
    return {int(p) for p in [*spoken, *placed] if str(p).isdigit()}


def absurd(answer: dict[str, Any]) -> bool:
    """Whether a change is named that is far larger than anything that happened."""
    planted = answer["planted"]
    for change in answer.get("changes", []):
        unit = change.get("unit")
        limit = LARGEST.get(unit, math.inf)
        if planted["unit"] == unit:
            limit = 5.0 * abs(planted["size"])
        parts = change.get("parts", {}).values()
        sizes = [change.get("value") or 0.0, *parts]
        if max(map(abs, sizes)) > limit:
            return True
    return False


def wrong(answer: dict[str, Any]) -> bool:
    """Whether a machine is called as calibrated that errs by far more than is expected of it."""
    expected = (answer.get("accuracy") or {}).get("expected")
    if alarmed(answer) or expected is None or answer.get("true") is None:
        return False
    return bool(answer["true"] > BEYOND * expected)


HEAD = (
    f"{'day':14}{'draws':>6}{'alarmed %':>11}{'':16}{'named %':>11}{'':16}{'absurd':>7}"
    f"{'wrong':>6}{'refused':>8}"
)


def table(first: Sequence[Draw], answers: Sequence[Draw]) -> str:
    """Rates of each kind of day, and what `update` made of zeros that moved."""
    by: dict[str, list[Draw]] = defaultdict(list)
    for answer in answers:
        by[answer["kind"]].append(answer)
    rows = [_row(kind, by[kind]) for kind in (CLEAN, *PLANTED) if by[kind]]
    changed = [answer for kind in PLANTED for answer in by[kind]]
    parts = [HEAD, *rows, _row("all planted", changed)]
    failed = [one["draw"] for one in first if "failed" in one]
    sound = sum(one.get("sound") is True for one in first)
    parts += ["", f"calibrations: {len(first)}, sound {sound}, failed {len(failed)}"]
    updated = [a for a in by["zero"] if a["updated"]["true"] is not None]
    if updated:
        before = np.array([a["true"] for a in updated])
        after = np.array([a["updated"]["true"] for a in updated])
        parts.append(
            f"update after a moved zero, true error [mm], median: {1e3 * np.median(before):.3f} "
            f"before, {1e3 * np.median(after):.3f} after; better in {(after < before).sum()} of "
            f"{len(updated)}"
        )
    return "\n".join(parts)


def _row(kind: str, answers: Sequence[dict[str, Any]]) -> str:
    alarms = sum(map(alarmed, answers))
    nameable = [one for one in answers if KINDS[one["kind"]].named]
    names = _rate(sum(map(named, nameable)), len(nameable)) if nameable else ""
    return (
        f"{kind:14}{len(answers):6d}{_rate(alarms, len(answers))}{names:27}"
        f"{sum(map(absurd, answers)):7d}{sum(map(wrong, answers)):6d}"
        f"{sum('refused' in one for one in answers):8d}"
    )


def _rate(count: int, draws: int) -> str:
    low, high = interval(count, draws)
    held = f" ({100 * low:.1f} to {100 * high:.1f})"
    return f"{100 * count / max(draws, 1):11.1f}{held:16}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--days", type=int, default=10)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--command", default="loopcal")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    folder = given.folder.resolve()
    command = str(Path(given.command).resolve()) if "/" in given.command else given.command
    how = {"folder": folder, "command": command}
    numbers = range(given.first, given.first + given.machines)
    first = complete(
        folder / "calibrations.jsonl",
        [("calibrated", i) for i in numbers],
        partial(calibrated, **how),
        given.processes,
    )
    answers = folder / "answers.jsonl"
    if given.again:
        answers.unlink(missing_ok=True)
    usable = [one["draw"] for one in first if "failed" not in one]
    days = [
        (kind, 1000 * i + day)
        for i in sorted(usable)
        for day, kind in enumerate(kinds(machine(i), given.days), 1)
        if given.only in " ".join([kind, *_about(i)])
    ]
    text = table(first, complete(answers, days, partial(lived, **how), given.processes))
    print(text)
    if given.write:
        write_block(given.write, "lives", text)


def _about(number: int) -> tuple[str, ...]:
    user = machine(number)
    return user.family, user.wear, user.order, user.described


if __name__ == "__main__":
    main()
