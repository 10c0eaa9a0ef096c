"""Does `verify` leave an unchanged machine alone, and name what changed?

A six-axis arm is calibrated with a tracker, once per draw, with new link errors and new noise. On
another day the tracker stands elsewhere and the arm is measured in 30 other poses. The first 100
draws have two further days, on which the zero of a joint has moved by 0.02 degrees, or a length by
0.1 mm. `rigid` has no other error; `sagging` gives way in joints 2 and 3 under its weight on all
days, by up to 1 mrad, by code of this file. It is calibrated with the structured model error, whose
scales are learnt.

Reported: how often the test of the whole has p below 5 %, and how often what changed is not
"unchanged", with the 95 % interval of that rate; for a change, in how many draws it is as large as
the smallest one that is seen with 90 %, how often it is the first one named, how often it is named
or listed as not distinguishable, how many are listed, and how often the interval holds it.

    python -m analyses.what_changed [--draws 1000] [--processes 2] [--only KIND] [--write FILE.md]

Draws are kept in .cache/what_changed.jsonl as they end, and a run goes on where an earlier one
stopped. Remove that file after a change of the code that is judged.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import loopcal as lc
from analyses.instruments import ARM, FIRST, LAST, STATION, TOOL
from analyses.kept import complete
from analyses.rates import interval
from analyses.written import write_block
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.serial import serial_machine
from loopcal.mechanisms.structure.structured import structured

JOINTS = tuple(f"q{i}" for i in range(1, 7))
NOISE = lc.Noise({"q*": 2e-5, "T_range": 1e-5, "T_azimuth": 1e-5, "T_elevation": 1e-5})
POSES, LATER = 80, 30
CHANGED = 100
"""Draws that also have days with a change."""
KINDS = ("rigid", "sagging")
KEPT = Path(".cache/what_changed.jsonl")
CHANGES: Mapping[str, tuple[str, float]] = {
    "unchanged": ("", 0.0),
    "zero": ("offset_3", np.radians(0.02)),
    "length": ("a_2", 1e-4),
}


@dataclass(frozen=True)
class Seen:
    """One day: p-value of the innovation, whether it alarms, and what was named."""

    p_value: float
    alarm: bool
    first: bool
    listed: bool
    alike: int
    held: bool
    smallest: float


@cache
def arm(sagging: bool) -> lc.Mechanism:
    """The arm as drawn, seen by a tracker."""
    machine = serial_machine([lc.Joint(q) for q in JOINTS], name="six-axis arm")
    values = {f"{k}_{i}": v for k, row in ARM.items() for i, v in enumerate(row, 1)} | TOOL
    station = {f"T_{k}": v for k, v in STATION.items()}
    made = assemble(machine, [spherical("T")], values | station)
    made = made.with_parameters(made.parameters.with_fixed([*LAST, *FIRST]))
    return structured(made, harmonics=False, discrepancy=True) if sagging else made


def given_way(poses: Mapping[str, Any]) -> dict[str, Any]:
    """Where the joints of a sagging arm really are: two links and what hangs on the third."""
    upper = poses["q2"] - np.pi / 2
    lower = upper + poses["q3"]
    bent = 0.6 * np.cos(upper) + 0.4 * np.cos(lower)
    return {**poses, "q2": poses["q2"] + 1e-3 * bent, "q3": poses["q3"] + 0.6e-3 * np.cos(lower)}


def measured(machine: lc.Mechanism, kind: str, poses: dict[str, Any], seed: int) -> lc.Dataset:
    """Readings of these poses."""
    where = given_way(poses) if kind == "sagging" else poses
    data = lc.simulate(machine, where, noise=NOISE, seed=seed).dataset
    return data.with_readings({q: data[q] - (where[q] - poses[q]) for q in ("q2", "q3")})


def draw(kind: str, seed: int) -> dict[str, Any]:
    """One calibration, and other days: unchanged, and in the first draws changed too."""
    rng = np.random.default_rng([11, seed])
    drawn = arm(kind == "sagging")
    free = [p.name for p in drawn.parameters if not p.fixed and p.name[0] != "T"]
    nominal = {p.name: p.nominal for p in drawn.parameters}
    true = nominal | {n: nominal[n] + 5e-4 * rng.standard_normal() for n in free if "sag" not in n}
    first = measured(drawn.with_nominal(true), kind, joints(rng, POSES), seed)
    result = lc.calibrate(drawn, first, noise=NOISE, method="implicit-loop")
    days = {}
    for i, (change, (name, size)) in enumerate(CHANGES.items(), 1):
        if name and seed >= CHANGED:
            break
        there = {f"T_{k}": STATION[k] + rng.uniform(-1.0, 1.0) for k in STATION}
        moved = true | there | ({name: true[name] + size} if name else {})
        day = measured(drawn.with_nominal(moved), kind, joints(rng, LATER), seed + i * 10**6)
        days[change] = asdict(seen(lc.verify(result, day), name, size))
    return {"kind": kind, "draw": seed, "days": days}


def joints(rng: np.random.Generator, count: int) -> dict[str, Any]:
    return {q: rng.uniform(-1.4, 1.4, count) for q in JOINTS}


def seen(found: lc.Verification, name: str, size: float) -> Seen:
    """What a verification says of one true change, whose candidate is a parameter or its joint."""
    changes = found.changes
    assert changes is not None
    called = {name, f"q{name[-1]}" if name.startswith("offset") else name}
    first = changes.found[0] if changes.found else None
    named = [n for one in changes.found for n in (one.name, *(other.name for other in one.alike))]
    its = [one for one in changes.candidates if one.name in called]
    return Seen(
        found.innovation.p_value or 0.0,
        changes.verdict != "unchanged",
        first is not None and first.name in called,
        bool(called & {*named}),
        0 if first is None else len(first.alike),
        first is not None and first.name in called and bool(first.low <= size <= first.high),
        float(its[0].smallest or np.inf) if its else np.nan,
    )


def line(kind: str, change: str, made: Sequence[Seen]) -> str:
    def share(which: str) -> float:
        return 100.0 * float(np.mean([getattr(one, which) for one in made]))

    innovation = 100.0 * float(np.mean([one.p_value < 0.05 for one in made]))
    low, high = interval(sum(one.alarm for one in made), len(made))
    held = f"({100 * low:.1f} to {100 * high:.1f})"
    told = f"{kind:8}{change:10}{len(made):5d}{innovation:8.1f}{share('alarm'):9.1f} {held:15}"
    if change == "unchanged":
        return told.rstrip()
    alike = float(np.mean([one.alike for one in made]))
    named = [one for one in made if one.first]
    inside = 100.0 * float(np.mean([one.held for one in named])) if named else np.nan
    promised = 100.0 * float(np.mean([one.smallest <= CHANGES[change][1] for one in made]))
    return (
        f"{told}{promised:8.1f}{share('first'):8.1f}{share('listed'):8.1f}{alike:7.1f}{inside:7.1f}"
    )


HEAD = (
    f"{'arm':8}{'change':10}{'draws':>5}{'whole %':>8}{'changed %':>10}{'':15}"
    f"{'seen %':>7}{'first %':>8}{'listed %':>9}{'alike':>6}{'held %':>7}"
)


def table(draws: Sequence[dict[str, Any]]) -> str:
    """The rates of all draws."""
    lines = [HEAD]
    for kind in KINDS:
        its = [one["days"] for one in draws if one["kind"] == kind]
        for change in CHANGES if its else ():
            made = [Seen(**days[change]) for days in its if change in days]
            if made:
                lines.append(line(kind, change, made))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--keep", type=Path, default=KEPT)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    kinds = [given.only] if given.only else KINDS
    wanted = [(kind, i) for i in range(given.draws) for kind in kinds]
    text = table(complete(given.keep, wanted, draw, given.processes))
    print(text)
    if given.write:
        write_block(given.write, "what_changed", text)


if __name__ == "__main__":
    main()
