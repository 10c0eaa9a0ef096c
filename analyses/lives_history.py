"""Does the history find the machines that drift, and date the step of those that have one?

Arms of `analyses.lives_truth` are measured on eight days over two years and calibrated anew each
time, the tracker elsewhere each day. A third of them stay as they are; of a third the zero of one
joint steps by 0.05 degrees between two of the days; of a third it creeps by 0.08 degrees over the
two years. As the user sees it:

    loopcal init measured-3.csv --dh dh.csv --out calibration-3 --run
    loopcal history machine.history --add calibration-3/project-result --date 2025-02-10
    loopcal history machine.history --json

Reported is how often the history says that anything of the machine changed, names the joint whose
zero did, names the way (step or drift), and, for a step, places it between the right two days.

    python -m analyses.lives_history [--machines 9] [--first 0] [--processes 2] [--folder FOLDER]
        [--again] [--write FILE.md]

The folder keeps files and calibrations; --again asks the history anew.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from datetime import date, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analyses.gauntlet_asked import asked
from analyses.gauntlet_days import made
from analyses.gauntlet_truth import Arm
from analyses.kept import Draw, complete
from analyses.lives_parallel import RotaryDelta, rezeroed
from analyses.lives_truth import DEGREE, Machine, machine, write_readings
from analyses.rates import interval
from analyses.written import write_block

FOLDER = Path(".cache/lives-history")
WAYS = ("steady", "step", "drift")
DAYS = 8
STEP, CREEP = 0.05 * DEGREE, 0.08 * DEGREE
"""Of a joint's zero [rad]: at once, and over the two years."""
MACHINE = ("theta", "offset", "alpha", "beta", "a_", "d_", "J")
"""How parameters of the machine begin; stations and reflectors are mounted anew each day."""


def history(way: str, number: int, folder: Path) -> Draw:
    """One machine over two years, and what the history says of it."""
    user = machine(number)
    folder = folder / f"machine-{number:03d}-{way}"
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([48, number])
    joint, first = int(rng.integers(2, len(user.joints))), int(rng.integers(2, DAYS - 1))
    described = user.description(folder)
    shutil.rmtree(folder / "machine.history", ignore_errors=True)
    days = _days(rng)
    errors = []
    for i, day in enumerate(days):
        moved = {"steady": 0.0, "step": STEP * (i >= first), "drift": CREEP * _share(days, day)}
        result = f"calibration-{i}/project-result"
        if not (folder / result / "result.json").exists():
            _calibrated(user, i, rezeroed(user.arm, joint, moved[way]), folder, described)
        refusal = _added(result, day, folder)
        errors += [refusal] if refusal else []
    done = asked(folder, "history", "machine.history", "--json")
    told: Draw = {"kind": way, "draw": number, "joint": joint, "from": first + 1, "errors": errors}
    try:
        trends = json.loads(done.stdout)["trends"]
    except (json.JSONDecodeError, KeyError):
        return told | {"failed": done.stderr[-400:], "changes": []}
    changes = [{"name": t["name"], **c} for t in trends for c in t.get("changes", ())]
    rates = {t["name"]: t["rate"] for t in trends if t.get("rate") is not None}
    return told | {"changes": changes, "rates": rates}


def _days(rng: np.random.Generator) -> list[date]:
    """Days of measurement over two years, at least a month apart."""
    gaps = 30 + rng.dirichlet(np.ones(DAYS - 1)) * (730 - 30 * (DAYS - 1))
    since = np.concatenate([[0.0], np.cumsum(gaps)])
    return [date(2024, 1, 15) + timedelta(days=float(round(d))) for d in since]


def _share(days: Sequence[date], day: date) -> float:
    return (day - days[0]) / (days[-1] - days[0])


def _calibrated(
    user: Machine, i: int, arm: Arm | RotaryDelta, folder: Path, described: list[str]
) -> None:
    """One day's file and its calibration."""
    rng = np.random.default_rng([49, user.number, i])
    day, _ = made(replace(user, arm=arm), user.poses, rng)
    file = f"measured-{i}.csv"
    write_readings(folder / file, user, day.joints, day.points, day.columns)
    init = ["init", file, *described, "--out", f"calibration-{i}", "--force", "--run"]
    asked(folder, *init)


def _added(result: str, day: date, folder: Path) -> str:
    """Add a calibration to the history; what went wrong, if anything did."""
    add = ["history", "machine.history", "--add", result, "--force"]
    done = asked(folder, *add, "--date", day.isoformat())
    return done.stderr[-300:] if done.returncode else ""


def of_machine(told: Draw) -> list[dict[str, Any]]:
    """The changes of the machine itself."""
    return [c for c in told["changes"] if c["name"].startswith(MACHINE)]


def _of_joint(told: Draw) -> list[dict[str, Any]]:
    j = told["joint"]
    names = (f"offset_{j}", f"theta_{j}", f"J{j}_rz", f"J{j}")
    return [c for c in of_machine(told) if c["name"] in names]


def row(way: str, draws: Sequence[Draw]) -> str:
    """Rates of one way to live."""
    every = len(draws)
    parts = [f"{way:8}{every:7d}", _rate(sum(bool(of_machine(d)) for d in draws), every)]
    if way != "steady":
        parts.append(_rate(sum(bool(_of_joint(d)) for d in draws), every))
        parts.append(_rate(sum(any(c["way"] == way for c in of_machine(d)) for d in draws), every))
    if way == "step":
        dated = sum(any(_dated(c, d["from"]) for c in of_machine(d)) for d in draws)
        parts.append(_rate(dated, every))
    return "".join(parts)


def _dated(change: dict[str, Any], first: int) -> bool:
    """Whether a step lies between the right two entries."""
    return change["way"] == "step" and bool(change["after"] < first <= change["before"])


def _rate(count: int, draws: int) -> str:
    low, high = interval(count, draws)
    held = f" ({100 * low:.0f} to {100 * high:.0f})"
    return f"{100 * count / max(draws, 1):9.0f}{held:13}"


HEAD = f"{'truth':8}{'draws':>7}" + "".join(
    f"{name:>9}{'':13}" for name in ("said %", "joint %", "way %", "dated %")
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=9)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    folder = given.folder.resolve()
    answers = folder / "answers.jsonl"
    if given.again:
        answers.unlink(missing_ok=True)
    numbers = range(given.first, given.first + given.machines)
    wanted = [(WAYS[(i + i // 3) % 3], i) for i in numbers]
    draws = complete(answers, wanted, partial(history, folder=folder), given.processes)
    rows = [row(way, [d for d in draws if d["kind"] == way]) for way in WAYS]
    failed = sum("failed" in d or bool(d["errors"]) for d in draws)
    text = "\n".join([HEAD, *rows, *([f"refused: {failed}"] if failed else [])])
    print(text)
    if given.write:
        write_block(given.write, "lives_history", text)


if __name__ == "__main__":
    main()
