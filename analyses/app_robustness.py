"""Does the app lose nothing when it is killed, and does its memory stay flat?

    python -m analyses.app_robustness [--kills 30] [--refits 500]

A user edits and calibrates without a pause while server, run or warm process is killed at random
moments. Then everything that was confirmed must be there, files must be whole, nothing may go on
unseen, an unfinished run must be named, and the work must go on. Memory is that of the server, of
its warm process and of the process of first fits, over many refits.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from loopcal.cli.run import main as command
from loopcal.companions.app.session import Session
from loopcal.files.project.project_file import read_project
from loopcal.report.source import read_source

LONGEST = 60.0
"""Seconds that a killed process may linger."""


def made(folder: Path) -> Path:
    """A small planar arm with simulated readings."""
    project = folder / "project.toml"
    assert command(["new", str(folder), "--mechanism", "planar-two-link"]) == 0
    text = project.read_text("utf-8").replace("step = 10", "step = 30")
    project.write_text(text.replace('"auto" ', '"implicit-loop" '), "utf-8")
    command(["simulate", str(project), "--out", str(folder / "poses.csv"), "--seed", "1"])
    return folder


def say(*words: object) -> None:
    """To whoever started this process."""
    print(*words, flush=True)


def finished(session: Session) -> int:
    """The exit code of the run that goes on."""
    run = session.worker.run
    assert run is not None
    while session.going:
        time.sleep(0.005)
    assert run.code is not None
    return run.code


def calibrate(session: Session) -> None:
    """Begin a calibration."""
    session.start(session.action("Calibrate", ("calibrate", "project.toml")))


def work(folder: Path) -> None:
    """Leave poses out one by one, with a calibration after each; say what is confirmed."""
    session = Session(folder, command)
    for pose in range(1, 30):
        session.excluded([str(pose)], "test")
        say("edited", pose)
        calibrate(session)
        process = session.worker._process
        say("begun", 0 if process is None else process.pid)
        say("ran", finished(session))


@dataclass
class Found:
    """What stood in the folder after a kill; wrong: what must not be."""

    target: str
    edited: int = 0
    ran: int = 0
    unfinished: bool = False
    wrong: list[str] = field(default_factory=list)


def excluded(folder: Path) -> list[str]:
    """Poses that the project leaves out."""
    return list(read_project(folder / "project.toml").inputs["data"].get("exclude", []))


def killed(folder: Path, seed: int) -> Found:
    """Kill the server or the run at a random moment, look, and go on."""
    rng = np.random.default_rng(seed)
    target = ("server", "run")[seed % 2]
    lines = _until_killed(folder, target, float(rng.uniform(0.5, 6.0)))
    found = Found(target)
    found.edited = max((int(n) for word, n in lines if word == "edited"), default=0)
    found.ran = sum(word == "ran" and n == "0" for word, n in lines)
    pid = max((int(n) for word, n in lines if word == "begun"), default=0)
    if pid and not _gone(pid):
        found.wrong.append("a run goes on without its server")
    session = Session(folder, command)
    out, log = excluded(folder), session.folder.log()
    found.unfinished = log.unfinished() is not None
    if not found.edited <= len(out) <= found.edited + 1:
        found.wrong.append(f"{found.edited} edits confirmed, {len(out)} in the project")
    if len(log.edits()) not in (len(out), len(out) + 1):
        found.wrong.append(f"{len(out)} edits in the project, {len(log.edits())} in the log")
    if (folder / "project-result").exists():
        source = read_source(folder / "project-result")
        if len(source.document.inputs["data"].get("exclude", [])) < found.ran:
            found.wrong.append("a result that was confirmed is lost")
    elif found.ran:
        found.wrong.append("no result")
    calibrate(session)
    if finished(session) != 0:
        found.wrong.append(f"the work does not go on: {session.last['calibrate'].text}")
    return found


def _until_killed(folder: Path, target: str, seconds: float) -> list[tuple[str, str]]:
    """What the worker of `work` said; where its run is killed, also what it said afterwards."""
    line = [sys.executable, "-m", "analyses.app_robustness", "--work", str(folder)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, encoding="utf-8") as process:
        assert process.stdout is not None
        said = [process.stdout.readline()]
        limit = time.monotonic() + seconds
        while time.monotonic() < limit and process.poll() is None:
            said.append(process.stdout.readline())
        if target == "run":
            begun = [text for text in said if text.startswith("begun")]
            if begun:
                _kill(int(begun[-1].split()[1]))
            said += [process.stdout.readline() for _ in range(6)]
        process.kill()
        said += process.stdout.read().splitlines()
    return [(word, n) for word, _, n in (text.strip().partition(" ") for text in said) if n]


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def _gone(pid: int) -> bool:
    limit = time.monotonic() + LONGEST
    while time.monotonic() < limit:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def memory(folder: Path, refits: int) -> None:
    """Print refits, and MB of this process and of the warm one, from time to time."""
    from multiprocessing import forkserver

    session = Session(folder, command)
    warm: int = getattr(forkserver, "_forkserver")._forkserver_pid  # noqa: B009
    for count in range(refits + 1):
        calibrate(session)
        assert finished(session) == 0
        session.state()
        if count % max(refits // 10, 1) == 0:
            fits = session.refits.process
            known = {"server": os.getpid(), "warm process": warm}
            known |= {} if fits is None else {"first fits": fits.pid}
            found = ", ".join(f"{name} {resident(pid)} MB" for name, pid in known.items())
            say(f"{count} refits: {found}")


def resident(pid: int) -> float:
    """Memory of a process that no other shares [MB]."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text("ascii")
    kilobytes = [int(r.split()[1]) for r in text.splitlines() if r.startswith("Private")]
    return round(sum(kilobytes) / 1e3, 1)


def main() -> None:
    """Print a row for each kill, and the memory."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--refits", type=int, default=500)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    if asked.work is not None:
        work(asked.work)
        return
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(asked.kills):
            found = killed(made(Path(folder) / f"k{seed}"), seed)
            done = f"{found.edited} edits, {found.ran} runs"
            say(f"kill {seed} of the {found.target}: {done}: {end(found)}")
        if asked.refits:
            memory(made(Path(folder) / "m"), asked.refits)


def end(found: Found) -> str:
    """In words."""
    named = "an unfinished run is named" if found.unfinished else "no run was going on"
    return "; ".join(found.wrong) or named


if __name__ == "__main__":
    main()
