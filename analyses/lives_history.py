"""Does the history find the machines that drift, and date the step of those that have one?

Arms of `analyses.lives_truth` are measured on eight days over two years and calibrated anew each
time, the tracker elsewhere each day. A third of them stay as they are; of a third the zero of one
joint steps by 0.05 degrees between two of the days; of a third it creeps by 0.08 degrees over the
two years. As the user sees it:

    loopcal init measured-3.csv --dh dh.csv --out calibration-3 --run
    loopcal history machine.history --add calibration-3/project-result --date 2025-02-10
    loopcal history machine.history --json

Reported is how often the history says that anything of the machine changed, has the zero of the
joint that did among its causes, names it alone, names others without it, names the way (step or
drift), and, for a step, places it between the right two days; of arms, and of machines whose zeros
no single calibration determines.

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
    told["family"] = user.family
    try:
        document = json.loads(done.stdout)
    except json.JSONDecodeError:
        return told | {"failed": done.stderr[-400:], "changes": []}
    rates = {t["name"]: t["rate"] for t in document["trends"] if t.get("rate") is not None}
    return told | {"changes": document["changes"], "rates": rates}


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


def _true(change: dict[str, Any], j: int) -> bool:
    """Whether the zero of joint j is among the causes."""
    zeros = {f"offset_{j}", f"theta_{j}", f"theta_{j}_offset", f"J{j}_rz", f"zero of J{j}"}
    return not zeros.isdisjoint(change["causes"])


def row(way: str, kind: str, draws: Sequence[Draw]) -> str:
    """Rates of one way to live."""
    every, changes = len(draws), [d["changes"] for d in draws]
    parts = [f"{way:8}{kind:8}{every:6d}", _rate(sum(map(bool, changes)), every)]
    if way != "steady":
        true = [[_true(c, d["joint"]) for c in its] for d, its in zip(draws, changes, strict=True)]
        alone = [
            any(t and len(c["causes"]) == 1 for c, t in zip(its, known, strict=True))
            for its, known in zip(changes, true, strict=True)
        ]
        parts += [_rate(sum(map(any, true)), every), _rate(sum(alone), every)]
        parts.append(_rate(sum(not all(one) for one in true), every))
        parts.append(_rate(sum(any(c["way"] == way for c in its) for its in changes), every))
    if way == "step":
        both = zip(draws, changes, strict=True)
        parts.append(_rate(sum(any(_dated(c, d["from"]) for c in its) for d, its in both), every))
    return "".join(parts)


def _dated(change: dict[str, Any], first: int) -> bool:
    """Whether a step lies between the right two entries."""
    return change["way"] == "step" and bool(change["after"] < first <= change["before"])


def _rate(count: int, draws: int) -> str:
    low, high = interval(count, draws)
    held = f" ({100 * low:.0f} to {100 * high:.0f})"
    return f"{100 * count / max(draws, 1):6.0f}{held:12}"


HEAD = f"{'truth':8}{'machine':8}{'draws':>6}" + "".join(
    f"{name:>6}{'':12}" for name in ("said", "joint", "alone", "other", "way", "dated")
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
    loops = ("palletiser", "delta")
    rows = [
        row(way, kind, [d for d in draws if d["kind"] == way and (d["family"] in loops) == other])
        for way in WAYS
        for kind, other in (("arms", False), ("others", True))
    ]
    failed = sum("failed" in d or bool(d["errors"]) for d in draws)
    text = "\n".join([HEAD, *rows, *([f"refused: {failed}"] if failed else [])])
    print(text)
    if given.write:
        write_block(given.write, "lives_history", text)


if __name__ == "__main__":
    main()
