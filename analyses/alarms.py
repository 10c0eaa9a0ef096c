"""How often does the verdict find fault with data that have none, all codes together?

Clean sets of the gauntlet (`analyses.gauntlet_worlds`): robots, instruments and numbers of poses,
with stated sds and without, calibrated by the default call and by methods by name. An alarm is a
verdict whose first answer is not "sound", be it "no" or "open". Printed are the alarms of each
method and of each number of poses, and what they were.

    python -m analyses.alarms [--draws 10] [--first 0] [--processes 2] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import json
import warnings
import zlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import Parallel, World
from analyses.rates import interval
from analyses.written import write_block
from loopcal.statistics.verdict import findings_of

PAGE = Path("docs/explanation/gauntlet.md")
KEPT = Path(".cache/alarms.jsonl")
SMALL, MIDDLE, LARGE = "12 to 20 poses", "30 poses", "100 poses and more"
METHODS = ("auto", "implicit-loop", "reweighted", "least-squares")


def _worlds() -> dict[str, tuple[str, World | Parallel]]:
    """Name -> its size and what is drawn."""
    found: dict[str, tuple[str, World | Parallel]] = {}
    few = {"six": 20, "seven": 20, "scara": 15, "planar": 12}
    for machine, least in few.items():
        for size, poses in ((SMALL, least), (MIDDLE, 30), (LARGE, 100)):
            found[f"{machine}, {poses}"] = size, World(machine, poses=poses)
    for machine in ("hexapod", "delta", "five-bar"):
        for size, poses in ((MIDDLE, 30), (LARGE, 100)):
            found[f"{machine}, {poses}"] = size, Parallel(machine, poses=poses)
    for instrument in ("three reflectors", "two trackers", "wire", "camera"):
        sd = {"wire": 1e-4, "camera": 3e-4}.get(instrument, 1.5e-5)
        for size, poses in ((MIDDLE, 40), (LARGE, 120)):
            world = World(instrument=instrument, poses=poses, sd=sd)
            found[f"{instrument}, {poses}"] = size, world
    for machine, size, poses in (("six", SMALL, 20), ("six", LARGE, 250), ("scara", LARGE, 100)):
        found[f"{machine}, {poses}, no sds"] = size, World(machine, poses=poses, stated=None)
    found["six, 40, path"] = MIDDLE, World(poses=40, order="path")
    found["six, 150, path"] = LARGE, World(poses=150, order="path")
    found["six, 100, sds learnt"] = LARGE, World(poses=100, learnt=True, stated=3.0)
    found["planar, 15, sds learnt"] = SMALL, World("planar", poses=15, learnt=True, stated=3.0)
    return found


WORLDS = _worlds()


def run(name: str, method: str, draw: int) -> dict[str, Any] | None:
    """What a verdict says of one clean set; None where the method cannot have these readings."""
    _, world = WORLDS[name]
    trial = world.made(np.random.default_rng([zlib.crc32(name.encode()), 18, draw]))
    noise = None if method == "least-squares" else trial.noise
    found: dict[str, Any] = {"world": name, "method": method, "draw": draw}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = lc.calibrate(trial.mechanism, trial.readings, noise=noise, method=method)
            answer = lc.verdict(result).sound
            document = result.document
        except lc.InputError as refused:
            if method == "auto":
                return found | {"sound": False, "codes": [refused.code], "words": str(refused)}
            return None
    # "untested" is no finding of data: nobody asked for a validation
    against = [one for one in findings_of(document) if one.severity != "info"]
    codes = [one.code for one in against if one.question == "sound" and one.code != "untested"]
    if not codes:
        return found | {"sound": True, "codes": [], "words": ""}
    return found | {"sound": answer.passed, "codes": codes, "words": answer.words}


def table(draws: Sequence[dict[str, Any]]) -> str:
    """Alarms by method, by size and over all, and the codes behind them."""
    lines = [f"{'':24} {'draws':>6} {'alarms %':>9} {'':15} {'refused %':>9}"]
    for method in METHODS:
        lines.append(_line(method, [d for d in draws if d["method"] == method]))
    for size in (SMALL, MIDDLE, LARGE):
        its = [d for d in draws if WORLDS[d["world"]][0] == size]
        lines.append(_line(size, its))
    lines += [_line("all", draws), ""]
    codes = Counter(code for d in draws if not d["sound"] for code in d["codes"])
    lines += [f"{code:34} {count:5d}" for code, count in codes.most_common()]
    return "\n".join(lines)


def _line(name: str, draws: Sequence[dict[str, Any]]) -> str:
    alarms = sum(d["sound"] is not True for d in draws)
    low, high = interval(alarms, len(draws)) if draws else (0.0, 1.0)
    count = max(len(draws), 1)
    refused = 100.0 * sum(d["sound"] is False for d in draws) / count
    held = f"({100 * low:.1f} to {100 * high:.1f})"
    return f"{name:24} {len(draws):6d} {100.0 * alarms / count:9.1f} {held:15} {refused:9.1f}"


def main() -> None:
    """Print the table, and write it into a page."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=10)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new seed each")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    options.add_argument("--keep", type=Path, default=KEPT, help="draws of one code, as they end")
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    seeds = range(asked.first, asked.first + asked.draws)
    todo = [(name, method, seed) for seed in seeds for name in WORLDS for method in asked.methods]
    asked.keep.parent.mkdir(parents=True, exist_ok=True)
    made = []
    with (
        asked.keep.open("w", encoding="utf-8") as file,
        ProcessPoolExecutor(asked.processes) as pool,
    ):
        for future in as_completed([pool.submit(run, *which) for which in todo]):
            if (found := future.result()) is not None:
                made.append(found)
                file.write(json.dumps(found) + "\n")
                file.flush()
    text = table(made)
    print(text)
    if asked.write:
        write_block(asked.write, "alarms", text)


if __name__ == "__main__":
    main()
