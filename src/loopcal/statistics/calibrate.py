"""The public calibration: by a stated method, or by the one that poses not used choose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate as calibrate_by_method
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import Progress
from loopcal.execution.executor import Executor
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case

if TYPE_CHECKING:
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
) -> FitResult:
    """Calibrate a mechanism from readings.

    data: a Dataset, or a dict of (N,) arrays or any DataFrame of readings in SI units; noise: a
    Noise, or a dict of sds [SI] by quantity, which every method needs that is not exact; fit: the
    settings, or as keyword arguments prior, method, loss, start, max_iterations, tolerance and
    model_error, which override it; progress: called at every iteration of a fit of all poses.
    Angles are rad, lengths m throughout.

    method "auto" (default) lets the others compete and takes the one that predicts poses not used
    (`loopcal.statistics.choice`); `Result.chosen` says which, over what, by how much. scheme: what
    it leaves out, by default 10 folds and 5 regions; executor: who does its fits, by default the
    cores of this process. Without noise it weighs the readings as least squares does.

    "implicit-loop" finds the parameters of maximum likelihood while every loop closes. It
    minimises sum_i c_i^T Sigma^-1 c_i + (p - nominal)^T Sigma_p^-1 (p - nominal) over parameters
    p and corrections c_i. The constraint is f(reading_i + c_i, p) = 0 (Wampler, Hollerbach and
    Arai 1995; thesis 3.7 to 3.30). "least-squares" takes the readings as exact and minimises the
    sum of squared loop values (thesis 3.1 to 3.6), without noise or prior. "reweighted" weights
    the loop values at the readings by their propagated noise J_x Sigma J_x^T, and lets that noise
    say nothing about the parameters. It is the robust choice where poses are alike and sds guessed.
    "implicit-loop-undamped" is the iteration of the thesis, for study.

    loss "huber" or "student-t" lets poses that do not fit count less
    (`loopcal.estimation.solve.loss`); the covariance is then valid without normal errors, and
    there is no chi-squared. It needs "implicit-loop" or "reweighted" and stated sds.

    start "nominal"; "align" moves the nominal machine rigidly to where the instrument sees it;
    "auto" (default) aligns a machine whose placement parameters are free with flat priors; or
    parameter values [SI] by name.

    A file that is at fault as a whole is recognised before the fit, where that begins at the
    nominal machine. Such faults are columns in another unit, reversed or exchanged, rows shifted
    or shuffled, and readings of another machine. The fit is then cut short, no sd is estimated, and
    `Result.faults` names them.

    Rows that copy others in every column count once; `Result.dataset` is what was used.

    Raises InputError for input that cannot be used. A fit that does not converge is returned, with
    the reason in its status.
    """
    asked, stated_noise = Fit.of(fit, options), Noise.of(noise)
    if not asked.method.choice:
        _refuse_sharing(asked, scheme, executor)
        return calibrate_by_method(
            mechanism, data, noise=stated_noise, fit=asked, progress=progress
        )
    from loopcal.statistics.choice import choose

    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    case = Case(mechanism, data, stated_noise, asked)
    return choose(case, scheme, executor, iterated=progress).result


def _refuse_sharing(fit: Fit, scheme: Scheme | None, executor: Executor | None) -> None:
    sharing = [n for n, value in (("scheme", scheme), ("executor", executor)) if value is not None]
    if sharing:
        raise InputError(
            f"{' and '.join(sharing)} would have no effect: the method {fit.method.name!r} makes "
            "one fit of all poses",
            code="unsupported",
            remedy="leave it out, validate by lc.validate, or use method = 'auto'",
        )
