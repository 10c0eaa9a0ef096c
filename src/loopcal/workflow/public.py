"""The public functions on readings and results: each takes a path wherever it takes a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Protocol, TypeVar

from loopcal.errors import InputError
from loopcal.estimation.fit import Fit
from loopcal.estimation.plausible import refuse_other_units
from loopcal.estimation.result import Result
from loopcal.files.project import project_data
from loopcal.files.project.project_data import LoadedData
from loopcal.files.project.project_file import Project
from loopcal.files.tables.readers import read_dataset
from loopcal.life import updating
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.planning import plan as planning
from loopcal.planning.planned import Plan
from loopcal.simulation import simulate as simulating
from loopcal.simulation.simulate import Simulation
from loopcal.statistics import calibrate as calibrating
from loopcal.statistics import (
    change_points,
    comparison,
    judging,
    models,
    outliers,
    prediction,
    repeats,
    verification,
)
from loopcal.statistics import check as checking
from loopcal.statistics import findings as finding
from loopcal.statistics import intervals as bounding
from loopcal.statistics import reliability as redundancy
from loopcal.statistics import validate as validating
from loopcal.statistics.compared import Compared
from loopcal.statistics.repeats import Repeats
from loopcal.workflow.calibration import calibrated
from loopcal.workflow.given import (
    Stated,
    Units,
    calibrated_from,
    described,
    fitted,
    later_readings,
    predictor_from,
    readings,
    result_of,
    stated,
)
from loopcal.workflow.planning import Known, candidates_of, known_of, of_calibration, settings_of
from loopcal.workflow.simulation import simulated

Found = TypeVar("Found", covariant=True)
Described = TypeVar("Described", bound=Callable[..., Any])
_FIT = frozenset(Fit.__dataclass_fields__)
_ON_MACHINE = """
    mechanism may also be a Project, what `init` returns, or the path of a project or mechanism
    file; data may be the path of a file. Without data those of the project are read; its noise and
    its fit are used where none are given. units: column or glob -> unit of a table or file; SI
    where none is stated.
    """
_ON_RESULT = """
    A result may also come from `read_result`, or be the path of its folder; data may be the path
    of a file in the columns of the result's project. units: column or glob -> unit of a table or
    file; SI where none is stated.
    """
_ON_FIT = """
    The result may also be the path of a project, which is calibrated first.
    """


class OnMachine(Protocol[Found]):
    """A function of a mechanism and its readings, or of a project that states both."""

    def __call__(
        self, mechanism: Any, data: Any = None, *more: Any, units: Units = None, **options: Any
    ) -> Found:
        """The options are those of the function below this layer."""


class OnResult(Protocol[Found]):
    """A function of a result and further readings."""

    def __call__(
        self, calibration: Any, data: Any, *, units: Units = None, **options: Any
    ) -> Found:
        """The options are those of the function below this layer."""


class OnFit(Protocol[Found]):
    """A function of a result with its fit."""

    def __call__(self, result: Any, *more: Any, **options: Any) -> Found:
        """The options are those of the function below this layer."""


def _on_machine(
    function: Callable[..., Found], whole: Callable[[Project], Found] | None = None
) -> OnMachine[Found]:
    """whole: does for a project alone all that its file asks for."""
    takes = signature(function).parameters

    @wraps(function)
    def accepting(
        mechanism: Any, data: Any = None, *more: Any, units: Units = None, **options: Any
    ) -> Found:
        if whole and data is None and not options:
            project = described(mechanism)
            if isinstance(project, Project):
                return whole(project)
        its = stated(mechanism, data, units)
        given = _with_own(its, options, takes)
        refuse_other_units(its.mechanism, its.data, Noise.of(given.get("noise")))
        found = function(its.mechanism, its.data, *more, **given)
        return _titled(found, its.title) if isinstance(found, Result) else found

    return _described(accepting, function, _ON_MACHINE)


def _titled(result: Any, title: str | None) -> Any:
    """A result whose document has the title of its project."""
    return result.adding(lambda document: replace(document, title=title)) if title else result


def _with_own(its: Stated, options: Mapping[str, Any], takes: Mapping[str, Any]) -> dict[str, Any]:
    """The options given, and where they are silent those of the project."""
    own = {key: value for key, value in its.options.items() if key in takes}
    given = dict(options)
    if "fit" in own and "fit" not in given:
        own["fit"] = own["fit"].changed(**{k: given.pop(k) for k in _FIT & given.keys()})
    return {**own, **given}


def _on_result(
    function: Callable[..., Found], needed: Callable[[Any], Any], *, whole: bool
) -> OnResult[Found]:
    """needed: what the function takes of a result from a folder; whole: read the outputs too."""

    @wraps(function)
    def accepting(calibration: Any, data: Any, *, units: Units = None, **options: Any) -> Found:
        result = result_of(calibration)
        return function(needed(result), later_readings(result, data, units, whole=whole), **options)

    return _described(accepting, function, _ON_RESULT)


def _on_fit(function: Callable[..., Found]) -> OnFit[Found]:
    @wraps(function)
    def accepting(result: Any, *more: Any, **options: Any) -> Found:
        return function(fitted(result), *more, **options)

    return _described(accepting, function, _ON_FIT)


def _described(accepting: Described, function: Callable[..., Any], told: str) -> Described:
    """With the signature and documentation of the function, and what is accepted beyond."""
    own = signature(function)
    listed = list(own.parameters.values())
    if told is not _ON_FIT:
        end = next((i for i, p in enumerate(listed) if p.kind is Parameter.VAR_KEYWORD), None)
        new = Parameter("units", Parameter.KEYWORD_ONLY, default=None, annotation=Units)
        listed.insert(len(listed) if end is None else end, new)
    vars(accepting)["__signature__"] = own.replace(parameters=listed)
    accepting.__doc__ = f"{(function.__doc__ or '').rstrip()}\n{told}"
    return accepting


calibrate = _on_machine(calibrating.calibrate, calibrated)
check = _on_machine(checking.check)
validate = _on_machine(validating.validate)
compare_models = _on_machine(models.compare_models)
predict = _on_result(prediction.predict, predictor_from, whole=False)
verify = _on_result(verification.verify, calibrated_from, whole=True)
update = _on_result(updating.update, calibrated_from, whole=True)
findings = _on_fit(finding.findings)
find_outliers = _on_fit(outliers.find_outliers)
find_shifts = _on_fit(change_points.find_shifts)
reliability = _on_fit(redundancy.reliability)
intervals = _on_fit(bounding.intervals)
verdict = _on_fit(judging.verdict)


@wraps(validating.compare_methods)
def compare_methods(
    mechanism: Any,
    data: Any,
    methods: Mapping[str, Mapping[str, Any]],
    *,
    units: Units = None,
    **validation: Any,
) -> validating.MethodComparison:
    """`compare_methods`, of paths too."""
    its = stated(mechanism, data, units)
    takes = signature(validating.validate).parameters
    every = {name: _with_own(its, how, takes) for name, how in methods.items()}
    return validating.compare_methods(its.mechanism, its.data, every, **validation)


@wraps(comparison.compare)
def compare(a: Any, b: Any, *, poses: Any = None, align: bool = True) -> Compared:
    """`compare`, of paths too."""
    first, second = result_of(a), result_of(b)
    at = None if poses is None else later_readings(first, poses, None, whole=False)
    return comparison.compare(
        calibrated_from(first), calibrated_from(second), poses=at, align=align
    )


@wraps(simulating.simulate)
def simulate(
    mechanism: Any, readings: Any = None, *, seed: int, units: Units = None, **options: Any
) -> Simulation:
    """`simulate`, of paths too."""
    its = described(mechanism)
    if readings is None and isinstance(its, Project):
        return simulated(its, seed)
    given = stated(its, readings, units)
    own = _with_own(given, options, signature(simulating.simulate).parameters)
    if "start" not in options:
        own.pop("start", None)  # of a fit
    return simulating.simulate(given.mechanism, given.data, seed=seed, **own)


@wraps(planning.plan)
def plan(
    mechanism: Any,
    poses: int = 30,
    *,
    candidates: Any = None,
    existing: Any = None,
    units: Units = None,
    **options: Any,
) -> Plan:
    """`plan`, of paths and projects too."""
    its = described(mechanism)
    if isinstance(its, Project):
        known = known_of(its, existing)
        options.setdefault("settings", settings_of(its))
    elif (
        existing is None or isinstance(existing, Dataset | Mapping) or hasattr(existing, "columns")
    ):
        machine = getattr(its, "mechanism", its)
        data = None if existing is None else readings(existing, machine, units)
        known = Known(machine, options.pop("noise", getattr(its, "noise", None)), data)
    else:
        known = of_calibration(existing)
    options.setdefault("noise", known.noise)
    options["settings"] = known.settled(options.get("settings") or PlanSettings())
    if candidates is not None:
        if isinstance(its, Project) and isinstance(candidates, str | Path):
            candidates = candidates_of(its, candidates)
        else:
            candidates = readings(candidates, known.mechanism, units)
    return planning.plan(
        known.mechanism, poses, candidates=candidates, existing=known.existing, **options
    )


@wraps(repeats.repeated_readings)
def repeated_readings(series: Any) -> Repeats:
    """`repeated_readings`, of paths and tables too."""
    one = isinstance(series, str | Path | Dataset | Mapping) or hasattr(series, "columns")
    every: Sequence[Any] = [series] if one else list(series)
    return repeats.repeated_readings([_dataset(s) for s in every])


def _dataset(given: Any) -> Dataset:
    if isinstance(given, Dataset):
        return given
    return read_dataset(given) if isinstance(given, str | Path) else Dataset.from_arrays(given)


@wraps(project_data.load_dataset)
def load_dataset(project: Project | str | Path) -> LoadedData:
    """`load_dataset`, of a path too."""
    its = described(project)
    if not isinstance(its, Project):
        raise InputError(
            "a mechanism file names no readings",
            code="invalid-value",
            remedy="give a Project, or the path of one",
        )
    return project_data.load_dataset(its)
