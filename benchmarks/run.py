"""Times and memory beside other programs: `make benchmark`, or `python benchmarks/run.py --help`.

Results are checked for agreement before any time is told: programs that disagree end the run with
exit code 1. Whether demands are met is printed, and does not change the exit code.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import both_engines
import command
import default_call
import figure
import flatness
import floor
import floor_report
import images
import learning
import memory
import platform_poses
import report
import small_fits
import whole_robots
from machine import this_machine
from measuring import DisagreementError
from problems import PROBLEMS
from programs import PROGRAMS
from side_by_side import compare
from tables import write_into
from threadpoolctl import threadpool_limits

from loopcal.expressions.choice import AVAILABLE

DOCUMENT = Path(__file__).parent.parent / "docs" / "explanation" / "performance.md"


@dataclass
class Found:
    """What a run found so far: its text, the numbers behind it, and figures by name."""

    texts: list[str] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    figures: dict[str, str] = field(default_factory=dict)


def programs(found: Found, asked: argparse.Namespace) -> None:
    """All programs side by side, on every problem and number of poses."""
    words = f"Measured {found.numbers['machine']}."
    for name in asked.problems:
        compared = []
        for poses in asked.poses:
            say(f"{name}, {poses:,} poses")
            compared.append(compare(PROBLEMS[name](poses), PROGRAMS, asked.rounds))
        found.numbers[name] = [asdict(one) for one in compared]
        found.figures[name] = figure.drawn(compared, words)
        drawing = f"{asked.document.stem}/{name}.svg" if asked.document else None
        found.texts.append(report.side_by_side(compared, drawing))
        if name == "six-axis":
            found.texts += filter(None, [report.demands(compared)])
            sizes = [poses for poses in asked.poses if poses >= flatness.FROM]
            if len(sizes) > 1:
                flat = flatness.measure(sizes, asked.rounds)
                found.numbers["flatness"] = asdict(flat)
                found.texts.append(report.flat(flat))
    found.texts += filter(None, [report.absent()])


def engines(found: Found, asked: argparse.Namespace) -> None:
    """Both engines on other problems."""
    if not AVAILABLE:
        return
    pairs = [both_engines.monte_carlo(), both_engines.elimination()]
    found.numbers["engines"] = [asdict(pair) for pair in pairs]
    found.texts.append(report.engines(pairs))


def small(found: Found, asked: argparse.Namespace) -> None:
    """Small fits beside odrpack."""
    if find_spec("odrpack") is None:
        return
    cases = small_fits.measure()
    found.numbers["small"] = [asdict(case) for case in cases]
    found.texts.append(report.small(cases))


def arithmetic(found: Found, asked: argparse.Namespace) -> None:
    """Where the compiled engine's time goes."""
    if not AVAILABLE:
        return
    measured = floor.measure()
    found.numbers["floor"] = asdict(measured)
    found.texts.append(floor_report.floor(measured))


def memories(found: Found, asked: argparse.Namespace) -> None:
    """Peak memory from 10,000 poses on."""
    sizes = [memory.in_its_own_process(poses) for poses in asked.poses if poses >= 10_000]
    found.numbers["memory"] = [asdict(size) for size in sizes]
    if sizes:
        found.texts.append(report.sizes(sizes))


def commands(found: Found, asked: argparse.Namespace) -> None:
    """The command from a cold start."""
    times, study = command.measure(asked.rounds), command.study()
    found.numbers["command"] = {name: asdict(t) for name, t in times.items()} | {"study": study}
    found.texts.append(report.cold_start(times, study))


def platforms(found: Found, asked: argparse.Namespace) -> None:
    """A parallel machine."""
    seen = platform_poses.in_its_own_process()
    found.numbers["platform"] = [asdict(entry) for entry in seen]
    found.texts.append(report.platform(seen))


def learnt(found: Found, asked: argparse.Namespace) -> None:
    """Sds learnt, and validated."""
    cases = learning.measure()
    found.numbers["learning"] = [asdict(case) for case in cases]
    found.texts.append(report.learnt(cases))


def defaults(found: Found, asked: argparse.Namespace) -> None:
    """The default call, and a stream with a model error."""
    cases = default_call.measure()
    found.numbers["default"] = [asdict(case) for case in cases]
    found.texts.append(report.defaults(cases))


def trees(found: Found, asked: argparse.Namespace) -> None:
    """An arm as a tree of bodies beside the chain, and a humanoid."""
    measured = whole_robots.measure()
    found.numbers["trees"] = asdict(measured)
    found.texts.append(report.trees(measured))


def many_images(found: Found, asked: argparse.Namespace) -> None:
    """A camera on a hand, beside Ceres."""
    measured = images.measure()
    found.numbers["images"] = asdict(measured)
    found.texts.append(report.images(measured))


PARTS: dict[str, Callable[[Found, argparse.Namespace], None]] = {
    "programs": programs,
    "engines": engines,
    "small": small,
    "floor": arithmetic,
    "memory": memories,
    "command": commands,
    "platform": platforms,
    "learning": learnt,
    "default": defaults,
    "trees": trees,
    "images": many_images,
}
CHECKED = {"programs", "engines", "small", "images"}
"""Parts that compare results: nothing is told before all of them have."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for, print it, and write it where asked."""
    asked = _asked(arguments)
    machine = this_machine()
    found = Found([f"Measured {machine}."], {"machine": str(machine)})
    parts = [part for part in PARTS if part in asked.only]
    told = 0
    try:
        for i, part in enumerate(parts):
            say(part)
            PARTS[part](found, asked)
            if CHECKED.isdisjoint(parts[i + 1 :]):
                print("\n\n".join(found.texts[told:]), end="\n\n", flush=True)
                told = len(found.texts)
    except DisagreementError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    _write(found, asked)
    return 0


def _write(found: Found, asked: argparse.Namespace) -> None:
    """Into the files that were asked for."""
    if asked.json:
        Path(asked.json).write_text(json.dumps(found.numbers, indent=1) + "\n", encoding="utf-8")
    if asked.document:
        write_into(asked.document, "measured", "\n\n".join(found.texts))
        for name, svg in found.figures.items():
            asked.document.with_suffix("").mkdir(exist_ok=True)
            (asked.document.with_suffix("") / f"{name}.svg").write_text(svg, encoding="utf-8")


def say(words: str) -> None:
    """How far a run is, for who waits."""
    print(f"... {words}", file=sys.stderr, flush=True)


def _asked(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts [all]")
    parser.add_argument(
        "--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), help="[all]"
    )
    sizes = [100, 1_000, 10_000, 100_000, 1_000_000]
    parser.add_argument("--poses", type=int, nargs="+", default=sizes, help="numbers of poses")
    parser.add_argument("--rounds", type=int, default=9, help="of any program at most [9]")
    parser.add_argument("--json", metavar="FILE", help="write all times there")
    words = f"write into {DOCUMENT.name}, or another file with its markers, and draw figures"
    parser.add_argument("--document", type=Path, nargs="?", const=DOCUMENT, help=words)
    asked, whole = parser.parse_args(arguments), parser.parse_args([])
    if asked.document == DOCUMENT and {**vars(asked), "document": None, "json": None} != vars(
        whole
    ):
        parser.error(f"{DOCUMENT.name} is written by whole runs; name another FILE for parts")
    return asked


if __name__ == "__main__":
    with threadpool_limits(1, user_api="blas"):  # for every program alike
        sys.exit(main())
