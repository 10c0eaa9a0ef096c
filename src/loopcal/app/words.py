"""Every text of the app, in one place."""

from __future__ import annotations

STEPS = {
    "robot": "Describe the robot: a URDF, a table of Denavit-Hartenberg parameters, or a type.",
    "data": "Give the readings. loopcal recognises columns and units; correct what is wrong.",
    "plan": "Choose which poses to measure.",
    "check": "See what the readings can determine before a fit.",
    "fit": "Calibrate.",
    "diagnose": "Find what does not fit. Drag over points to select poses; all figures follow.",
    "validate": "See how good the calibration is where nothing was measured.",
    "deploy": "Take the result to the robot.",
    "history": "See what was done here, and take it back.",
}
LIGHTS = {
    "none": ("radio_button_unchecked", "not begun"),
    "good": ("check_circle", "good"),
    "care": ("error", "look at it"),
    "bad": ("cancel", "wrong"),
}
SAME = "The same on the command line:"
NO_PROJECT = "There is no project in this folder yet. Begin with the robot and the readings."
NO_RESULT = "There is no result yet. Calibrate first."
NO_REGION = "The result states no working region, so nothing can be predicted over it."
RUNNING = "running"
CANCELLED = "cancelled; nothing was written"
CHANGED = "Another page or program has changed the folder; this page shows it now."
UNFINISHED = "The last run did not finish: {command}. Run it again."
FAULT = "This step cannot be shown: {fault}. This is a fault of loopcal; please report it."
DONE, ENDED = "done", "ended with exit code {code}"
MEANING = {
    2: "the command line was wrong",
    3: "an input was wrong: see below",
    4: "the result must not be used: see below",
    1: "a fault of loopcal",
}
NOT_WHOLE = "{shown} of {all} poses are drawn, the worst among them."
REASON = "Reason, for the log"
ASK_REASON = "Say why first: the log keeps it."
SELECTED = "{count} of {all} poses selected"
NONE_SELECTED = "No pose selected. Drag over points of a figure, or click one."
TOO_LARGE = "The file is larger than an upload may be."
