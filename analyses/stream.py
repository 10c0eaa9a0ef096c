"""Time and memory of a calibration from a stream: `python -m analyses.stream --poses 1e7`.

Simulated readings of the MA1400 go into a folder of Parquet files, half a million poses each;
`loopcal calibrate` then runs in a process of its own, whose peak memory is taken: alone, and with
--workers, which must come to the same result to the last digit. --write puts what is printed into
docs/how-to/large-files.md. The folder is removed at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import polars as pl

from analyses.written import write_block
from loopcal import Noise
from loopcal.mechanisms.planar import motoman_ma1400
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate

PART = 500_000
TRUTH = {"x1": 0.153, "z2": 0.612, "phix1": 0.003}
PROJECT = """schema = 1
fit = { method = "implicit-loop" }
title = "A stream of the MA1400"
[mechanism]
type = "motoman-ma1400"
[data]
file = "poses"
[noise]
"theta_*" = { sd = 50, unit = "urad" }
xyz = { sd = 10, unit = "um" }
"""
DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "large-files.md"


def write_poses(folder: Path, poses: int) -> None:
    """Parts of PART poses, each of its own seed."""
    arm = motoman_ma1400()
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    ranges = {f"theta_{j}": (-1.5, 1.5) for j in range(1, 7)}
    folder.mkdir()
    for seed, begin in enumerate(range(0, poses, PART)):
        driven = random_poses(ranges, min(PART, poses - begin), seed=seed)
        made = simulate(arm, driven, noise=noise, seed=seed, truth=TRUTH).dataset
        frame = pl.DataFrame({q: made[q] for q in arm.quantities})
        frame.write_parquet(folder / f"part-{seed:04d}.parquet")


@dataclass(frozen=True)
class Run:
    """One run of the command: its seconds, its peak memory [bytes], and what it found."""

    took: float
    peak: float
    document: dict[str, Any]

    def words(self) -> str:
        return f"{self.took:,.0f} s, peak memory {self.peak / 1e6:,.0f} MB"


def calibrated(folder: Path, *options: str) -> Run:
    """Run the command in a folder."""
    command = [sys.executable, "-m", "loopcal", "calibrate", "project.toml", "--no-report"]
    begun = time.perf_counter()
    process = subprocess.Popen([*command, *options], cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    took = time.perf_counter() - begun
    if status:
        raise SystemExit(f"the calibration ended with {status}")
    document = json.loads((folder / "project-result" / "result.json").read_text("utf-8"))
    return Run(took, usage.ru_maxrss * 1024, document)


def told(folder: Path, workers: int) -> str:
    """What to tell of one process, and of as many workers."""
    alone, shared = calibrated(folder), calibrated(folder, "--workers", str(workers))
    document = alone.document
    if document["parameters"] != shared.document["parameters"]:
        raise SystemExit("the workers found something else")
    poses, chi = document["data"]["used"], document["chi_squared"]
    size = sum(path.stat().st_size for path in (folder / "poses").iterdir())
    worst = max(
        abs(TRUTH[p["name"]] - p["value"]) / p["sd"]
        for p in document["parameters"]
        if p["name"] in TRUTH
    )
    return "\n".join(
        [
            f"{poses:,} poses, {size / 1e6:,.0f} MB of Parquet, "
            f"{document['status']['iterations']} iterations",
            f"alone: {alone.words()}",
            f"--workers {workers}: {shared.words()}, the same result to the last digit",
            f"chi-squared per degree of freedom {chi['variance_factor']:.5f}, p = "
            f"{chi['p_value']:.2g}; the true parameters that were moved are found within "
            f"{worst:.1f} sds",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=float, nargs="+", default=[1e6, 1e7])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    lines = []
    for poses in asked.poses:
        with tempfile.TemporaryDirectory(dir=Path.cwd()) as name:
            folder = Path(name)
            # a process begins with the peak of the one that starts it: this one stays small
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as apart:
                apart.submit(write_poses, folder / "poses", int(poses)).result()
            (folder / "project.toml").write_text(PROJECT, "utf-8")
            lines.append(told(folder, asked.workers))
            print(lines[-1], flush=True)
    if asked.write:
        write_block(DOCUMENT, "stream", "\n\n".join(lines))


if __name__ == "__main__":
    main()
