"""The single path behind command line and app: everything a user asks for, end to end."""

from loopcal.workflow.calibration import (
    Calibration,
    default_folder,
    run_calibration,
    write_result,
)
from loopcal.workflow.checking import Checked, prediction_table, run_check, run_prediction
from loopcal.workflow.projects import SCHEMAS, NewProject, new_project, schema
from loopcal.workflow.sensors import SensorNoise, sensor_noise
from loopcal.workflow.simulation import Simulated, run_simulation

__all__ = [
    "SCHEMAS",
    "Calibration",
    "Checked",
    "NewProject",
    "SensorNoise",
    "Simulated",
    "default_folder",
    "new_project",
    "prediction_table",
    "run_calibration",
    "run_check",
    "run_prediction",
    "run_simulation",
    "schema",
    "sensor_noise",
    "write_result",
]
