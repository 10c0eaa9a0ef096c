"""Trained in one corner of the workspace, tested on the rest: least squares, nominal and auto.

Of the measured MA1400 workspace set (poses from 170 on) a corner is a pose and those nearest to it
by the cosine and sine of its joints. Each corner calibrates by the nominal machine, placed and
mounted, by least squares and by auto, with nothing stated but the drawing and the noise of the
encoders; all other poses are predicted. Printed are the rms of each, the share of those poses in
the stated 95 % regions of auto, the ratio by which the verdict judges the working region and
whether it accepts it, and in the geometric mean auto over the better of the other two.

    LOOPCAL_DATA=/path/to/data python -m analyses.corners [--corners 20] [--poses 60] [--write]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.written import write_block
from loopcal.estimation.result import FitResult
from loopcal.statistics.case import Case, nominal_case
from loopcal.statistics.folds import Scheme
from loopcal.statistics.validation import validated

PROJECT = Path(__file__).parents[1] / "examples/motoman/right_arm_workspace.toml"
PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "model-error.md"
SETTLED = 170
"""The reflector slipped three times before this pose."""


@dataclass(frozen=True)
class Measured:
    """The workspace set once the reflector stays: its project, the poses, and the stated noise."""

    project: lc.Project
    data: lc.Dataset
    noise: lc.Noise


def measured() -> Measured:
    """The set as both analyses of it read it."""
    project = lc.read_project(PROJECT)
    loaded = lc.load_dataset(project)
    data = loaded.dataset.take(np.arange(SETTLED, len(loaded.dataset)))
    return Measured(project, data, loaded.noise)


def by_distance(data: lc.Dataset, centre: int) -> NDArray[np.intp]:
    """The positions of all poses, the nearest to one of them in joint space first."""
    joints = np.array([data[f"theta_{i}"] for i in range(1, 7)])
    features = np.vstack([np.cos(joints), np.sin(joints)])
    off = np.square(features - features[:, [centre]]).sum(axis=0)
    return np.argsort(off, kind="stable")


def rms_elsewhere(case: Case, whole: FitResult, rest: lc.Dataset) -> tuple[float, float]:
    """Root mean square distance [m] at other poses, and the share in the stated regions."""
    found = validated(case, whole, Scheme(other=rest))
    assert found.accuracy is not None
    return found.accuracy.rms, found.coverage.share if found.coverage else np.nan


def main() -> None:
    """Print one line per corner, and the geometric means; write them into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--corners", type=int, default=20)
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    asked = parser.parse_args()
    its = measured()
    mechanism, data, noise = its.project.mechanism, its.data, its.noise
    centres = np.random.default_rng(0).choice(len(data), asked.corners, replace=False)
    ratios, shares = [], []
    lines = ["  pose  nominal  least squares  auto [mm]    held  ratio  region"]
    print(lines[0])
    for centre in centres:
        inside = by_distance(data, int(centre))[: asked.poses]
        some = data.take(np.sort(inside))
        rest = data.take(np.setdiff1d(np.arange(len(data)), inside))
        case = Case(mechanism, some, noise, lc.Fit(method="auto"))
        auto = lc.calibrate(mechanism, some, noise=noise, fit=case.fit)
        least = lc.Fit(method="least-squares")
        plain = Case(mechanism, some, None, least)
        drawn = nominal_case(case)
        nominal, _ = rms_elsewhere(drawn, drawn.calibrated(), rest)
        squares, _ = rms_elsewhere(plain, plain.calibrated(), rest)
        own, held = rms_elsewhere(Case(auto.mechanism, some, noise, auto.fit), auto, rest)
        ratios.append(own / min(nominal, squares))
        shares.append(held)
        assert auto.verdict is not None
        valid = auto.verdict.valid
        figures = f"{1e3 * nominal:8.3f} {1e3 * squares:14.3f} {1e3 * own:10.3f} {held:7.1%}"
        said = "accepted" if valid.passed else "refused"
        ratio = "   inf" if valid.number is None else f"{valid.number:6.1f}"
        lines.append(f"{data.poses[centre]:>6} {figures} {ratio}  {said}")
        print(lines[-1], flush=True)
    mean = float(np.exp(np.mean(np.log(ratios))))
    lines += [
        "",
        f"auto over the better of nominal and least squares: {mean:.2f} (geometric mean)",
        f"poses in the stated regions: {np.mean(shares):.1%}",
    ]
    print("\n".join(lines[-2:]))
    if asked.write:
        write_block(PAGE, "corners", "\n".join(lines))


if __name__ == "__main__":
    main()
