"""Is yesterday's covariance as good as yesterday's poses, on a real robot?

The first half of a measured set is calibrated and updated by the second half, the instrument where
it stood; beside it stands the calibration of all poses. Printed: differences in sds of the latter.
Sds that the project learns are learnt anew from both halves.

    python -m analyses.updated PROJECT.toml [--from ROW]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import loopcal as lc


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("project")
    parser.add_argument("--from", dest="first", type=int, default=0)
    given = parser.parse_args()
    project = lc.read_project(given.project)
    loaded = lc.load_dataset(project)
    data = loaded.dataset.take(np.arange(given.first, len(loaded.dataset)))
    rows = np.random.default_rng(0).permutation(len(data))
    parts = [np.sort(rows[: len(data) // 2]), np.sort(rows[len(data) // 2 :])]
    fit: dict[str, Any] = {"noise": loaded.noise, "method": "implicit-loop"}
    every = lc.calibrate(project.mechanism, data, **fit)
    first = lc.calibrate(project.mechanism, data.take(parts[0]), **fit)
    found = lc.update(first, data.take(parts[1]), moved=False)
    sd = np.sqrt(np.diag(every.covariance))
    at, apart, before = (
        np.array([one.value[n] for n in every.estimated]) for one in (every, found, first)
    )
    apart, before = (apart - at) / sd, (before - at) / sd
    wider = np.sqrt(np.diag(found.covariance)) / sd
    print(f"{len(data)} poses, {len(every.estimated)} parameters")
    for what, values in (("first half", before), ("updated", apart)):
        print(f"{what:10} largest difference {np.abs(values).max():.3f} sds of all poses")
    print(f"sds of the update over those of all poses: {min(wider):.3f} to {max(wider):.3f}")


if __name__ == "__main__":
    main()
