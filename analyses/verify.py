"""How often does `verify` call an unchanged machine changed, and see a joint zero that moved?

The setups of `analyses.instruments`, each calibrated once per draw. On another day the instrument
stands elsewhere (stations anywhere, anchors up to 0.3 m away; what the machine touches stays where
it was), every second pose is measured again with new noise, and the result is verified: as it is,
and with the zero of one joint moved by 1 mrad. Beside these rates stand the ratio of the accuracy
found to the one that the stated covariance expects, and the share of placed parameters whose 95 %
interval holds the truth.

    python -m analyses.verify [--draws 200] [--processes 2] [--only WORD ...] [--write FILE.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.instruments import SETUPS, SIGMAS, Setup, setup
from analyses.written import write_block

Array = NDArray[np.float64]
MOVED = 1e-3
"""By how much the zero of a joint moves [rad or m]."""
LEVEL = 0.05


@dataclass(frozen=True)
class Rates:
    """Of some draws: p-values unchanged and with a moved zero, accuracy ratio, coverage."""

    unchanged: Array
    moved: Array
    ratio: Array
    held: Array


def another_day(given: Setup, seed: int) -> lc.Mechanism:
    """The true machine with its instruments elsewhere."""
    if given.start:
        return given.truth  # the poses touch something: it stays where it is
    rng = np.random.default_rng([7, seed])
    values = {p.name: p.nominal for p in given.truth.parameters}
    for family in given.truth.families:
        anchor = family.placement is None
        for name in family.standing:
            turn = given.truth.parameters[name].unit == "rad"
            values[name] += rng.uniform(-1, 1) * (0.3 if anchor else 1.0 if turn else 2.0)
    return given.truth.with_nominal(values)


def joint(given: Setup) -> str:
    """The third joint that is read, or the last before it."""
    names = [q for q in given.driven if given.truth.quantities[q] in ("rad", "m")]
    names = [q for q in names if q not in given.unread and not q.endswith("_b")]
    if not names:  # a platform: its legs are read
        names = [
            q for q in given.truth.quantities if q not in (*given.unread, *given.truth.outputs)
        ]
    return names[min(2, len(names) - 1)]


def run(name: str, seeds: Sequence[int]) -> Rates:
    """One setup, once for each seed."""
    given = setup(name)
    found: dict[str, list[float]] = {"unchanged": [], "moved": [], "ratio": [], "held": []}
    some = {q: v[::2] for q, v in given.driven.items()}
    start = {q: np.asarray(v)[::2] if np.ndim(v) else v for q, v in given.start.items()}
    for seed in seeds:
        made = lc.simulate(
            given.truth, given.driven, noise=given.noise, seed=seed, start=given.start
        )
        nominal = given.nominal(seed)
        nominal = nominal.with_parameters(nominal.parameters.with_fixed(given.held))
        result = lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")
        truth = another_day(given, seed)
        day = lc.simulate(truth, some, noise=given.noise, seed=seed + 10**6, start=start)
        same = lc.verify(result, day.dataset)
        which = joint(given)
        off = day.dataset.with_readings({which: day.dataset[which] + MOVED})
        other = lc.verify(result, off)
        found["unchanged"].append(same.innovation.p_value or 0.0)
        found["moved"].append(other.innovation.p_value or 0.0)
        if same.calibrated and same.expected:
            found["ratio"].append(same.calibrated.rms / same.expected.rms)
        true = {p.name: p.nominal for p in truth.parameters}
        inside = [abs(true[q.name] - q.value) <= SIGMAS * q.sd for q in same.placed if q.sd]
        if inside:
            found["held"].append(float(np.mean(inside)))
    return Rates(*(np.array(values) for values in found.values()))


def line(name: str, parts: Sequence[Rates]) -> str:
    joined = {
        key: np.concatenate([getattr(part, key) for part in parts])
        for key in ("unchanged", "moved", "ratio", "held")
    }
    ratio = np.sqrt(np.square(joined["ratio"]).mean()) if joined["ratio"].size else np.nan
    held = 100.0 * joined["held"].mean() if joined["held"].size else np.nan
    return (
        f"{name:38} {100 * (joined['unchanged'] < LEVEL).mean():6.1f}"
        f" {100 * (joined['moved'] < LEVEL).mean():8.1f} {ratio:9.3f} {held:9.1f}"
    )


HEAD = f"{'machine and instrument':37} false %  power %  rms/expected  held %"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    print(f"{given.draws} draws\n{HEAD}")
    parts = [range(i, given.draws, given.processes) for i in range(given.processes)]
    lines = []
    with ProcessPoolExecutor(given.processes) as pool:
        for name in (n for n in SETUPS if {*given.only} <= {*n.split()}):
            lines.append(line(name, list(pool.map(run, repeat(name), parts))))
            print(lines[-1], flush=True)
    if given.write:
        write_block(given.write, "verify", "\n".join([HEAD, *lines]))


if __name__ == "__main__":
    main()
