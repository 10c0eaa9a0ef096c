"""Trained in one corner of the workspace, tested on the rest: least squares, nominal and auto.

Of the measured MA1400 workspace set (poses from 170 on) a corner is a pose and those nearest to it
by the cosine and sine of its joints. Each corner calibrates by the nominal machine, placed and
mounted, by least squares and by auto, with nothing stated but the drawing and the noise of the
encoders; all other poses are predicted. Printed are the rms of each, the share of those poses in
the stated 95 % regions of auto, and in the geometric mean auto over the better of the other two.

    LOOPCAL_DATA=/path/to/data python -m analyses.corners [--corners 20] [--poses 60]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.statistics.candidates import nominal_case
from loopcal.statistics.folds import Scheme
from loopcal.statistics.validation import Case, validated

PROJECT = Path(__file__).parents[1] / "examples/motoman/right_arm_workspace.toml"
SETTLED = 170
"""The reflector slipped three times before this pose."""


def corner(data: lc.Dataset, centre: int, poses: int) -> NDArray[np.intp]:
    """The positions of the poses nearest to one in joint space."""
    joints = np.array([data[f"theta_{i}"] for i in range(1, 7)])
    features = np.vstack([np.cos(joints), np.sin(joints)])
    off = np.square(features - features[:, [centre]]).sum(axis=0)
    return np.argsort(off, kind="stable")[:poses]


def rms_elsewhere(case: Case, whole: lc.Result, rest: lc.Dataset) -> tuple[float, float]:
    """Root mean square distance [m] at other poses, and the share in the stated regions."""
    found = validated(case, whole, Scheme(other=rest))
    assert found.accuracy is not None
    return found.accuracy.rms, found.coverage.share if found.coverage else np.nan


def main() -> None:
    """Print one line per corner, and the geometric means."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--corners", type=int, default=20)
    parser.add_argument("--poses", type=int, default=60)
    asked = parser.parse_args()
    project = lc.read_project(PROJECT)
    loaded = lc.load_dataset(project)
    data = loaded.dataset.take(np.arange(SETTLED, len(loaded.dataset)))
    centres = np.random.default_rng(0).choice(len(data), asked.corners, replace=False)
    ratios, shares = [], []
    print("centre  nominal  least squares  auto [mm]  held  chosen")
    for centre in centres:
        inside = corner(data, int(centre), asked.poses)
        some = data.take(np.sort(inside))
        rest = data.take(np.setdiff1d(np.arange(len(data)), inside))
        case = Case(project.mechanism, some, loaded.noise, lc.Fit(method="auto"))
        auto = lc.calibrate(project.mechanism, some, noise=loaded.noise, fit=case.fit)
        least = lc.Fit(method="least-squares")
        plain = Case(project.mechanism, some, None, least)
        drawn = nominal_case(case)
        nominal, _ = rms_elsewhere(drawn, drawn.calibrated(), rest)
        squares, _ = rms_elsewhere(plain, plain.calibrated(), rest)
        own, held = rms_elsewhere(Case(auto.mechanism, some, loaded.noise, auto.fit), auto, rest)
        ratios.append(own / min(nominal, squares))
        shares.append(held)
        name = auto.chosen.method if auto.chosen else ""
        figures = f"{1e3 * nominal:8.3f} {1e3 * squares:13.3f} {1e3 * own:10.3f} {held:6.1%}"
        print(f"{data.poses[centre]:>6} {figures}  {name}", flush=True)
    mean = float(np.exp(np.mean(np.log(ratios))))
    print(f"auto over the better of nominal and least squares: {mean:.3f} (geometric mean)")
    print(f"poses in the stated regions: {np.mean(shares):.1%}")


if __name__ == "__main__":
    main()
