"""The command from a cold start: beside a bare import of NumPy, and the seed's study as a whole."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from measuring import Times, in_turns
from problems import JOINT_SD, POINT_SD, six_axis

POSES = 300
COMMAND, BARE = "loopcal calibrate --no-report, 300 poses", "python -c 'import numpy'"
STUDY = "loopcal study examples/seed/study.toml"
DEMANDED, DEMANDED_STUDY = 5.0, 45.0
"""Times as long as the bare import; seconds."""

_PROJECT = f"""
schema = 1
fit = {{ method = "implicit-loop" }}
[mechanism]
type = "motoman-ma1400"
[data]
file = "poses.csv"
[data.columns]
theta_1 = {{ column = "theta_1", unit = "rad" }}
theta_2 = {{ column = "theta_2", unit = "rad" }}
theta_3 = {{ column = "theta_3", unit = "rad" }}
theta_4 = {{ column = "theta_4", unit = "rad" }}
theta_5 = {{ column = "theta_5", unit = "rad" }}
theta_6 = {{ column = "theta_6", unit = "rad" }}
x = {{ column = "x", unit = "m" }}
y = {{ column = "y", unit = "m" }}
z = {{ column = "z", unit = "m" }}
[noise]
"theta_*" = {{ sd = {JOINT_SD}, unit = "rad" }}
xyz = {{ sd = {POINT_SD}, unit = "m" }}
"""


def measure(rounds: int) -> dict[str, Times]:
    """Both from a cold start, in turns; the results are written as for any user."""
    problem = six_axis(POSES)
    with tempfile.TemporaryDirectory() as folder:
        header = ",".join(problem.mechanism.tape.quantities)
        rows = np.vstack([problem.joints, problem.points]).T
        np.savetxt(Path(folder, "poses.csv"), rows, delimiter=",", header=header, comments="")
        Path(folder, "project.toml").write_text(_PROJECT)
        command = [sys.executable, "-m", "loopcal", "calibrate", "project.toml", "--no-report"]
        programs = {
            COMMAND: partial(_run, command, folder),
            BARE: partial(_run, [sys.executable, "-c", "import numpy"], folder),
        }
        for program in programs.values():
            program()
        return in_turns(programs, rounds=rounds)


def study() -> float:
    """Wall time of the seed's study with all its draws, on all cores [s]."""
    path = Path(__file__).parent.parent / "examples" / "seed" / "study.toml"
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "loopcal", "study", str(path), "--out", "study"]
        begin = time.perf_counter()
        _run(command, folder)
        return time.perf_counter() - begin


def _run(command: list[str], folder: str) -> None:
    # An installed program keeps its bytecode, whatever the shell here says.
    kept = {name: v for name, v in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
