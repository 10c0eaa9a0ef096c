"""loopcal: calibration of mechanisms with every sensor uncertain.

Everything public is here; modules are loaded when one of their names is first used.
"""

from __future__ import annotations

from loopcal import import_path as _import_path  # noqa: F401  before anything else is looked for

# isort: split
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from loopcal import effects, instruments, machines
    from loopcal.deployment.corrected import CorrectionBounds
    from loopcal.deployment.correction import Correction
    from loopcal.document.change_points import ChangePoint, Dependence
    from loopcal.document.findings import ColumnFault, Identifiability, Outlier, Undetermined
    from loopcal.document.fit import ChiSquared, NoiseEntry
    from loopcal.document.parameter_table import ParameterTable
    from loopcal.document.result_document import ResultDocument, WrittenResult
    from loopcal.document.verdict import Answer, Verdict
    from loopcal.errors import InputError, LoopcalError
    from loopcal.estimation.accuracy import Accuracy, InstrumentAccuracy
    from loopcal.estimation.fit import Fit
    from loopcal.estimation.residuals import Closure
    from loopcal.estimation.solve.solution import Status
    from loopcal.execution.cluster import Cluster
    from loopcal.execution.local import Processes, Threads
    from loopcal.expressions.trace import TraceError
    from loopcal.expressions.vectors import cross, dot, norm, rot_x, rot_y, rot_z, rotate, vector
    from loopcal.files.machines.mechanism_file import read_mechanism
    from loopcal.files.project.project_data import LoadedData
    from loopcal.files.project.project_file import Project, read_project
    from loopcal.files.result.record_file import RecordCheck
    from loopcal.files.tables.readers import read_dataset
    from loopcal.life.fleet import Fleet
    from loopcal.life.history import History
    from loopcal.measurements.dataset import Dataset
    from loopcal.measurements.datasheet import Tracker, encoder_sd, tracker_covariance
    from loopcal.measurements.noise import Noise
    from loopcal.measurements.plan_settings import Box, PlanSettings, Sight
    from loopcal.mechanisms.effects.effect import Model, with_effects
    from loopcal.mechanisms.machine import Instrument, Machine, assemble
    from loopcal.mechanisms.mechanism import Mechanism
    from loopcal.mechanisms.parameters import Parameter, Parameters
    from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
    from loopcal.mechanisms.prior import Prior
    from loopcal.mechanisms.redundancy import fix_redundant
    from loopcal.mechanisms.serial import Joint, serial_arm
    from loopcal.mechanisms.structure.structured import structured
    from loopcal.mechanisms.terms import Term
    from loopcal.planning.planned import Plan
    from loopcal.pose_performance.summary import Performance
    from loopcal.simulation.poses import grid_poses, random_poses
    from loopcal.simulation.simulate import Simulation
    from loopcal.statistics.change_points import Shifts
    from loopcal.statistics.changed import WhatChanged
    from loopcal.statistics.changes import Shifted, with_shifts
    from loopcal.statistics.check import Check
    from loopcal.statistics.compared import Compared
    from loopcal.statistics.findings import Findings
    from loopcal.statistics.intervals import Interval
    from loopcal.statistics.models import ComparedModel, ModelComparison
    from loopcal.statistics.outliers import Outliers
    from loopcal.statistics.prediction import Prediction
    from loopcal.statistics.reliability import ReadingReliability
    from loopcal.statistics.repeats import Repeats
    from loopcal.statistics.validate import MethodComparison
    from loopcal.statistics.validation import Validation
    from loopcal.statistics.verified import Verification
    from loopcal.workflow.beginning.initial import InitialProject, init
    from loopcal.workflow.correcting import correct
    from loopcal.workflow.exporting import Export, export
    from loopcal.workflow.fleet import fleet
    from loopcal.workflow.history import history
    from loopcal.workflow.performance import performance
    from loopcal.workflow.plan_program import plan_program
    from loopcal.workflow.public import (
        calibrate,
        check,
        compare,
        compare_methods,
        compare_models,
        find_outliers,
        find_shifts,
        findings,
        intervals,
        load_dataset,
        plan,
        predict,
        reliability,
        repeated_readings,
        simulate,
        update,
        validate,
        verdict,
        verify,
    )
    from loopcal.workflow.record import Record, record, verify_record
    from loopcal.workflow.result import Result, write_result
    from loopcal.workflow.saved_result import SavedResult, read_result

_HOME = {
    "deployment.corrected": ("CorrectionBounds",),
    "deployment.correction": ("Correction",),
    "document.goodness_of_fit": ("ChiSquared",),
    "document.change_points": ("ChangePoint",),
    "document.dependence": ("Dependence",),
    "document.findings": ("ColumnFault", "Identifiability", "Outlier", "Undetermined"),
    "document.fit": ("NoiseEntry",),
    "document.result_document": ("ResultDocument", "WrittenResult"),
    "document.parameter_table": ("ParameterTable",),
    "errors": ("InputError", "LoopcalError"),
    "estimation.accuracy": ("Accuracy", "InstrumentAccuracy"),
    "estimation.residuals": ("Closure",),
    "estimation.fit": ("Fit",),
    "estimation.solve.status": ("Status",),
    "execution.cluster": ("Cluster",),
    "execution.local": ("Processes", "Threads"),
    "expressions.trace": ("TraceError",),
    "expressions.vectors": (
        *("cross", "dot", "norm", "rot_x", "rot_y", "rot_z", "rotate", "vector"),
    ),
    "files.result.record_file": ("RecordCheck",),
    "files.tables.readers": ("read_dataset",),
    "files.machines.mechanism_file": ("read_mechanism",),
    "files.project.project_data": ("LoadedData",),
    "files.project.project_file": ("Project", "read_project"),
    "measurements.dataset": ("Dataset",),
    "measurements.datasheet": ("Tracker", "encoder_sd", "tracker_covariance"),
    "measurements.noise": ("Noise",),
    "measurements.plan_settings": ("Box", "PlanSettings", "Sight"),
    "planning.planned": ("Plan",),
    "mechanisms.effects.effect": ("with_effects",),
    "mechanisms.effects.model": ("Model",),
    "mechanisms.machine": ("Instrument", "Machine", "assemble"),
    "mechanisms.mechanism": ("Mechanism",),
    "mechanisms.motoman": ("motoman_ma1400",),
    "mechanisms.parameters": ("Parameter", "Parameters"),
    "mechanisms.planar": ("planar_two_link",),
    "mechanisms.prior": ("Prior",),
    "mechanisms.redundancy": ("fix_redundant",),
    "mechanisms.serial": ("Joint", "serial_arm"),
    "mechanisms.structure.structured": ("structured",),
    "mechanisms.terms": ("Term",),
    "pose_performance.result": ("Performance",),
    "simulation.poses": ("grid_poses", "random_poses"),
    "simulation.simulate": ("Simulation",),
    "statistics.check": ("Check",),
    "statistics.compared": ("Compared",),
    "statistics.intervals": ("Interval",),
    "statistics.validate": ("MethodComparison",),
    "statistics.validation": ("Validation",),
    "document.verdict": ("Answer", "Verdict"),
    "statistics.changed": ("WhatChanged",),
    "statistics.verified": ("Verification",),
    "statistics.models": ("ComparedModel", "ModelComparison"),
    "statistics.change_points": ("Shifts",),
    "statistics.outliers": ("Outliers",),
    "statistics.reliability": ("ReadingReliability",),
    "statistics.shifted": ("Shifted", "with_shifts"),
    "statistics.findings": ("Findings",),
    "statistics.prediction": ("Prediction",),
    "statistics.repeats": ("Repeats",),
    "workflow.beginning.initial": ("InitialProject", "init"),
    "workflow.result": ("Result", "write_result"),
    "workflow.exporting": ("Export", "export"),
    "workflow.correcting": ("correct",),
    "workflow.plan_program": ("plan_program",),
    "workflow.performance": ("performance",),
    "workflow.public": (
        *("calibrate", "check", "compare", "compare_methods", "compare_models", "find_outliers"),
        *("find_shifts", "findings", "intervals", "load_dataset", "plan", "predict"),
        *("reliability", "repeated_readings", "simulate", "update", "validate", "verdict"),
        "verify",
    ),
    "workflow.record": ("Record", "record", "verify_record"),
    "workflow.fleet": ("fleet",),
    "life.fleet": ("Fleet",),
    "workflow.history": ("history",),
    "life.history": ("History",),
    "workflow.saved_result": ("SavedResult", "read_result"),
}
_NAMESPACES = ("effects", "instruments", "machines")
_MODULE = {name: f"loopcal.{module}" for module, names in _HOME.items() for name in names}

__all__ = [
    "Accuracy",
    "Answer",
    "Box",
    "ChangePoint",
    "Check",
    "ChiSquared",
    "Closure",
    "Cluster",
    "ColumnFault",
    "Compared",
    "ComparedModel",
    "Correction",
    "CorrectionBounds",
    "Dataset",
    "Dependence",
    "Export",
    "Findings",
    "Fit",
    "Fleet",
    "History",
    "Identifiability",
    "InitialProject",
    "InputError",
    "Instrument",
    "InstrumentAccuracy",
    "Interval",
    "Joint",
    "LoadedData",
    "LoopcalError",
    "Machine",
    "Mechanism",
    "MethodComparison",
    "Model",
    "ModelComparison",
    "Noise",
    "NoiseEntry",
    "Outlier",
    "Outliers",
    "Parameter",
    "ParameterTable",
    "Parameters",
    "Performance",
    "Plan",
    "PlanSettings",
    "Prediction",
    "Prior",
    "Processes",
    "Project",
    "ReadingReliability",
    "Record",
    "RecordCheck",
    "Repeats",
    "Result",
    "ResultDocument",
    "SavedResult",
    "Shifted",
    "Shifts",
    "Sight",
    "Simulation",
    "Status",
    "Term",
    "Threads",
    "TraceError",
    "Tracker",
    "Undetermined",
    "Validation",
    "Verdict",
    "Verification",
    "WhatChanged",
    "WrittenResult",
    "__version__",
    "assemble",
    "calibrate",
    "check",
    "compare",
    "compare_methods",
    "compare_models",
    "correct",
    "cross",
    "dot",
    "effects",
    "encoder_sd",
    "export",
    "find_outliers",
    "find_shifts",
    "findings",
    "fix_redundant",
    "fleet",
    "grid_poses",
    "history",
    "init",
    "instruments",
    "intervals",
    "load_dataset",
    "machines",
    "motoman_ma1400",
    "norm",
    "performance",
    "plan",
    "plan_program",
    "planar_two_link",
    "predict",
    "random_poses",
    "read_dataset",
    "read_mechanism",
    "read_project",
    "read_result",
    "record",
    "reliability",
    "repeated_readings",
    "rot_x",
    "rot_y",
    "rot_z",
    "rotate",
    "serial_arm",
    "simulate",
    "structured",
    "tracker_covariance",
    "update",
    "validate",
    "vector",
    "verdict",
    "verify",
    "verify_record",
    "with_effects",
    "with_shifts",
    "write_result",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from loopcal.files.versions import version

        return version()
    if name in _NAMESPACES:
        return import_module(f"loopcal.{name}")
    if name not in _MODULE:
        raise AttributeError(f"module 'loopcal' has no attribute {name!r}")
    found = getattr(import_module(_MODULE[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
