"""Calibration of mechanisms with every sensor uncertain.

    import loopcal as lc
    result = lc.calibrate("joints.csv", "tracker.csv", urdf="robot.urdf")
    print(result)                          # whether it can be used, and for what

Readings are files, DataFrames, dicts of arrays or arrays; values are SI (m, rad). Type
help(lc.NAME) for any of these; docs/reference/api.md has them all, with examples.

calibrate      calibrate(*readings, urdf=...); calibrate("project.toml"); calibrate(mechanism, data)
init, check    the project that files amount to; what its poses can determine before any fit
load           a result's folder, a project, a mechanism or a URDF, by its path
load_urdf      the machine of a URDF; machine.fk(q) says where it is
result         .verdict .summary() .params .value .sd .covariance .accuracy_after
               .predict(readings) .fk(q) .plot() .report() .save(folder) .to_dataframe()
               .to_urdf(path) .export(format) .correct(targets)
verify         another day: is it still the machine that was calibrated
predict, plot, report, export, correct     the same of a result, or of the path of its folder
compare, validate, intervals, find_outliers, find_shifts     how far a result can be trusted
plan           which poses to measure
update, history, fleet, record, performance     a machine's life
simulate, grid_poses, random_poses     readings with known truth

Mechanism      Mechanism.from_function(f, quantities, parameters): loops of your own
assemble       a mechanism of a machine (lc.machines) and instruments (lc.instruments)
structured, with_effects, lc.effects     beyond geometry: sag, gears, temperature
Dataset, Noise, Prior     readings, sds of sensors, what is known of parameters
read_dataset, read_bag, read_project, read_mechanism, read_result     from files
InputError     what is wrong, where, why, and what to do
"""

from __future__ import annotations

from loopcal import import_path as _import_path  # noqa: F401  before anything else is looked for

# isort: split
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

# A name as itself is public to type checkers.
# isort: off
if TYPE_CHECKING:
    from loopcal import effects as effects, instruments as instruments, machines as machines
    from loopcal.companions.life.fleet import Fleet as Fleet
    from loopcal.companions.life.fleet_files import fleet as fleet
    from loopcal.companions.life.history import History as History
    from loopcal.companions.life.history_files import history as history
    from loopcal.companions.life.update_files import update as update
    from loopcal.companions.performance.performance import performance as performance
    from loopcal.companions.performance.summary import Performance as Performance
    from loopcal.companions.planning.plan_files import plan as plan
    from loopcal.companions.planning.planned import Plan as Plan
    from loopcal.companions.planning.plan_files import plan_program as plan_program
    from loopcal.companions.record.record import (
        Record as Record,
        record as record,
        verify_record as verify_record,
    )
    from loopcal.companions.record.record_file import RecordCheck as RecordCheck
    from loopcal.companions.robot.correct_files import correct as correct
    from loopcal.companions.robot.corrected import CorrectionBounds as CorrectionBounds
    from loopcal.companions.robot.correction import Correction as Correction
    from loopcal.companions.robot.export_files import Export as Export, export as export
    from loopcal.document.change_points import (
        ChangePoint as ChangePoint,
        Dependence as Dependence,
        Shifts as Shifts,
    )
    from loopcal.document.findings import (
        ColumnFault as ColumnFault,
        Identifiability as Identifiability,
        Outlier as Outlier,
        Undetermined as Undetermined,
    )
    from loopcal.document.fit import ChiSquared as ChiSquared, NoiseEntry as NoiseEntry
    from loopcal.document.parameter_table import ParameterTable as ParameterTable
    from loopcal.document.result_document import (
        ResultDocument as ResultDocument,
        WrittenResult as WrittenResult,
    )
    from loopcal.document.verdict import Answer as Answer, Verdict as Verdict
    from loopcal.errors import InputError as InputError, LoopcalError as LoopcalError
    from loopcal.estimation.accuracy import (
        Accuracy as Accuracy,
        InstrumentAccuracy as InstrumentAccuracy,
    )
    from loopcal.estimation.fit import Fit as Fit
    from loopcal.estimation.residuals import Closure as Closure
    from loopcal.estimation.solve.solution import Status as Status
    from loopcal.execution.cluster import Cluster as Cluster
    from loopcal.execution.local import Processes as Processes, Threads as Threads
    from loopcal.expressions.trace import TraceError as TraceError
    from loopcal.expressions.vectors import (
        cross as cross,
        dot as dot,
        norm as norm,
        rot_x as rot_x,
        rot_y as rot_y,
        rot_z as rot_z,
        rotate as rotate,
        vector as vector,
    )
    from loopcal.files.machines.mechanism_file import read_mechanism as read_mechanism
    from loopcal.files.project.project_data import LoadedData as LoadedData
    from loopcal.files.project.project_file import Project as Project, read_project as read_project
    from loopcal.files.tables.bag import read_bag as read_bag
    from loopcal.files.tables.readers import read_dataset as read_dataset
    from loopcal.files.tables.recording import Recording as Recording
    from loopcal.measurements.dataset import Dataset as Dataset
    from loopcal.measurements.datasheet import (
        Tracker as Tracker,
        encoder_sd as encoder_sd,
        tracker_covariance as tracker_covariance,
    )
    from loopcal.measurements.noise import Noise as Noise
    from loopcal.measurements.plan_settings import (
        Box as Box,
        PlanSettings as PlanSettings,
        Sight as Sight,
    )
    from loopcal.mechanisms.effects.effect import Model as Model, with_effects as with_effects
    from loopcal.mechanisms.machine import (
        Instrument as Instrument,
        Machine as Machine,
        assemble as assemble,
    )
    from loopcal.mechanisms.mechanism import Mechanism as Mechanism
    from loopcal.mechanisms.parameters import Parameter as Parameter, Parameters as Parameters
    from loopcal.mechanisms.planar import (
        motoman_ma1400 as motoman_ma1400,
        planar_two_link as planar_two_link,
    )
    from loopcal.mechanisms.prior import Prior as Prior
    from loopcal.mechanisms.redundancy import fix_redundant as fix_redundant
    from loopcal.mechanisms.serial import Joint as Joint, serial_arm as serial_arm
    from loopcal.mechanisms.structure.structured import structured as structured
    from loopcal.mechanisms.terms import Term as Term
    from loopcal.report.page import report as report
    from loopcal.simulation.poses import grid_poses as grid_poses, random_poses as random_poses
    from loopcal.simulation.simulate import Simulation as Simulation
    from loopcal.statistics.changed import WhatChanged as WhatChanged
    from loopcal.statistics.changes import Shifted as Shifted, with_shifts as with_shifts
    from loopcal.statistics.check import Check as Check
    from loopcal.statistics.compared import Compared as Compared
    from loopcal.statistics.findings import Findings as Findings
    from loopcal.statistics.intervals import Interval as Interval
    from loopcal.statistics.models import (
        ComparedModel as ComparedModel,
        ModelComparison as ModelComparison,
    )
    from loopcal.statistics.outliers import Outliers as Outliers
    from loopcal.statistics.prediction import Prediction as Prediction
    from loopcal.statistics.reliability import ReadingReliability as ReadingReliability
    from loopcal.statistics.repeats import Repeats as Repeats
    from loopcal.statistics.validate import MethodComparison as MethodComparison
    from loopcal.statistics.validation import Validation as Validation
    from loopcal.statistics.verified import Verification as Verification
    from loopcal.workflow.beginning.initial import InitialProject as InitialProject, init as init
    from loopcal.workflow.opening import load as load, load_urdf as load_urdf, plot as plot
    from loopcal.workflow.public import (
        calibrate as calibrate,
        check as check,
        compare as compare,
        compare_methods as compare_methods,
        compare_models as compare_models,
        find_outliers as find_outliers,
        find_shifts as find_shifts,
        findings as findings,
        intervals as intervals,
        load_dataset as load_dataset,
        predict as predict,
        reliability as reliability,
        repeated_readings as repeated_readings,
        simulate as simulate,
        validate as validate,
        verdict as verdict,
        verify as verify,
    )
    from loopcal.workflow.result import Result as Result, write_result as write_result
    from loopcal.workflow.saved_result import SavedResult as SavedResult, read_result as read_result

# isort: on

_HOME = {
    "companions.robot.corrected": ("CorrectionBounds",),
    "companions.robot.correction": ("Correction",),
    "document.change_points": ("ChangePoint", "Dependence", "Shifts"),
    "document.findings": ("ColumnFault", "Identifiability", "Outlier", "Undetermined"),
    "document.fit": ("ChiSquared", "NoiseEntry"),
    "document.result_document": ("ResultDocument", "WrittenResult"),
    "document.parameter_table": ("ParameterTable",),
    "errors": ("InputError", "LoopcalError"),
    "estimation.accuracy": ("Accuracy", "InstrumentAccuracy"),
    "estimation.residuals": ("Closure",),
    "estimation.fit": ("Fit",),
    "estimation.solve.solution": ("Status",),
    "execution.cluster": ("Cluster",),
    "execution.local": ("Processes", "Threads"),
    "expressions.trace": ("TraceError",),
    "expressions.vectors": (
        *("cross", "dot", "norm", "rot_x", "rot_y", "rot_z", "rotate", "vector"),
    ),
    "companions.record.record_file": ("RecordCheck",),
    "files.tables.bag": ("read_bag",),
    "files.tables.readers": ("read_dataset",),
    "files.tables.recording": ("Recording",),
    "files.machines.mechanism_file": ("read_mechanism",),
    "files.project.project_data": ("LoadedData",),
    "files.project.project_file": ("Project", "read_project"),
    "measurements.dataset": ("Dataset",),
    "measurements.datasheet": ("Tracker", "encoder_sd", "tracker_covariance"),
    "measurements.noise": ("Noise",),
    "measurements.plan_settings": ("Box", "PlanSettings", "Sight"),
    "companions.planning.planned": ("Plan",),
    "mechanisms.effects.effect": ("Model", "with_effects"),
    "mechanisms.machine": ("Instrument", "Machine", "assemble"),
    "mechanisms.mechanism": ("Mechanism",),
    "mechanisms.parameters": ("Parameter", "Parameters"),
    "mechanisms.planar": ("motoman_ma1400", "planar_two_link"),
    "mechanisms.prior": ("Prior",),
    "mechanisms.redundancy": ("fix_redundant",),
    "mechanisms.serial": ("Joint", "serial_arm"),
    "mechanisms.structure.structured": ("structured",),
    "mechanisms.terms": ("Term",),
    "companions.performance.summary": ("Performance",),
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
    "statistics.outliers": ("Outliers",),
    "statistics.reliability": ("ReadingReliability",),
    "statistics.changes": ("Shifted", "with_shifts"),
    "statistics.findings": ("Findings",),
    "statistics.prediction": ("Prediction",),
    "statistics.repeats": ("Repeats",),
    "workflow.beginning.initial": ("InitialProject", "init"),
    "report.page": ("report",),
    "workflow.opening": ("load", "load_urdf", "plot"),
    "workflow.result": ("Result", "write_result"),
    "companions.robot.export_files": ("Export", "export"),
    "companions.robot.correct_files": ("correct",),
    "companions.performance.performance": ("performance",),
    "workflow.public": (
        *("calibrate", "check", "compare", "compare_methods", "compare_models", "find_outliers"),
        *("find_shifts", "findings", "intervals", "load_dataset", "predict"),
        *("reliability", "repeated_readings", "simulate", "validate", "verdict"),
        "verify",
    ),
    "companions.record.record": ("Record", "record", "verify_record"),
    "companions.life.fleet_files": ("fleet",),
    "companions.life.fleet": ("Fleet",),
    "companions.life.history_files": ("history",),
    "companions.life.history": ("History",),
    "workflow.saved_result": ("SavedResult", "read_result"),
    "companions.planning.plan_files": ("plan", "plan_program"),
    "companions.life.update_files": ("update",),
}
_NAMESPACES = ("effects", "instruments", "machines")
_INSTEAD = {
    "Robot": "lc.load_urdf, or lc.assemble",
    **dict.fromkeys(("URDF", "load_robot", "robot"), "lc.load_urdf"),
    **dict.fromkeys(("kinematics", "fk", "forward_kinematics"), "lc.load_urdf('robot.urdf').fk(q)"),
    **dict.fromkeys(("DHRobot", "SerialArm", "ERobot"), "lc.calibrate(readings, dh='dh.csv')"),
    **dict.fromkeys(
        ("from_pandas", "from_dataframe", "from_numpy", "DataFrame"),
        "lc.calibrate(readings, urdf='robot.urdf'), which takes a DataFrame or arrays as they are",
    ),
    **dict.fromkeys(
        ("solve", "optimize", "minimize", "least_squares", "curve_fit", "identify", "estimate"),
        "lc.calibrate",
    ),
    **dict.fromkeys(("set_seed", "seed"), "seed=... of lc.simulate"),
    **dict.fromkeys(("datasets", "examples", "example"), "the command loopcal demo"),
    **dict.fromkeys(("show", "view"), "result.plot() or result.report()"),
    **dict.fromkeys(("load_data", "read_excel", "load_mat"), "lc.read_dataset, or lc.init"),
    **dict.fromkeys(("cross_validate", "cross_val_score"), "lc.validate(result)"),
    **dict.fromkeys(
        ("hand_eye", "handeye", "calibrate_camera", "calibrate_hand_eye"),
        "lc.calibrate(folder of images, urdf='robot.urdf')",
    ),
    **dict.fromkeys(
        ("load_dh", "read_dh", "from_dh"), "lc.calibrate(readings, dh='dh.csv'), or lc.serial_arm"
    ),
    "demo": "the command loopcal demo",
    "fit": "lc.calibrate",
    "from_urdf": "lc.load_urdf",
    "monte_carlo": "lc.simulate and lc.calibrate in a loop, or the command loopcal study",
    "study": "the command loopcal study FILE",
    "load_csv": "lc.read_dataset, or lc.init for columns of any layout",
    "noise": "lc.repeated_readings, or lc.Noise to state sds",
    "help": "help(loopcal)",
    "save": "result.save(folder)",
    "read": "lc.load, or lc.read_dataset for readings",
    "read_csv": "lc.read_dataset, or lc.init for columns of any layout",
    "read_urdf": "lc.load_urdf",
    "version": "lc.__version__",
}
_MODULE = {name: f"loopcal.{module}" for module, names in _HOME.items() for name in names}

__all__ = sorted({"__version__", *_NAMESPACES, *_MODULE})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from loopcal.files.versions import version

        return version()
    if name in _NAMESPACES:
        return import_module(f"loopcal.{name}")
    if name not in _MODULE:
        from loopcal.errors import closest

        # Programs that look into modules ask for names with an underscore, hundreds of times.
        close = None if name.startswith("_") else closest(name, __all__)
        near = f"did you mean {close!r}?" if close else "help(loopcal) lists what there is"
        near = f"use {_INSTEAD[name]}" if name in _INSTEAD else near
        raise AttributeError(f"module 'loopcal' has no attribute {name!r}: {near}")
    found = getattr(import_module(_MODULE[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    frame = sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__") in (__name__, "inspect"):
        frame = frame.f_back
    # pydoc would print every class in full, 6000 lines; without names it prints the text above.
    return [] if frame.f_globals.get("__name__") == "pydoc" else sorted(__all__)
