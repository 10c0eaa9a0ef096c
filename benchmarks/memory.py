"""Peak memory over the number of poses, each size in a process of its own.

Run as a script with a number of poses it measures that size, and prints it as JSON.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

DEMANDED = 0.6e9
"""Of a solve of the largest size [bytes]."""


@dataclass(frozen=True)
class Size:
    """The peak of the whole process, readings included, that solves; that calibrates [bytes]."""

    poses: int
    solve: float
    calibrate: float


def in_its_own_process(poses: int) -> Size:
    """Measure one size."""
    command = [sys.executable, __file__, str(poses)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return Size(**json.loads(done.stdout))


def measure(poses: int) -> Size:
    """Measure one size here, six-axis."""
    import ours
    from problems import six_axis

    problem = six_axis(poses)
    solve, calibrate = ours.solver(problem), ours.calibrator(problem)
    del problem  # the programs have the readings as a data set
    solve()
    peak = _peak()
    calibrate()
    return Size(poses, peak, _peak())


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
