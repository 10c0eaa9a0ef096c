"""Time per pose and peak memory over the number of poses, each size in a process of its own.

Run as a script with a number of poses it measures that size, and prints it as JSON.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass

DEMANDED_FLAT, DEMANDED_PEAK = 1.5, 1.5e9
REPEATS = {10_000: 7, 100_000: 5, 1_000_000: 3}


@dataclass(frozen=True)
class Size:
    """One size: times of a solve and of calibrate() [s]; peak: of the whole process [bytes]."""

    poses: int
    solve: float
    calibrate: float
    peak: float


def in_its_own_process(poses: int) -> Size:
    """Measure one size."""
    done = subprocess.run(
        [sys.executable, __file__, str(poses)], check=True, capture_output=True, text=True
    )
    return Size(**json.loads(done.stdout))


def measure(poses: int) -> Size:
    """Measure one size here: medians, after one run to set up."""
    import ours
    from measuring import in_turns
    from six_axis import six_axis

    problem = six_axis(poses)
    programs = {"solve": ours.solver(problem), "calibrate": ours.calibrator(problem)}
    del problem  # the programs have the readings as a data set
    for program in programs.values():
        program()
    times = in_turns(programs, rounds=REPEATS.get(poses, 3))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak *= 1 if sys.platform == "darwin" else 1024
    return Size(poses, times["solve"].median, times["calibrate"].median, float(peak))


if __name__ == "__main__":
    print(json.dumps(asdict(measure(int(sys.argv[1])))))
