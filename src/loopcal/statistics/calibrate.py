"""The public calibration: by a stated method, or by the one that poses not used choose."""

from __future__ import annotations

from typing import Any, Unpack

from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate as calibrate_by_method
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.result import Result
from loopcal.estimation.solve.solver import Progress
from loopcal.execution.executor import Executor
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.folds import Scheme


def calibrate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    progress: Progress | None = None,
    scheme: Scheme | None = None,
    executor: Executor | None = None,
    **options: Unpack[FitOptions],
) -> Result:
