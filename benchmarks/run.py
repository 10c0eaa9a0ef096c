"""Times and memory beside other programs: `make benchmark`, or `python benchmarks/run.py --help`.

Results are checked for agreement before any time is told. Whether demands are met is printed and
does not change the exit code; programs that disagree end the run with exit code 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import both_engines
import command
import floor
import platform_poses
import report
import scale
from machine import this_machine
from measuring import DisagreementError
from threadpoolctl import threadpool_limits
from whole_solve import compare

from loopcal.expressions.choice import AVAILABLE

PARTS = ("six-axis", "scale", "engines", "command", "platform")
DOCUMENT = Path(__file__).parent.parent / "docs" / "explanation" / "performance.md"


def main() -> int:
    """Run what is asked for, print it, and write it where asked."""
    wanted = _arguments()
    machine = this_machine()
    texts: list[str] = [f"Measured {machine}."]
    data: dict[str, Any] = {"machine": asdict(machine)}
    print(texts[0], flush=True)

    def tell(text: str) -> None:
        print(f"\n{text}", flush=True)
        texts.append(text)

    try:
        if "six-axis" in wanted.only:
            found = [compare(poses, wanted.rounds) for poses in wanted.poses]
            data["six-axis"] = [asdict(comparison) for comparison in found]
            for comparison in found:
                tell(report.whole_solve(comparison))
        if "engines" in wanted.only and AVAILABLE:
            pairs = [both_engines.monte_carlo(), both_engines.elimination()]
            data["engines"] = [asdict(pair) for pair in pairs]
            tell(report.engines(pairs))
            shares = floor.measure()
            data["floor"] = [asdict(share) for share in shares]
            tell(report.shares(shares, floor.clock()))
    except DisagreementError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if "scale" in wanted.only:
        sizes = [scale.in_its_own_process(poses) for poses in wanted.sizes]
        data["scale"] = [asdict(size) for size in sizes]
        tell(report.sizes(sizes))
    if "command" in wanted.only:
        times = command.measure(wanted.rounds * 3)
        data["command"] = {name: asdict(t) for name, t in times.items()}
        tell(report.cold_start(times))
    seen = []
    if "platform" in wanted.only:
        seen = platform_poses.in_its_own_process()
        data["platform"] = [asdict(entry) for entry in seen]
        print(f"\n{report.platform(seen)}", flush=True)
    if wanted.json:
        Path(wanted.json).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    if wanted.document and len(texts) > 1:
        report.write_into(DOCUMENT, report.ALL, "\n\n".join(texts))
    if wanted.document and seen:
        report.write_into(DOCUMENT, "platform", f"{texts[0]}\n\n{report.platform(seen)}")
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--only", action="append", choices=PARTS, help="this part, may be repeated [all]"
    )
    parser.add_argument(
        "--poses", type=int, nargs="+", default=[1_000, 10_000], help="of the six-axis comparison"
    )
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[10_000, 100_000, 1_000_000], help="of the scale"
    )
    parser.add_argument("--rounds", type=int, default=3, help="of every program [3]")
    parser.add_argument("--json", metavar="FILE", help="write all times there")
    parser.add_argument(
        "--document", action="store_true", help=f"write the tables into {DOCUMENT.name}"
    )
    arguments = parser.parse_args()
    arguments.only = arguments.only or list(PARTS)
    return arguments


if __name__ == "__main__":
    with threadpool_limits(1, user_api="blas"):  # for every program alike
        sys.exit(main())
