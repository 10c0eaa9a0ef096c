"""Every text of the app, in one place."""

from __future__ import annotations

NAME, STEPS = "loopcal", "Steps"
TITLE = "{step} - {folder} - loopcal"
LIGHTS = {
    "none": ("radio_button_unchecked", "not begun"),
    "good": ("check_circle", "good"),
    "care": ("error", "look at it"),
    "bad": ("cancel", "wrong"),
}
SAME = "the same on the command line"
NO_PROJECT = (
    "There is no project in this folder yet. Begin with the steps Robot and Data: "
    "they need a description of the robot and the readings. Cameras begin with the step Data."
)
NO_RESULT = "There is no result yet. Calibrate in the step Fit first."
NO_OUTPUTS = "The result has no outputs that could be compared with readings."
STALE = "The project has changed since this result. Fit again to see the effect."
FITTING = "The project has changed since this result. Its fit is running."
PROVISIONAL = (
    "Provisional: error {after} rms, {before} in the last result. Fitted by {label}, from where "
    "the last result ended."
)
UNJUDGED = "Nothing is chosen, validated or judged yet. Calibrate for a result that you can use."
JUDGING = (
    "The calibration continues: it chooses the method, validates and judges. "
    "Its result replaces these numbers."
)
NOT_CONVERGED = "This fit did not converge."
PROVISIONAL_PARAMETERS = "Provisional parameters"
LAST_RESULT = "Last result"
NO_REGION = "The result states no working region, so loopcal cannot predict over it."
RUNNING = "running"
READING = "Reading the files ..."
RUN_NEXT = "Run the next command"
LEFT = "about {seconds} s left"
CANCELLED = "cancelled; nothing was written"
CHANGED = "Another page or program has changed the folder. This page shows it now."
UNFINISHED = "The last run did not finish: {command}. Run it again."
FAULT = "This step cannot be shown: {fault}. This is a fault of loopcal; please report it."
NOT_DONE = "Nothing was done: {fault}. This is a fault of loopcal; please report it."
DONE, ENDED = "done", "ended with exit code {code}"
KILLED = "the run was killed; nothing was written. Run it again."
MEANING = {
    2: "the command line was wrong",
    3: "an input was wrong",
    4: "read the message before you use the result",
    1: "a fault of loopcal",
}
NOT_WHOLE = "{shown:,} of {all:,} poses are drawn, the worst among them. All count in the fit."
FIRST_ROWS = "{all:,} poses; the table shows the first {shown:,}"
TOLERANCE = "Tolerance of 95 % of poses [mm]"
REASON, COMMON_REASONS = "Reason, for the log", "Common reasons"
REASONS = {
    "excluded": ("bad reading", "reflector not seen", "wrong pose", "collision"),
    "shifted": ("reflector slipped", "reflector replaced", "instrument moved", "base moved"),
}
SELECTED = "{count:,} of {all:,} poses selected"
NONE_SELECTED = (
    "No pose is selected. Drag over points of a figure, click one and Shift-click another, or "
    "name the ends."
)
ENDS = ("From pose", "To pose")
STEPPERS = {-1: ("chevron_left", "one pose earlier"), 1: ("chevron_right", "one pose later")}
RUN, RUN_RMS = "pose {first} to {last}", "pose {first} to {last}, rms {rms}"
RUNS = "Select a run"
FROM_POSE = "from pose {pose}"
WHY = "Why"
UNASKED = "not asked"
ACCEPT, ACCEPTED = "Accept", "In the project; fit again."
BEFORE_AFTER = {True: "Before", False: "After"}
BEFORE_AFTER_NAME = "errors before or after the changes are taken up"
EXCLUDE_NAMED = "Exclude pose {poses}"
ZOOM_IN, ZOOM_OUT = "Zoom in", "Show all poses"
MOVING = {
    False: ("Reflector", "Instrument"),
    True: ("Camera or board on the robot", "Camera or board in the cell"),
}
"""What is mounted on the machine and what stands beside it, without and with images."""
PARAMETERS_MOVED = "{what} moved here"
BY_LOOPCAL = "found by loopcal"
DRAG, DRAG_TURNS, DRAG_SELECTS = "Drag in space", "Drag turns", "Drag selects"
NO_SUCH_POSE = "The result has no pose {pose}."
CHOOSE_FILES = "Choose files"
TOO_LARGE = "The file is larger than an upload may be."
NO_ROBOT = "A camera without a robot, or with the poses of a flange, needs none: go on with Data."
ROBOT_FIRST = (
    "Describe the robot first, in the step Robot. Corners of a camera need none: cameras alone, or "
    "with the poses of a flange, are recognised without."
)
STATE_IT = "Links and sheet, where several fit"
NO_READINGS = "There is no file of readings in the folder yet."
ROBOT_DONE = (
    "The robot is described by {name}. Go on with the step Data, or with Plan before you measure."
)
PLAN_FIRST = "Nothing is measured yet. Begin a project of the robot alone, to choose poses for it."
PLAN_FROM = "Plan for {name}"
MEASURED = "{count} of {all} planned poses are measured"
NEXT_POSE = "Next, pose {pose}: {at}"
STOP = "Stop here: all poses of the plan are measured. Calibrate in the step Fit."
MORE_POSES = (
    "All poses of the plan are measured, but they promise less than the tolerance asks. "
    "Choose more poses beside them."
)
CHANGE_ROBOT = (
    "To describe the robot anew, remove the project: files stay, and History can undo it."
)
BAD_CELLS = (
    "{count} cells are no numbers. Correct the file and drop it again, or exclude the poses."
)
COLUMNS = (
    "Press a pose in the table below: the robot moves there. "
    "If it looks wrong, choose another column or unit."
)
PLAN_RANGES = "Ranges of the joints"
RANGES_HOW = (
    "Poses are chosen within these ranges. Without an entry the limits of the machine hold, shown "
    "in grey, or the readings measured already."
)
RANGE_ENDS = ("from", "to")
PLANNED = "Move the slider: the robot moves from pose to pose in the order of the plan."
COMPARED = (
    "Calibrate with several methods, each validated on ten parts of the poses that its fit does "
    "not use. Each result gets a folder of its own."
)
NO_MESHES = "Drawn without meshes that the folder does not have: {meshes}"
DROP_MESHES = "Drop the meshes of the links here"
ARROWS = "Arrows: from measured to computed, {times} times as long."
ROBOT_DRAWN = "the robot"
ROBOT_IN_ROW, ROBOT_PLANNED = "the robot in the selected row", "the robot in the planned poses"
MAP = "Click a point: the sliders and the prediction below show its pose."
NOT_OF_RESULT = "Not of this result. Write it again."
DIFFERENCE = "Lines that change are marked with - (before) and + (after)."
EXPORT_FIRST = "Preview the files, then write them."
NO_DIFFERENCE = "Nothing changes."
CORRECT = (
    "loopcal computes targets for which the real machine reaches the poses of your program. "
    "The corrected program is a new file; the original stays."
)
RECORD = "State who measured what, and with what. The record is a page for print."
RECORD_FIELDS = "Who measured what, and with what: {count} of {all} stated"
NO_ENTRY, NOTHING_DONE = "The log has no line {number}.", "Nothing has been done here yet."
EVENT = "What happened: collision, new belt, moved base ..."
MACHINE = "Calibrations, verifications and events of the machine, in the folder machine.history."
NO_HISTORY = "The machine has no history yet. Add this result, or an event."
VERIFY = "Verify the calibration with readings of another day, in the columns of the project."
LOG_BROKEN = "Lines of the log that cannot be read, and are skipped: {lines}"
NOTHING_TO_PLAN = (
    "No robot moves camera or board, so poses cannot be planned. Take images with the board tilted "
    "by 20 to 45 deg either way, at several distances and in all parts of the image."
)
NO_PROGRAM = "none"
PULSES = "Pulses per degree, for Yaskawa: n, n, ..."
CRITERIA = {
    "": "automatic",
    "I": "mean accuracy of the end point",
    "G": "worst accuracy of the end point",
    "D": "all parameters together",
    "A": "mean sd of the parameters",
}
AS_STATED = "as the project states"
FOLDS = {"": AS_STATED, "5": "5 parts", "10": "10 parts"}

# Labels, headings and buttons.
CHECK = "Check"
REMARKS = "What is fixed, and why"
NOT_APART = "What these poses cannot distinguish"
CURE, CURE_PLAN = "Poses that would cure it", "The step Plan chooses poses, and writes them."
EXPECTED, RANGES = "Parameters, and the sds to expect", "Readings"
EXPECTED_HEAD = ("parameter", "nominal", "prior sd", "expected sd", "unit", "role")
RANGE_HEAD = ("quantity", "readings", "smallest", "largest", "sd", "unit")
DROP_READINGS = "Drop the files of readings here"
FILES_READINGS = "Files of readings"
RECOGNISE = "Recognise"
COLUMNS_HEAD = "Columns"
BASE_LINK = "Link that does not move"
TIP_LINK = "Link that carries the target"
PART_OF_FILE = "Sheet, variable or topic of the file"
RECOGNISE_READINGS = "Recognise the readings"
FILES_PROJECT = "Files of the project"
EXPORT = "Export"
PREVIEW = "Preview"
CORRECT_PROGRAM = "Correct a program"
DROP_PROGRAM = "Drop a program, or a table of targets, here"
CORRECT_IT = "Correct"
RECORD_HEAD = "Record"
WRITE_RECORD = "Write the record"
FORMAT = "Format"
PREVIEW_EXPORT = "Preview the export"
WRITE = "Write"
PROGRAM_OR_TARGETS = "Program or table of targets"
LIMB = "Limb, by the body at its end"
TOOL_PROGRAM = "Tool of the program"
PROGRAM_FRAME = "Frame: x, y, z [mm], rz, ry, rx [deg]"
OPEN_RECORD = "Open the record"
SOURCE_FILE = "Your own file"
ZERO_OFFSETS_JOINTS = "Zero offsets of joints"
ORIENTATIONS = "Orientations"
SELECTED_POSES = "Selected poses"
FIT_AGAIN = "Fit again"
EXCLUDE = "Exclude"
SELECT_NONE = "Select none"
SELECT_THESE_POSES = "Select these poses"
CALIBRATE = "Calibrate"
SIDE_BY_SIDE = "Methods side by side"
ANOTHER_METHOD = "Another method"
TRY_IT = "Try it"
PARAMETERS = "Parameters"
FIXED = "Fixed parameters: {count}"
FREE = "Parameters to estimate: {count}"
METHOD = "Method"
VALIDATE_ON = "Validate on"
CALIBRATE_OTHERWISE = "Calibrate by another method"
OPEN_WHOLE_REPORT = "Open the whole report"
FOLDER_LOG = "Done in this folder"
MACHINE_OVER_TIME = "The machine over time"
ADD_THIS_EVENT = "Add this event"
OPEN_PAGE_HISTORY = "Open the page of the history"
ADD_THIS_RESULT = "Add this result"
ADD_HISTORY = "Add to the history"
CHOOSE_POSES = "Choose poses"
POSES_TO_MEASURE = "Poses to measure"
BEST_FOR = "Best for"
MEASURED_ALREADY = "Measured already"
CHOOSE_AMONG = "Choose among"
PROGRAM_POSES = "Program of the poses"
OPEN_PAGE_PLAN = "Open the page of the plan"
DH_TABLE = "Denavit-Hartenberg table"
TYPE = "Type"
REMOVE_PROJECT = "Remove the project"
PREDICTED_SD = "Predicted sd over the working region"
ANOTHER_DAY = "Verify on another day"
DROP_ANOTHER_DAY = "Drop readings of another day here"
READINGS = "Readings"
VERIFY_IT = "Verify"
PREDICT_ONE_POSE = "Predict one pose"
COPY = "Copy"
CLOSE = "Close"
CANCEL = "Cancel"
OUTPUT = "Output"
EXCLUDE_BAD = ("Exclude 1 pose", "Exclude {count} poses")
WAITING = "{name} is in the folder, but the project does not read it."
USE_INSTEAD, LEAVE_ASIDE = "Use it instead of {name}", "Leave it aside"
STATE_SOURCE = "The project reads several files. Name it in [[data.source]], or remove the project."
DROPPED, USE_AGAIN = "handed in", "Use them again"
OUTDATED = "The inputs have changed since this was computed. Run it again."
CHECKED_EARLIER = "Checked at {at} UTC. Check again to see the answer."
CORNERS_SEEN = "corners of {camera}"
EXCLUDED = "Excluded: pose {poses}"
UNDO = "Undo: {what}"
BY_METHOD = "Method: {label}"
DOWNLOAD = "Download {name}"
DROP_ROBOT = "Drop the {kind} here"
VALIDATED = "Validated on {words}."
STATED = {
    "laboratory": "Laboratory, with its address",
    "customer": "Customer",
    "machine": "Machine: make and model",
    "serial": "Serial number of the machine",
    "instrument": "Instrument: make and model",
    "instrument_serial": "Serial number of the instrument",
    "traceability": "Calibration of the instrument",
    "date": "Day of the measurement",
    "operator": "Operator",
    "temperature": "Temperature",
}
TOOLS = {"calibrated": "calibrated", "nominal": "nominal"}
