"""The seed's program in GNU Octave, `seed_program.m`, pose by pose as the original in MATLAB.

Readings go there and the fit comes back in MAT files; Octave tells the time that it calibrates, so
neither its start nor the files count. Its interpreter dominates: at 1,000 poses of the six-axis
arm nine tenths of the time go into the loop over 4x4 matrices in `linearised`.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from problems import Fit, Problem
from scipy.io import loadmat, savemat
from seed_program import GENERATORS

COMMAND = "octave-cli"


def calibrate(problem: Problem) -> Fit:
    """The fit; raises RuntimeError where Octave ends with an error, as it does without one."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder, "problem.mat"), Path(folder, "fit.mat")
        savemat(given, _as_matrices(problem), oned_as="column")
        call = f"seed_program ('{given}', '{found}')"
        command = [COMMAND, "--norc", "--path", str(Path(__file__).parent), "--eval", call]
        one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            command, env=os.environ | one_thread, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"Octave: {done.stderr.strip()}")
        fit = loadmat(found, squeeze_me=True)
    told = {name: float(fit[name]) for name in ("chi_squared", "iterations", "seconds")}
    return Fit(fit["parameters"], told["chi_squared"], told["iterations"], told["seconds"])


def _as_matrices(problem: Problem) -> dict[str, Any]:
    """The problem as the program wants it: indices begin with 1, and 0 is none."""
    factors = problem.model.chain.factors
    parameters = [-1 if f.parameter is None else f.parameter for f in factors]
    numbers = {
        "turns": [f.kind == "r" for f in factors],
        "axes": [f.axis + 1 for f in factors],
        "parameter": [i + 1 for i in parameters],
        "joint": [f.joint + 1 for f in factors],
        "signs": [f.sign for f in factors],
        "tip": [i + 1 for i in problem.model.chain.tip],
    }
    generators = np.stack([GENERATORS[f.kind][f.axis] for f in factors], axis=2)
    readings = {"joints": problem.joints, "points": problem.points, "sds": problem.sds}
    known = {"nominal": problem.nominal, "generators": generators}
    return {name: np.array(row, dtype=float) for name, row in numbers.items()} | readings | known
