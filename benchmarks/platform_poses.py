"""A Stewart-Gough platform that nobody reads: one whole calibrate() over many poses.

Run as a script it measures, and prints it as JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np
from both_engines import DRIVEN

POSES, DEMANDED = 100_000, 20.0


@dataclass(frozen=True)
class Platform:
    """How it is seen, how many parameters are found, and times of one calibrate() [s]."""

    seen: str
    parameters: int
    wall: float
    processor: float


def in_its_own_process() -> list[Platform]:
    """Measure without what ran before."""
    done = subprocess.run([sys.executable, __file__], check=True, capture_output=True, text=True)
    return [Platform(**entry) for entry in json.loads(done.stdout)]


def measure(rounds: int = 3) -> list[Platform]:
    """Measure here: the best of some rounds."""
    from threadpoolctl import threadpool_limits

    import loopcal as lc
    from loopcal.mechanisms.instruments.pose import pose
    from loopcal.mechanisms.machine import assemble
    from loopcal.mechanisms.parallel.stewart_gough import stewart_gough

    angles = ["alpha_1", "beta_1", "alpha_2"]
    cases = {
        "full pose by a tracker with a probe": assemble(stewart_gough(), [pose()]),
        "three of its own passive angles": assemble(stewart_gough(passive=angles)),
    }
    found = []
    for seen, mechanism in cases.items():
        sds = {q: 1e-5 if unit == "m" else 5e-5 for q, unit in mechanism.quantities.items()}
        noise = lc.Noise(sds | dict.fromkeys(DRIVEN, np.inf))
        draw = np.random.default_rng(1)
        free = mechanism.parameters.free
        truth = {n: mechanism.parameters[n].nominal + 1e-3 * draw.standard_normal() for n in free}
        poses = lc.random_poses(DRIVEN, POSES, seed=2)
        data = lc.simulate(mechanism, poses, noise=noise, seed=3, truth=truth).dataset
        times = []
        with threadpool_limits(1, user_api="blas"):
            for _ in range(rounds):
                wall, processor = time.perf_counter(), time.process_time()
                result = lc.calibrate(mechanism, data, noise=noise, method="implicit-loop")
                times.append((time.perf_counter() - wall, time.process_time() - processor))
        assert result.status.converged
        assert result.identifiability.rank == len(free)
        found.append(Platform(seen, len(free), *min(times)))
    return found


if __name__ == "__main__":
    print(json.dumps([asdict(entry) for entry in measure()]))
