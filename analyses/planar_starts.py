"""The planar two-link arm fitted from 300 starts far from the truth: how many end at the optimum.

Each draw has 20 poses. Its optimum is where the fit ends that starts at the truth. A draw fails if
its fit does not converge or ends higher than that.

    python -m analyses.planar_starts [--starts 300]
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np

import loopcal as lc
from tests.reference.simulated import planar_arm

POSES, ROUNDING = 20, 1e-6
SD = {"xP": 1e-3, "yP": 1e-3, "phi2": 1e-3, "phi3": 1e-3}


@dataclass(frozen=True)
class Case:
    """Every parameter is off by up to `length` [m] or `angle` [rad]; decades: over which each sd
    is drawn below 0.1 m or 0.1 rad, 0 for 1 mm and 1 mrad."""

    length: float
    angle: float
    decades: int = 0

    def sds(self, seed: int) -> dict[str, float]:
        rng = np.random.default_rng(seed)
        if not self.decades:
            return SD
        return {name: 0.1 * float(10 ** rng.uniform(-self.decades, 0)) for name in SD}


CASES = (Case(0.5, 2.0), Case(1.0, 3.1), Case(0.3, 1.0, 3), Case(0.5, 2.0, 3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--starts", type=int, default=300)
    starts = parser.parse_args().starts
    print("| off by up to | sds | starts | at the optimum | from another start | fail |")
    print("| --- | --- | ---: | ---: | ---: | --- |")
    for case in CASES:
        ends = Counter(end(case, seed) for seed in range(starts))
        failed = ", ".join(f"{ends[r]} {r}" for r in sorted(ends) if r not in ("first", "other"))
        sds = f"over {case.decades} decades" if case.decades else "1 mm, 1 mrad"
        print(
            f"| {case.length} m, {case.angle} rad | {sds} | {starts} "
            f"| {ends['first'] + ends['other']} | {ends['other']} | {failed or 'none'} |",
            flush=True,
        )


def end(case: Case, seed: int) -> str:
    """ "first" or "other" start of a fit that ends at the optimum; "higher", or its status."""
    sds = case.sds(seed)
    simulated = planar_arm(POSES, seed=seed)
    data, noise = simulated.read(sds, seed=seed), lc.Noise(sds)
    best = lc.calibrate(
        simulated.truth, data, noise=noise, start="nominal", method="implicit-loop"
    ).solution
    off = simulated.off(case.length, case.angle, seed=seed)
    found = lc.calibrate(off, data, noise=noise, start="nominal", method="implicit-loop").solution
    if not found.status.converged:
        return found.status.reason
    if not found.chi_squared <= best.chi_squared * (1 + ROUNDING):
        return "higher"
    return "other" if found.status.note else "first"


if __name__ == "__main__":
    main()
