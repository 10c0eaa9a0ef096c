"""The public functions on readings and results: each takes a path wherever it takes a value."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, TypeVar

from loopcal.errors import InputError, nearest
from loopcal.estimation.fit import Fit
from loopcal.estimation.plausible import refuse_other_units
from loopcal.estimation.result import FitResult
from loopcal.files.project import project_data
from loopcal.files.project.project_data import LoadedData
from loopcal.files.project.project_file import Project
from loopcal.files.tables.readers import read_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.simulation import simulate as simulating
from loopcal.simulation.simulate import Simulation
from loopcal.statistics import calibrate as calibrating
from loopcal.statistics import (
    change_points,
    comparison,
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
from loopcal.statistics import verdict as judge
from loopcal.statistics.check import Check
from loopcal.statistics.compared import Compared
from loopcal.statistics.models import ModelComparison
from loopcal.statistics.prediction import Prediction
from loopcal.statistics.repeats import Repeats
from loopcal.statistics.validation import Validation
from loopcal.statistics.verified import Verification
from loopcal.workflow.beginning.initial import init
from loopcal.workflow.calibration import calibrated
from loopcal.workflow.checking import simulated
from loopcal.workflow.readings import Units, later_readings
from loopcal.workflow.resolved import Stated, described, fitted, result_of, stated
from loopcal.workflow.result import Result
from loopcal.workflow.saved_result import SavedResult

Output = TypeVar("Output")
Described = TypeVar("Described", bound=Callable[..., Any])
_FIT = frozenset(Fit.__dataclass_fields__)
_ROBOT = frozenset(
    (
        "urdf",
        "dh",
        "machine",
        "base",
        "tip",
        "sheet",
        "joints",
        "leave_out",
        "exclude",
        "infer_units",
    )
)
"""Arguments of `init` that describe a robot."""
_MEASURED = frozenset(("points", "poses", "positions", "measured", "measurements", "tracker", "q"))
_URDF = re.compile(r".*\.urdf$", re.IGNORECASE)
_ON_MACHINE = """
    mechanism may also be a Project, what `init` returns, or the path of a project or mechanism
    file; data may be the path of a file. Without data those of the project are read; its noise and
    its fit are used where none are given. With urdf, dh or machine (as of `init`) all positional
    arguments are readings, as `init` takes them: calibrate("a.csv", "b.csv", urdf="r.urdf").
    units: column or glob -> unit of a table or file; SI where none is stated.
    """
_ON_RESULT = """
    A result may also come from `read_result`, or be the path of its folder; data may be the path
    of a file in the columns of the result's project. units: column or glob -> unit of a table or
    file; SI where none is stated.
    """
_ON_FIT = """
    The result may also be the path of a project, which is calibrated first.
    """


def _on_machine(
    function: Callable[..., Any], whole: Callable[[Project], Any] | None = None
) -> Callable[..., Any]:
    """whole: does for a project alone all that its file asks for."""
    takes = signature(function).parameters

    @wraps(function)
    def accepting(
        mechanism: Any = None,
        data: Any = None,
        *more: Any,
        units: Units = None,
        **options: Any,
    ) -> Any:
        robot = {key: options.pop(key) for key in _ROBOT & options.keys()}
        readings = [one for one in (mechanism, data, *more) if one is not None]
        urdfs = [r for r in readings if isinstance(r, str | Path) and _URDF.fullmatch(str(r))]
        if len(urdfs) == 1 and not {"urdf", "dh", "machine"} & robot.keys():
            robot["urdf"] = urdfs[0]
            readings = [r for r in readings if r is not urdfs[0]]
        if robot:
            if by_name := _MEASURED & options.keys():
                words = f"{min(by_name)}= is no argument: give readings without names, as in"
                raise TypeError(f"{words} lc.calibrate(joints, points, urdf='robot.urdf')")
            mechanism, data, more = init(*readings, **robot), None, ()
        if whole and data is None and not options:
            project = described(mechanism)
            if isinstance(project, Project):
                return whole(project)
        inputs = stated(mechanism, data, units)
        chosen = _with_stated(inputs, options, takes)
        noise = Noise.of(chosen.get("noise"))
        if noise is not None:
            noise.refuse_other_poses(len(inputs.data))
        refuse_other_units(inputs.mechanism, inputs.data, noise)
        with _naming(function, {*takes, *_FIT, *_ROBOT, "units"}):
            output = function(inputs.mechanism, inputs.data, *more, **chosen)
        return _whole(output, **inputs.parts)

    return _described(accepting, function, _ON_MACHINE)


@contextmanager
def _naming(function: Callable[..., Any], names: Set[str]) -> Iterator[None]:
    """The TypeError of an argument that the function has not names the nearest."""
    try:
        yield
    except TypeError as error:
        unknown = re.search(r"unexpected keyword argument '(\w+)'", str(error))
        if unknown is None:
            raise
        near = nearest(unknown[1], sorted(names))
        words = f"{function.__name__}() has no argument {unknown[1]!r}: {near}"
        raise TypeError(words) from None


def _whole(output: Any, **parts: Any) -> Any:
    """With a document and a verdict, where a fit is returned; parts: title, inputs of its
    project."""
    if isinstance(output, FitResult):
        return Result.of(output, **parts)
    if isinstance(output, ModelComparison):
        return replace(output, result=_whole(output.result, **parts))
    return output


def _with_stated(
    inputs: Stated, options: Mapping[str, Any], takes: Mapping[str, Any]
) -> dict[str, Any]:
    """The options given, and where they are silent those of the project."""
    of_project = {key: value for key, value in inputs.options.items() if key in takes}
    rest = dict(options)
    if "fit" in of_project and "fit" not in rest:
        # A single setting changes the project's fit; a whole fit replaces it.
        changes = {key: rest.pop(key) for key in _FIT & rest.keys()}
        of_project["fit"] = of_project["fit"].changed(**changes)
    return {**of_project, **rest}


def on_result(function: Callable[..., Any], needed: str, *, whole: bool) -> Callable[..., Any]:
    """needed: what the function takes of a result from a folder; whole: read the outputs too."""

    @wraps(function)
    def accepting(
        calibration: Any, data: Any, *more: Any, units: Units = None, **options: Any
    ) -> Any:
        result = result_of(calibration)
        data = [data, *more] if more else data
        poses = later_readings(result, data, units, whole=whole)
        return _whole(function(_taken(result, needed), poses, **options))

    return _described(accepting, function, _ON_RESULT)


def _on_fit(function: Callable[..., Output]) -> Callable[..., Output]:
    @wraps(function)
    def accepting(result: Any, *more: Any, **options: Any) -> Output:
        return function(fitted(result), *more, **options)

    return _described(accepting, function, _ON_FIT)


def _described(accepting: Described, function: Callable[..., Any], words: str) -> Described:
    """With the signature and documentation of the function, and what is accepted beyond."""
    taken = signature(function)
    listed = list(taken.parameters.values())
    if words is not _ON_FIT:
        end = next((i for i, p in enumerate(listed) if p.kind is Parameter.VAR_KEYWORD), None)
        new = Parameter("units", Parameter.KEYWORD_ONLY, default=None, annotation=Units)
        listed.insert(len(listed) if end is None else end, new)
    vars(accepting)["__signature__"] = taken.replace(parameters=listed)
    accepting.__doc__ = f"{(function.__doc__ or '').rstrip()}\n{words}"
    return accepting


calibrate: Callable[..., Result] = _on_machine(calibrating.calibrate, calibrated)
check: Callable[..., Check] = _on_machine(checking.check)
validate: Callable[..., Validation] = _on_machine(validating.validate)
compare_models: Callable[..., ModelComparison] = _on_machine(models.compare_models)
predict: Callable[..., Prediction] = on_result(prediction.predict, "predictor", whole=False)
verify: Callable[..., Verification] = on_result(verification.verify, "calibrated", whole=True)
findings = _on_fit(finding.findings)
find_outliers = _on_fit(outliers.find_outliers)
find_shifts = _on_fit(change_points.find_shifts)
reliability = _on_fit(redundancy.reliability)
intervals = _on_fit(bounding.intervals)
verdict = _on_fit(judge.verdict)


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
    inputs = stated(mechanism, data, units)
    takes = signature(validating.validate).parameters
    every = {name: _with_stated(inputs, how, takes) for name, how in methods.items()}
    return validating.compare_methods(inputs.mechanism, inputs.data, every, **validation)


@wraps(comparison.compare)
def compare(a: Any, b: Any, *, poses: Any = None, align: bool = True) -> Compared:
    """`compare`, of paths too."""
    first, second = result_of(a), result_of(b)
    at = None if poses is None else later_readings(first, poses, None, whole=False)
    both = [_taken(result, "calibrated") for result in (first, second)]
    return comparison.compare(*both, poses=at, align=align)


def _taken(result: Any, needed: str) -> Any:
    """What a function needs of a result from a folder; others as they are."""
    return getattr(result, needed) if isinstance(result, SavedResult) else result


@wraps(simulating.simulate)
def simulate(
    mechanism: Any, readings: Any = None, *, seed: int = 0, units: Units = None, **options: Any
) -> Simulation:
    """`simulate`, of paths too."""
    machine = described(mechanism)
    if isinstance(readings, int):
        raise InputError(
            f"{readings} is no table of readings to simulate at",
            code="invalid-value",
            remedy=f"draw the poses: lc.random_poses({{'joint': (-1.0, 1.0)}}, {readings}, seed=0) "
            "gives readings within a range [SI] for each joint",
        )
    if readings is None and isinstance(machine, Project):
        return simulated(machine, seed)
    inputs = stated(machine, readings, units)
    chosen = _with_stated(inputs, options, signature(simulating.simulate).parameters)
    if "start" not in options:
        chosen.pop("start", None)  # of a fit
    return simulating.simulate(inputs.mechanism, inputs.data, seed=seed, **chosen)


@wraps(repeats.repeated_readings)
def repeated_readings(series: Any) -> Repeats:
    """`repeated_readings`, of paths and tables too."""
    one = isinstance(series, str | Path | Dataset | Mapping) or hasattr(series, "columns")
    every: Sequence[Any] = [series] if one else list(series)
    return repeats.repeated_readings([_dataset(s) for s in every])


def _dataset(data: Any) -> Dataset:
    if isinstance(data, Dataset):
        return data
    return read_dataset(data) if isinstance(data, str | Path) else Dataset.from_arrays(data)


@wraps(project_data.load_dataset)
def load_dataset(project: Project | str | Path) -> LoadedData:
    """`load_dataset`, of a path too."""
    description = described(project)
    if not isinstance(description, Project):
        raise InputError(
            "a mechanism file names no readings",
            code="invalid-value",
            remedy="give a Project, or the path of one",
        )
    return project_data.load_dataset(description)
