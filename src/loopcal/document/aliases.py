"""Names that users of SciPy, lmfit and statsmodels try first, and what they mean here.

A name that would mean something else here is refused with the names to use instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loopcal.errors import nearest
from loopcal.small_samples import t_quantile

ALIASES: Mapping[str, Callable[[Any], Any]] = {
    # scipy.optimize
    "success": lambda r: r.converged,
    "message": lambda r: r.unjudged.status.message,
    "nit": lambda r: r.unjudged.status.iterations,
    "x": lambda r: np.array([r.value[name] for name in r.estimated]),
    # lmfit
    "best_values": lambda r: dict(r.value),
    "values": lambda r: dict(r.value),
    "init_values": lambda r: {name: r.params[name].nominal for name in r.estimated},
    "var_names": lambda r: list(r.estimated),
    "nvarys": lambda r: len(r.estimated),
    "covar": lambda r: r.covariance,
    "chisqr": lambda r: r.chi_squared and r.chi_squared.value,
    "redchi": lambda r: r.chi_squared and r.chi_squared.variance_factor,
    "best_fit": lambda r: r.fitted_outputs,
    "fit_report": lambda r: r.summary,
    # statsmodels
    "cov": lambda r: r.covariance,
    "cov_params": lambda r: lambda: r.covariance,
    "bse": lambda r: r.sd,
    "stderr": lambda r: r.sd,
    "fittedvalues": lambda r: r.fitted_outputs,
    "nobs": lambda r: r.unjudged.data.used,
    "conf_int": lambda r: lambda alpha=0.05: confidence(r, alpha),
    # DataFrames and files
    "to_dataframe": lambda r: r.params.to_dataframe,
    "to_pandas": lambda r: r.params.to_pandas,
    "to_polars": lambda r: r.params.to_polars,
}
"""Name -> what it is of a result."""

_RESIDUALS = (
    "result.plot.residuals(); in memory also result.differences_after (outputs computed minus "
    "measured), result.corrections (of the readings) and result.residuals_after (values of the "
    "loop equations)"
)
_TESTED = "result.params with sd and validity, or lc.intervals(result)"
_COMPARE = "result.document.accuracy, lc.validate or lc.compare_methods, which use poses not fitted"
INSTEAD: Mapping[str, str] = {
    **dict.fromkeys(("resid", "residuals", "residual", "fun", "wresid"), _RESIDUALS),
    **dict.fromkeys(("tvalues", "pvalues", "tstat"), _TESTED),
    **dict.fromkeys(("rsquared", "rsquared_adj", "aic", "bic", "llf", "loglik"), _COMPARE),
    **dict.fromkeys(("nfev", "njev"), "result.nit, the number of parameter steps"),
    **dict.fromkeys(("cost", "mse_resid", "ssr"), "result.chi_squared or result.document.accuracy"),
    **dict.fromkeys(("df_resid", "nfree", "dof"), "result.chi_squared.degrees_of_freedom"),
    **{name: f"lc.{name}(result, readings)" for name in ("verify", "update")},
    "plan": "lc.plan(result, 20)",
    "simulate": "lc.simulate(result.mechanism, readings, noise=...)",
    **dict.fromkeys(
        ("base", "tool", "joint_offsets", "offsets", "dh", "urdf", "model"),
        "result.params; result.export('dh'), or 'urdf'; or result.mechanism",
    ),
    **dict.fromkeys(("uncertainty", "std"), "result.sd, or lc.intervals(result)"),
    **dict.fromkeys(
        ("interval", "intervals", "confidence_interval", "ci"),
        "result.conf_int(), or lc.intervals(result)",
    ),
    **dict.fromkeys(("sample", "samples"), "result.x and result.covariance, and draw from them"),
    **dict.fromkeys(("data", "readings"), "result.dataset"),
    **dict.fromkeys(("load", "from_file"), "lc.load(folder)"),
    **dict.fromkeys(("accuracy", "improvement"), "result.document.accuracy, or result.rms"),
    **dict.fromkeys(("chi2", "chisq"), "result.chi_squared.value"),
    **dict.fromkeys(("corr", "correlation", "correlations"), "result.plot.correlations()"),
    **dict.fromkeys(("to_csv", "to_excel"), "result.to_pandas() or result.to_polars() with it"),
    **dict.fromkeys(("robot", "arm", "kinematics"), "result.fk(q), or result.mechanism"),
    **dict.fromkeys(("to_pickle", "dump", "to_file", "write"), "result.save(folder)"),
    **dict.fromkeys(("show", "open", "view", "display"), "result.report(), or result.plot()"),
    "print": "print(result)",
    **dict.fromkeys(("head", "tail", "describe"), "result.to_dataframe() with it"),
    **dict.fromkeys(
        ("error", "mean_error", "max_error", "mae", "mse", "score", "rmsd"),
        "result.rms, or result.document.accuracy",
    ),
    **dict.fromkeys(("validate", "cross_validate", "cross_val_score"), "lc.validate(result)"),
    **dict.fromkeys(("transform", "apply", "compensate"), "result.correct(targets)"),
    **dict.fromkeys(
        ("inverse", "inverse_kinematics", "ik", "ikine"),
        "result.correct(targets), which solves for joints",
    ),
    **dict.fromkeys(("get_params", "params_"), "result.params"),
    "nominal": "result.init_values, or result.params[NAME].nominal",
    "observability": "result.document.observability",
    "compare": "lc.compare(result, other)",
    "parameters": "result.params",
    "jac": "result.covariance",
    "hess_inv": "result.covariance",
    "optimize_result": "result.document.status",
    "plot_fit": "result.plot.residuals()",
    "table": "result.params",
    "coef_": "result.params",
    "rmse": "result.rms, that of the poses used for the fit; result.document.validation for others",
}
"""Name -> what to use instead, because the name means something else in those libraries."""


def aliased(result: Any, name: str) -> Any:
    """What a name of another library means for a result.

    Raises AttributeError, with the name to use, where it means nothing or something else.
    """
    if name in ALIASES:
        return ALIASES[name](result)
    kind = type(result).__name__
    if name in INSTEAD:
        raise AttributeError(f"a {kind} has no {name!r}: use {INSTEAD[name]}")
    public = [n for n in (*dir(type(result)), *ALIASES) if not n.startswith("_")]
    words = f"a {kind} has no attribute {name!r}: {nearest(name, public)}"
    raise AttributeError(words, name=name, obj=result)


_OF_PROJECTS = ("calibrate", "check", "plan", "simulate", "validate", "compare_models")
_OF_RESULTS = ("predict", "fk", "correct", "export", "report", "plot", "summary")


def of_project(project: Any, name: str) -> Any:
    """Raise the AttributeError of a project, with the call that does what the name says."""
    words = f"a {type(project).__name__} has no attribute {name!r}"
    if name in _OF_PROJECTS:
        words += f": use lc.{name}(project)"
    elif name in _OF_RESULTS:
        words += f": use lc.calibrate(project).{name}()"
    elif name in ("save", "write"):
        words += ": use lc.init(readings, ..., out='calibration'), which writes project.toml"
    raise AttributeError(words, name=name, obj=project)


def confidence(result: Any, alpha: float = 0.05) -> dict[str, list[float]]:
    """Name -> both ends of the interval [SI] that misses the true value with probability alpha.

    By the covariance and Student's t; `lc.intervals` gives those by profile likelihood.
    """
    entries = (result.params[name] for name in result.estimated)
    intervals = {}
    for entry in entries:
        freedom = np.inf if entry.degrees_of_freedom is None else entry.degrees_of_freedom
        half = np.inf if entry.sd is None else entry.sd * t_quantile(1.0 - alpha, freedom)
        intervals[entry.name] = [entry.value - half, entry.value + half]
    return intervals
