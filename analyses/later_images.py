"""Does `verify` know another day of a camera: as calibrated, or what moved?

Robots of `analyses.cameras_truth` hold a camera, or a board before one, in turn. Each is calibrated
by 30 images and measured again by 15, by the command line:

    loopcal init day-1 --dh day-1/dh.csv --out calibration --run
    loopcal verify calibration/project-result DAY --json

On the later day nothing changed; the board stands elsewhere; a twentieth of the corners are wrong;
or the camera moved by 2 mm and 0.3 degrees; the board on the hand did; the zero of a joint moved by
0.05 degrees; the focal length or the print are 0.3 % longer. Reported are how often the machine is
called changed, how often the change is named, and how often it alone.

    python -m analyses.later_images [--robots 10] [--first 0] [--processes 2] [--folder FOLDER]
        [--write FILE.md]

The folder keeps files, calibrations and answers.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analyses.cameras_truth import Rig, Shots, motion, poses, shots
from analyses.gauntlet_asked import asked
from analyses.gauntlet_truth import turned_by
from analyses.kept import Draw, complete
from analyses.lives_truth import DEGREE
from analyses.rates import rate
from analyses.written import write_block

FOLDER = Path(".cache/later-images")
FIRST, LATER = 30, 15
"""Images of the days."""
BUMP, TURN, ZERO, LONGER = 2e-3, 0.3 * DEGREE, 0.05 * DEGREE, 3e-3
WRONG = 0.05

Rng = np.random.Generator


def _bump(rng: Rng) -> Any:
    """A motion by `BUMP` and `TURN`, either way about."""
    ways = rng.normal(size=(2, 3))
    shift, turn = ways / np.linalg.norm(ways, axis=1)[:, None]
    return motion(turned_by(TURN * turn[None])[0], BUMP * shift)


def camera_moved(rig: Rig, rng: Rng) -> Rig:
    if rig.held:
        return replace(rig, fixed=rig.fixed @ _bump(rng))
    return replace(rig, carried=rig.carried @ _bump(rng))


def board_moved(rig: Rig, rng: Rng) -> Rig:
    """The board on the hand."""
    return replace(rig, carried=rig.carried @ _bump(rng))


def elsewhere(rig: Rig, rng: Rng) -> Rig:
    """The board before a camera on the hand."""
    turn = turned_by(rng.uniform(-3.0, 3.0) * np.array([[0.0, 0.0, 1.0]]))[0]
    return replace(rig, fixed=motion(np.eye(3), rng.normal(0.0, 0.05, 3)) @ rig.fixed @ _of(turn))


def _of(turn: Any) -> Any:
    return motion(turn, np.zeros(3))


def zero_moved(rig: Rig, rng: Rng) -> Rig:
    """Of a joint of the middle, which places neither the base nor the flange."""
    j, links = int(rng.integers(1, 5)), list(rig.arm.links)
    links[j] = replace(links[j], offset=links[j].offset + ZERO)
    return replace(rig, arm=replace(rig.arm, links=tuple(links)))


def another_focus(rig: Rig, rng: Rng) -> Rig:
    lens = rig.lens.copy()
    lens[0] *= 1.0 + LONGER
    return replace(rig, lens=lens)


def another_print(rig: Rig, rng: Rng) -> Rig:
    return replace(rig, printed=rig.printed + np.array([LONGER, 0.0, 0.0, 0.0]))


def same(rig: Rig, rng: Rng) -> Rig:
    return rig


def _is_place(change: dict[str, Any], board: bool) -> bool:
    return change["kind"] in ("camera", "mounting") and (change["name"] == "board") == board


def _is_zero(change: dict[str, Any], rig: Rig, changed: Rig) -> bool:
    pairs = zip(rig.arm.links, changed.arm.links, strict=True)
    j = next(j for j, (one, other) in enumerate(pairs, 1) if one.offset != other.offset)
    causes = {change["name"], *change["alike"]}
    return not causes.isdisjoint({f"J{j}", f"offset_{j}", f"theta_{j}"})


Named = Callable[[dict[str, Any], Rig, Rig], bool]
Kind = tuple[Callable[[Rig, Rng], Rig], Named | None, Callable[[Rig], bool]]


def _any(rig: Rig) -> bool:
    return True


KINDS: dict[str, Kind] = {
    "same": (same, None, _any),
    "board elsewhere": (elsewhere, None, lambda rig: not rig.held),
    "wrong corners": (same, None, _any),
    "camera moved": (camera_moved, lambda c, a, b: _is_place(c, board=False), _any),
    "board moved": (board_moved, lambda c, a, b: _is_place(c, board=True), lambda rig: rig.held),
    "zero": (zero_moved, _is_zero, _any),
    "focus": (another_focus, lambda c, a, b: c["name"].endswith("_f"), _any),
    "print": (another_print, lambda c, a, b: c["kind"] == "print", _any),
}
"""What happened, whether a change that is named is this one, and to which robots it can happen."""


def robot(kind: str, number: int, root: Path) -> Draw:
    """All later days of one robot."""
    made = shots(1000 + number, held=number % 2 == 0, images=FIRST)
    folder = root / f"robot-{number:03d}"
    if not (folder / "calibration" / "project-result" / "result.json").exists():
        made.write(folder / "day-1")
        init = ["init", "day-1", "--dh", "day-1/dh.csv", "--out", "calibration", "--force", "--run"]
        asked(folder, *init)
    days = {}
    for place, (name, (event, _, happens)) in enumerate(KINDS.items()):
        if not happens(made.rig):
            continue
        rng = np.random.default_rng([50, number, place])
        rig = event(made.rig, rng)
        q = poses(rig, LATER, rng)
        uv = rig.pixels(rig.flange(q))
        uv = uv + rig.corner * rng.normal(size=uv.shape)
        if name == "wrong corners":
            bad = rng.random(uv.shape[:2]) < WRONG
            uv[bad] += rng.choice([-1.0, 1.0], (int(bad.sum()), 2)) * rng.uniform(3.0, 30.0)
        read = q + rig.encoder * rng.normal(size=q.shape)
        later = name.replace(" ", "-")
        Shots(rig, q, read, uv).write(folder / later)
        done = asked(folder, "verify", "calibration/project-result", later, "--json")
        days[name] = _answer(done.stdout, done.stderr, name, made.rig, rig)
    return {"kind": kind, "draw": number, "held": made.rig.held, "days": days}


def _answer(out: str, error: str, name: str, rig: Rig, changed: Rig) -> dict[str, Any]:
    try:
        document = json.loads(out)
    except json.JSONDecodeError:
        return {"refused": error[-300:]}
    every = (document.get("changes") or {}).get("found", [])
    named = KINDS[name][1]
    true = [named is not None and named(one, rig, changed) for one in every]
    passed = document["verdict"]["consistent"]["passed"]
    return {"passed": passed, "named": any(true), "alone": true == [True], "told": every}


def row(name: str, draws: Sequence[Draw]) -> str:
    answers = [d["days"][name] for d in draws if name in d["days"]]
    told = [one for one in answers if "refused" not in one]
    parts = [f"{name:17}{len(told):6d}", rate(one["passed"] is not True for one in told)]
    if KINDS[name][1] is not None:
        parts += [rate(one[key] for one in told) for key in ("named", "alone")]
    refused = len(answers) - len(told)
    return (
        parts[0]
        + "".join(f"{one:>20}" for one in parts[1:])
        + (f"  refused {refused}" if refused else "")
    ).rstrip()


HEAD = f"{'later day':17}{'draws':>6}" + "".join(
    f"{name + ' [%]':>20}" for name in ("changed", "named", "alone")
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    folder = given.folder.resolve()
    wanted = [("robot", i) for i in range(given.first, given.first + given.robots)]
    work = partial(robot, root=folder)
    draws = complete(folder / "answers.jsonl", wanted, work, given.processes)
    text = "\n".join([HEAD, *(row(name, draws) for name in KINDS)])
    print(text)
    if given.write:
        write_block(given.write, "later_images", text)


if __name__ == "__main__":
    main()
