"""Time per pose and peak memory over the number of poses, each size in a process of its own.

Run as a script with a number of poses it measures that size, and prints it as JSON.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

DEMANDED_FLAT, DEMANDED_PEAK, DEMANDED_RATIO = 1.3, 0.6e9, 4.0
REPEATS = {10_000: 7, 100_000: 5, 1_000_000: 3}


@dataclass(frozen=True)
class Size:
    """One size: times of a solve, of a solve on the NumPy engine, and of calibrate() [s].

    peak: of the whole process, readings included, that solves [bytes]; peak_calibrate: that calls
    calibrate() too.
    """

    poses: int
    solve: float
    numpy: float
    calibrate: float
    peak: float
    peak_calibrate: float


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
    from problems import six_axis

    problem = six_axis(poses)
    solve, calibrate = ours.solver(problem), ours.calibrator(problem)
    del problem  # the programs have the readings as a data set
    programs = {
        "solve": ours.on_engine(ours.BEST, solve),
        "numpy": ours.on_engine("numpy", solve),
        "calibrate": ours.on_engine(ours.BEST, calibrate),
    }
    programs["solve"]()
    peak = _peak()
    for name in ("numpy", "calibrate"):
        programs[name]()
    peak_calibrate = _peak()
    times = {name: t.median for name, t in in_turns(programs, rounds=REPEATS.get(poses, 3)).items()}
    return Size(poses, **times, peak=peak, peak_calibrate=peak_calibrate)


def _peak() -> float:
    """Of this process so far [bytes]; where told, not counting what it was before it began."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    told = [float(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")]
    if told:
        return told[0]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak * (1 if sys.platform == "darwin" else 1024))


if __name__ == "__main__":
    print(json.dumps(asdict(measure(int(sys.argv[1])))))
