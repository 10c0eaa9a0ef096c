"""One folder while the app serves it: what stands in it, and the run that goes on."""

from __future__ import annotations

import json
import logging
import os
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, Generic, TypeVar

from loopcal.companions.app import words
from loopcal.companions.app.cards import begins
from loopcal.companions.app.edits import with_changes, with_shift, with_value, without_poses
from loopcal.companions.app.project_folder import RESULT, Entry, ProjectFolder
from loopcal.companions.app.refits import Asked, News, Refits
from loopcal.companions.app.steps import State
from loopcal.companions.app.worker import Action, Command, Run, Worker
from loopcal.companions.robot.programs.registry import BY_ENDING as PROGRAMS
from loopcal.document.change_points import ChangePoints
from loopcal.errors import InputError, LoopcalError
from loopcal.files.machines.meshes import DrawnLinks, read_links
from loopcal.files.machines.python_function import load_function
from loopcal.files.machines.urdf import NO_URDF, branches
from loopcal.files.project.project_data import LoadedData
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.project.stream import load_sample
from loopcal.files.recognition.dh_table import read_dh
from loopcal.files.tables.registry import BY_ENDING as READERS
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.outputs import seen_outputs
from loopcal.mechanisms.parameters import GEOMETRY
from loopcal.report.source import Source, read_source
from loopcal.statistics.changes import COLUMN, ids_are_numbers
from loopcal.statistics.continued import Ending
from loopcal.workflow.projects import Refit

INIT = "loopcal init "
LOOKS_EVERY = 0.4
"""Seconds between looks at the folder, for what other programs change."""


def checked(run: Run) -> Mapping[str, Any] | None:
    """What `check --json` found; None where it failed, or said more than is kept."""
    try:
        answer: Mapping[str, Any] | None = json.loads(run.output) if run.code == 0 else None
    except ValueError:
        return None
    return answer


Value = TypeVar("Value")


class Cached(Generic[Value]):
    """What was read of the folder, or why it could not be, for as long as nothing has changed."""

    def __init__(self) -> None:
        self.at: object = None
        self.value: Value | None = None
        self.objection = ""
        self._lock = Lock()

    def read(self, at: object, read: Callable[[], Value]) -> Value | None:
        """The value; at: another one whenever it must be read anew. None: it cannot be read."""
        with self._lock:  # one state gives one object, whichever thread reads it
            if self.at != at:
                self.value, self.objection = None, ""
                try:
                    self.value = read()
                except LoopcalError as error:
                    self.objection = error.text
                self.at = at
            return self.value


class Session:
    """What all pages on one folder share. Everything confirmed stands on the disk.

    function: FILE.py:NAME of the loops, where the command line named it; with_loops: the commands
    that take them.
    """

    def __init__(
        self,
        folder: Path,
        command: Command,
        function: str | None = None,
        with_loops: Collection[str] = (),
    ) -> None:
        self.with_loops = with_loops
        self.folder = ProjectFolder(folder, frozenset(PROGRAMS))
        self.function = None if function is None else _absolute(function)
        self._loops = None if function is None else load_function(function)
        self.news = News()
        self.worker = Worker(command, self._begun, self._ended, self.news.tell)
        self.refits = Refits(self.worker.context, self.news.tell, self.function)
        self.last: dict[str, Run] = {}  # of each command, since the server started
        self.finished = 0
        self._of = ""  # what the run that goes on reads
        self._noted: Run | None = None
        self._source: Cached[Source | None] = Cached()
        self._loaded: Cached[LoadedData] = Cached()
        self._whole: Cached[Dataset | None] = Cached()
        self._deployed: Cached[dict[str, bool]] = Cached()
        self._project: Cached[Project | None] = Cached()
        self._links: Cached[DrawnLinks | None] = Cached()
        self._shown: tuple[Source, Refit | None, Source] | None = None
        self._reading, self._changed = Lock(), Event()

    @property
    def version(self) -> int:
        """Another number whenever a file of the folder has changed."""
        folder = tuple(self.folder.listed()), self.folder.noted_at()
        return hash((folder, id(self.worker.run), self.going))

    @property
    def going(self) -> bool:
        """Whether a run goes on, or its end is not in the log yet."""
        return self.worker.run is not self._noted

    def action(self, what: str, line: Sequence[str]) -> Action:
        """`loopcal LINE`, with the loops where they are Python code."""
        named = self.function is not None and line[0] in self.with_loops
        return Action(what, (*line, "--mechanism", str(self.function)) if named else tuple(line))

    def read(self, text: str) -> Project:
        """The project that a text states. Its loops are those of the command line, never others."""
        return read_project(self.folder.project, text=text, mechanism=self._loops)

    def start(self, action: Action) -> Run:
        """Run a command in the folder; before a calibration ends, its fit is looked at."""
        self._of = self.read_by(action.words[0])
        run = self.worker.start(action, str(self.folder.path))
        if action.words[0] == "calibrate" and "--out" not in action.words:
            named = dict(pairwise(action.words))
            self._refit(named.get("--method"))
        self.look()
        return run

    def watch(self) -> None:
        """Start a thread that looks for changes in the folder, also by other programs. It fits a
        changed project and notifies the pages."""
        Thread(target=self._watched, daemon=True).start()

    def look(self) -> None:
        """Look at the folder now: something was done there."""
        self._changed.set()

    def _watched(self) -> None:
        seen = None
        while True:
            self._changed.wait(LOOKS_EVERY)
            self._changed.clear()
            with suppress(OSError):  # a file that is being written
                now = self.version
                if now != seen:
                    seen = now
                    try:
                        self._look_ahead()
                    except LoopcalError:
                        pass  # the page says why
                    except Exception:
                        logging.getLogger(__name__).exception("the project cannot be fitted")
                    self.news.tell()

    def _look_ahead(self) -> None:
        """Fit the project as it stands from where its result ended. Before it has changed, that
        loads what the next fit needs."""
        if not self.worker.busy and not self._asked_last():
            self._refit(None)

    def _asked_last(self) -> bool:
        """Whether the project as it stands was fitted last, by whatever method."""
        asked = self.refits.asked
        return asked is not None and asked == self._asked(asked.method)

    def _asked(self, method: str | None) -> Asked:
        return Asked(self.folder.text() or "", self._result_at(), method, self._readings_at())

    def _refit(self, method: str | None) -> None:
        source = self.source()
        if source is None or self.folder.text() is None or source.document.accuracy is None:
            return
        ending = Ending.of(source.document, source.table.poses)
        self.refits.begin(self._asked(method), self.folder.project, ending)

    def refit(self) -> Refit | None:
        """The fit of the project as it stands, from where the last result ended.

        None where that result is of this project, or nothing is known yet.
        """
        refit = self.refits.refit
        if refit is None or not self._asked_last():
            return None
        return refit if self._calibrates or self.stale else None

    def shown(self) -> Source | None:
        """The result, with what the first fit of a changed project found; while such a fit goes
        on, what was shown before it."""
        source, refit = self.source(), self.refit()
        before = self._shown if self._shown is not None and self._shown[0] is source else None
        if source is None:
            return None
        waits = self.refits.going and self.stale
        if before is None or (before[1] is not refit and not waits):
            shown_source = source
            if refit is not None:
                document = refit.shown_in(source.document)
                shown_source = replace(source, table=refit.table, document=document)
            self._shown = before = source, refit, shown_source
        return before[2]

    @property
    def _calibrates(self) -> bool:
        run = self.worker.run
        return self.going and run is not None and run.action.words[0] == "calibrate"

    def _begun(self, action: Action) -> None:
        # Ahead of the run: one that takes the server down then shows as unfinished.
        self.folder.noted("begun", action.what, {"command": action.command})

    def _ended(self, run: Run) -> None:
        self.last[run.action.words[0]] = run
        command = run.action.command
        content = {"command": command, "code": run.code, "cancelled": run.cancelled, "of": self._of}
        if run.action.words[0] == "check" and (answer := checked(run)) is not None:
            content["verdict"] = answer["verdict"]
        self.folder.noted("ended", run.action.what, content)
        self.finished += 1
        # Last: until here `going` holds, and no page shows an end that the log lacks.
        self._noted = run
        self.look()

    def project(self) -> Project | None:
        """The project as it stands; None where there is none or it cannot be read."""
        text: str | None = None
        failed: LoopcalError | None = None
        try:
            text = self.folder.text()
        except LoopcalError as error:
            failed = error

        def read() -> Project | None:
            if failed is not None:
                raise failed
            return None if text is None else self.read(text)

        return self._project.read((text, str(failed)), read)

    def links(self) -> DrawnLinks | None:
        """What the links of the robot look like, where the folder has the meshes of its URDF."""
        project = self.project()
        stated = {} if project is None else project.inputs.get("mechanism") or {}
        file = stated.get("file")
        path = self.folder.project.parent / str(file)
        if not isinstance(file, str) or path.suffix.lower() not in (".urdf", ".xml"):
            return None
        base = stated.get("base", stated.get("root"))
        at = file, base, tuple(self.folder.listed())
        return self._links.read(at, lambda: read_links(path, base))

    def objection(self) -> str | None:
        """Why the project cannot be read; None where it can, or is not there."""
        self.project()
        return self._project.objection or None

    @property
    def ready(self) -> bool:
        """Whether result and readings are known as they stand on the disk. Where they are not,
        `load` takes long for large files."""
        current = self.project() is None or self._loaded.at == self._readings_at()
        return current and self._source.at == self._result_at()

    def load(self) -> None:
        """Read result and readings."""
        # Of two pages at once the second finds what the first has read.
        with self._reading:
            self.source()
            self.readings()

    def source(self) -> Source | None:
        """The result on the disk; None where there is none or it cannot be read."""
        at = self._result_at()
        path = self.folder.result / RESULT
        return self._source.read(at, lambda: None if at is None else read_source(path))

    def unreadable(self) -> str:
        """Why the result on the disk cannot be read; empty where it can, or is not there."""
        self.source()
        return self._source.objection

    def _result_at(self) -> int | None:
        return self._times().get(self.folder.named(self.folder.result / RESULT))

    def _files(self, project: Project) -> tuple[str, ...]:
        """Names in the folder of the files that a project reads, which it states from its own."""
        parts = () if project.data is None else project.data.parts
        paths = (self.folder.project.parent / part.file for part in parts)
        return tuple(Path(os.path.relpath(path, self.folder.path)).as_posix() for path in paths)

    def _times(self) -> dict[str, int]:
        return {file.name: file.modified for file in self.folder.listed()}

    def deployed(self) -> dict[str, bool]:
        """Files for the robot and the record, and whether each is of the result as it stands."""
        now = tuple(self.folder.listed()), self.folder.noted_at()
        return self._deployed.read(now, self.folder.deployed) or {}

    def state(self) -> State:
        """What the lights of the steps follow from."""
        source, project, objection = self.source(), self.project(), self.objection()
        loaded = self.readings()
        runs = {
            str(e.record.get("command", "")).split(" ")[1]: e
            for e in self.folder.log().entries
            if e.kind == "ended" and " " in str(e.record.get("command", ""))
        }
        return State(
            project=project is not None or objection is not None,
            objection=objection,
            document=None if source is None else source.document,
            stale=self.stale,
            deployed=self.deployed(),
            runs=runs,
            outdated=frozenset(c for c, e in runs.items() if self._outdated(c, e)),
            measured=project is None or project.data is not None,
            unread=self.unread() if project is not None else "",
            waiting=self.waiting(),
            warned=tuple(map(str, loaded.warnings)) if loaded is not None else (),
            unreadable=self._source.objection,
            made_elsewhere=frozenset(
                {"plan"} if self.folder.inside_of(self.folder.named(self.folder.plan)) else ()
            ),
        )

    def read_by(self, command: str) -> str:
        """A digest of what a command reads: the project, with its readings unless they are only
        planned, or the result."""
        project, times = self.project(), self._times()
        if command not in ("check", "plan", "calibrate"):
            return str(self._result_at())
        at: Any = None
        if project is not None and command == "plan":
            at = _planned_for(project)
        elif project is not None:
            files = self._files(project)
            at = [_that_count(project.inputs), [times.get(file) for file in files]]
        return sha256(json.dumps(at, sort_keys=True, default=str).encode()).hexdigest()

    def _outdated(self, command: str, entry: Entry) -> bool:
        """Whether a run of the log read something else than there is now."""
        of = entry.record.get("of")
        return of is not None and of != self.read_by(command)

    def outdated(self, command: str) -> bool:
        """Whether the last run of a command read something else than there is now."""
        return command in self.state().outdated

    def waiting(self) -> tuple[str, ...]:
        """Files of readings that were handed in at the step Data, and that the project does not
        read; those that were left aside are not named again."""
        project = self.project()
        if project is None or project.data is None:
            return ()
        # Of some files `loopcal init` makes others, as of corners and boards.
        read = {*self._files(project), *self._recognised()}
        unread = {file.name for file in self.folder.listed()} - read
        names = [name for name in self.folder.handed_in("data") if name in unread]
        return tuple(name for name in names if name.lower().endswith(tuple(READERS)))

    def _recognised(self) -> set[str]:
        """The words of each `loopcal init` that has made a project, among them the files read."""
        lines = [
            str(entry.record.get("command", ""))
            for entry in self.folder.log().entries
            if entry.kind == "ended" and entry.record.get("code") == 0
        ]
        return {word for line in lines if line.startswith(INIT) for word in shlex.split(line)}

    def left_aside(self, name: str) -> None:
        """Do not ask again what becomes of a file of readings."""
        self.folder.noted("aside", f"left {name} aside", {"name": name, "step": ""})

    @property
    def stale(self) -> bool:
        """Whether the result is of another project, or of other readings, than there are now."""
        source, project = self.source(), self.project()
        if source is None or project is None:
            return False
        changed = _that_count(project.inputs) != _that_count(source.document.inputs)
        files = self._files(project)
        times, result = self._times(), self._result_at() or 0
        return changed or any(times.get(file, 0) > result for file in files)

    def robot(self) -> tuple[str | None, str | None]:
        """How the robot of a project to come is described: a kind, and a file or type."""
        for entry in reversed(self.folder.log().entries):
            if entry.kind == "robot":
                return str(entry.record.get("robot")), str(entry.record.get("value"))
        return None, None

    def choose_robot(self, kind: str, value: str) -> None:
        """Describe the robot of a project to come. Raises as `read_robot`."""
        if kind != "machine":
            read_robot(kind, self.folder.inside(value))
        self.folder.noted("robot", f"robot from {value}", {"robot": kind, "value": value})

    def readings(self) -> LoadedData | None:
        """The readings of the project; None where they cannot be read."""
        project = self.project()
        if project is None:
            return None
        return self._loaded.read(self._readings_at(), lambda: load_sample(project))

    def every_pose(self) -> Dataset | None:
        """The readings, those of poses that the project leaves out among them.

        They are read once, however many poses are left out after that.
        """
        project = self.project()
        if project is None or project.data is None or not project.data.exclude:
            loaded = self.readings()
            whole = None if loaded is None else loaded.dataset
        if project is None or project.data is None:
            return whole
        stated = project.inputs.get("data", {})
        kept = {**project.inputs, "data": {k: v for k, v in stated.items() if k != "exclude"}}
        at = json.dumps(_that_count(kept), sort_keys=True, default=str), self._readings_at()[1]
        data = project.data
        if not data.exclude:
            return self._whole.read(at, lambda: whole)
        every = replace(project, data=replace(data, exclude=()))
        return self._whole.read(at, lambda: load_sample(every).dataset)

    def _readings_at(self) -> tuple[str | None, tuple[int | None, ...]]:
        """Another value whenever the readings may have changed."""
        project, times = self.project(), self._times()
        files = () if project is None else self._files(project)
        return self.folder.text(), tuple(times.get(file) for file in files)

    def unread(self) -> str:
        """Why the readings cannot be read; empty where they can."""
        self.readings()
        return self._loaded.objection

    def changed(self, keys: list[str], value: object, reason: str) -> None:
        """Change one value of the project."""
        text = self.folder.text() or ""
        what = f"{'.'.join(keys)} = {value}" if value is not None else f"removed {'.'.join(keys)}"
        self._write(with_value(text, keys, value), what, reason)

    def excluded(self, poses: Sequence[str], reason: str) -> None:
        """Leave poses out. Raises InputError where none would be left."""
        loaded = self.readings()
        if loaded is not None and set(loaded.dataset.poses) <= set(poses):
            raise _all_selected()
        text = without_poses(self.folder.text() or "", poses)
        shown = ", ".join(poses[:8]) + (f" and {len(poses) - 8} more" if len(poses) > 8 else "")
        self._write(text, f"left out {shown}", reason)

    def moved(self) -> dict[str, tuple[str, ...]]:
        """What can have moved during a run, and its parameters."""
        project = self.project()
        if project is None:
            return {}
        machine = project.mechanism
        names = [machine.parameters.of_role("mounting"), machine.parameters.of_role("placement")]
        images = any(one.image for one in seen_outputs(machine))
        return {w: moving for w, moving in zip(words.MOVING[images], names, strict=True) if moving}

    def steps(self) -> list[float]:
        """Numbers of the poses from which on the project takes something as moved."""
        project = self.project()
        mechanism = {} if project is None else project.inputs.get("mechanism", {})
        effects = mechanism.get("effect", []) if isinstance(mechanism, dict) else []
        return sorted({float(at) for effect in effects for at in effect.get("at", ())})

    def left_out(self) -> tuple[str, ...]:
        """Ids of the poses that the project leaves out."""
        project = self.project()
        data = None if project is None else project.data
        return () if data is None else tuple(map(str, data.exclude))

    def shifted(self, names: Sequence[str], run: Sequence[str], reason: str) -> None:
        """Take parameters as others from the first to the last pose of a run.

        Poses that were left out since the result do not count.
        """
        data = self._numbered(names)
        run_poses = set(run)
        positions = [i for i, pose in enumerate(data.poses) if pose in run_poses]
        if len(positions) == len(data.poses):
            raise _all_selected()
        if not positions:
            raise InputError(
                "no pose of the selection is in use",
                code="invalid-value",
                remedy="select a part of the run",
            )
        ends = [*positions[:1], positions[-1] + 1]
        # A run at the beginning or the end of the data has one border.
        at = [float(data[COLUMN][i]) for i in ends if 0 < i < len(data.poses)]
        text = with_shift(self._counted(), names, at, COLUMN)
        first, last = data.poses[positions[0]], data.poses[positions[-1]]
        self._write(text, f"{', '.join(names)} moved from pose {first} to {last}", reason)

    def modelled(self, changes: ChangePoints, reason: str) -> None:
        """Put the changes along the run that a finding names into the project."""
        source = self.source()
        starts = begins(changes.found, () if source is None else source.table.poses)
        at = {
            names: [number for number, p in starts.items() if p.changing == names]
            for names in (p.changing for p in changes.found)
        }
        change_words = "; ".join(point.what for point in changes.found)
        text = with_changes(self._counted(), changes.toml, at)
        self._write(text, f"accepted: {change_words}", reason)

    def _counted(self) -> str:
        """The text with a column of numbers of poses."""
        text, project, loaded = self.folder.text() or "", self.project(), self.readings()
        if project is None or loaded is None:
            raise InputError(self.unread(), code="no-data", remedy="correct the readings first")
        if COLUMN in project.mechanism.pose_constants:
            return text
        ids = project.inputs.get("data", {}).get("pose", 0)
        column = ids if ids_are_numbers(loaded.dataset.poses) else 0
        return with_value(text, ["data", "columns", COLUMN], {"column": column, "unit": "1"})

    def _numbered(self, names: Sequence[str]) -> Dataset:
        """The readings, with the numbers of the poses as the project would read them."""
        # A trial shift makes the project read the column of numbers.
        text = with_shift(self._counted(), names, [0.0], COLUMN)
        return load_sample(self.read(text)).dataset

    def _write(self, text: str, what: str, reason: str) -> None:
        self.read(text)  # raises where it would not be read
        self.folder.change(text, what, reason)
        self._look_ahead()


def read_robot(kind: str, path: Path) -> None:
    """Raises InputError for a file that describes no robot of its kind."""
    if kind == "dh":
        read_dh(path)
    elif not branches(path):
        raise InputError(
            "no joint of this robot moves", code="no-data", place=path.name, remedy=NO_URDF
        )


def _all_selected() -> InputError:
    return InputError(
        "all poses are selected", code="invalid-value", remedy="select a part of the run"
    )


def _that_count(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """What a calibration follows from."""
    return {key: value for key, value in inputs.items() if key not in ("record", "title", "plan")}


def _planned_for(project: Project) -> list[Any]:
    """What a plan follows from: the machine, what sees it, and where. Readings of the plan itself
    change neither; they may change guesses of how the target sits and how uncertain it is read."""
    machine = project.mechanism
    drawn = {p.name: p.nominal for p in machine.parameters if p.role in GEOMETRY}
    verdict = project.inputs.get("verdict") or {}
    return [machine.quantities, drawn, project.inputs.get("plan"), verdict.get("region")]


def _absolute(function: str) -> str:
    """FILE.py:NAME for a command that runs in another folder."""
    file, colon, name = function.rpartition(":")
    return f"{Path(file).absolute()}{colon}{name}"
