"""Two fits on random halves of the left-arm grid, compared over the whole joint box.

For each split: the share of 300 joint vectors, drawn from the box between the smallest and largest
reading of each joint, at which the two predicted end points differ by no more than the 95 % region
of the sum of their covariances; the median difference; whether both predictions warned.
LOOPCAL_DATA names the folder of measured data.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

import loopcal as lc

SPLITS, POSES = 60, 300
LIMIT = 7.814727903251179  # chi-squared, 3 degrees of freedom, 95 %
CASES = (
    ("least-squares", True),
    ("reweighted", True),
    ("reweighted", False),
    ("implicit-loop", True),
    ("implicit-loop", False),
)


def main(splits: int) -> None:
    """Print one line per method and prior."""
    example = Path(__file__).resolve().parents[1] / "examples/motoman/left_arm_grid.toml"
    project = lc.read_project(example)
    loaded = lc.load_dataset(project)
    print("method          prior    splits  inside 95 %  splits >= 90 %  median diff.  warned")
    for method, flat in CASES:
        rows = []
        for seed in range(splits):
            row = split(project.mechanism, loaded, method, flat, seed)
            if row is not None:
                rows.append(row)
        inside, length, warned = np.array(rows).T
        prior = "flat" if flat else "drawing"
        print(
            f"{method:15} {prior:8} {len(rows):6d} {inside.mean():12.3f} "
            f"{(inside >= 0.9).mean():15.2f} {1e3 * np.median(length):10.1f} mm "
            f"{warned.mean():7.2f}"
        )


def split(
    mechanism: lc.Mechanism, loaded: lc.LoadedData, method: str, flat: bool, seed: int
) -> list[float] | None:
    """Share inside, median difference [m], share warned; None where a fit did not converge."""
    data, rng = loaded.dataset, np.random.default_rng(seed)
    order = rng.permutation(len(data))
    joints = [q for q in data.quantities if q.startswith("theta")]
    box = {q: (float(data[q].min()), float(data[q].max())) for q in joints}
    new = lc.random_poses(box, POSES, seed=seed)
    found = []
    for half in (order[: len(data) // 2], order[len(data) // 2 :]):
        result = lc.calibrate(
            mechanism,
            data.take(np.sort(half)),
            noise=None if method == "least-squares" else loaded.noise,
            prior=lc.Prior({"*": math.inf}) if flat else None,
            method=method,
            max_iterations=1000,
        )
        if not result.status.converged:
            return None
        found.append(lc.predict(result, new))
    a, b = found
    d = np.array([a.outputs[q] - b.outputs[q] for q in a.outputs]).T
    total = np.linalg.inv(a.from_parameters + b.from_parameters)
    inside = np.einsum("ni,nij,nj->n", d, total, d) < LIMIT
    length = float(np.median(np.linalg.norm(d, axis=1)))
    return [float(inside.mean()), length, float((a.extrapolated & b.extrapolated).mean())]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else SPLITS)
