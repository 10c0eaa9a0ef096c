"""Iterations and evaluations per pose of fits of alike poses: the left-arm grid, flat priors.

All poses, then random hundreds of them; the reflector starts at its mounting, 0.5 m and 0.9 m off.
LOOPCAL_DATA names the folder of measured data.

On 43 parts of this grid least squares took 19 evaluations per pose (median) with steps that are
corrected along the valley, and 61 with steps that may rise; MINPACK takes 116 and ends no lower.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

import loopcal as lc

FILE = Path(os.environ["LOOPCAL_DATA"]) / "motoman_ma1400_leica" / "left_arm_grid.csv"
HUNDREDS = 5
COLUMNS = {f"theta_{i}": name for i, name in enumerate("SLURBT", 1)} | {
    axis: {"column": axis, "unit": "m", "sd_column": f"u_{axis}"} for axis in "xyz"
}


def main() -> None:
    data = lc.read_dataset(FILE, COLUMNS, pose="pose")
    choose = [np.random.default_rng(seed).permutation(len(data)) for seed in range(HUNDREDS)]
    sets = [data, *(data.take(order[:100]) for order in choose)]
    noise = lc.Noise({"theta_*": 5e-5})
    print("method          reflector  poses  iterations  evaluations  status")
    for method in ("least-squares", "implicit-loop", "reweighted"):
        for z in (-0.45, 0.05, 0.45):
            start = {"x6B": 0.05, "y6B": 0.0, "z6B": z}
            arm = lc.motoman_ma1400(start, before={"rz": math.pi / 2})
            for poses in sets:
                status = lc.calibrate(arm, poses, noise=noise, method=method).status
                print(
                    f"{method:15} {z:9.2f} {len(poses):6} {status.iterations:11}"
                    f" {status.evaluations:12.0f}  {status.reason}"
                )


if __name__ == "__main__":
    main()
