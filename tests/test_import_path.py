"""No process that loopcal starts runs a module of the working directory.

The folder has a module for every name of the standard library, and for what loopcal depends on;
each leaves a file beside itself when it is run, and fails.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
import xlsxwriter

import loopcal
from loopcal.import_path import without_folder
from tests.command_line import environment

OTHERS = (
    "numpy scipy polars pydantic typer jinja2 lxml plotly threadpoolctl tomli_w loopcal nicegui"
)
RAN = "ran-"
POISON = """
import pathlib
pathlib.Path(__file__).with_name("ran-" + pathlib.Path(__file__).stem).touch()
raise ImportError("a module of the working directory")
"""
BEFORE_US = {"loopcal", "importlib", "pkgutil", "types", "functools", "collections", "keyword"}
BEFORE_US |= {"operator", "reprlib", "warnings", "weakref", "copyreg", "re", "enum", "contextlib"}
"""What Python itself imports for `python -m loopcal`, before a line of loopcal is read."""
ENTRY = "import sys\nfrom loopcal.cli import main\nsys.exit(main())\n"
"""The script that an installation makes for the command."""
POOL = """
from loopcal.execution.executor import gathered
from loopcal.execution.local import Processes
if __name__ == "__main__":
    print(gathered(Processes(2), pow, 2, range(4)))
"""
WORKER = """
import sys, threading
from pathlib import Path
from loopcal.companions.app.worker import Action
from loopcal.companions.app.worker import Worker
from loopcal.import_path import leave_folder
from loopcal.cli import run
if __name__ == "__main__":
    leave_folder()
    over = threading.Event()
    worker = Worker(run.main, lambda action: None, lambda run: over.set())
    started = worker.start(Action("do", ("new", "made", "--mechanism", "planar-two-link")), ".")
    over.wait(300)
    print(started.code, started.text)
    sys.exit(started.code)
"""


@pytest.fixture
def poisoned(tmp_path: Path) -> Path:
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in (*sys.stdlib_module_names, "sitecustomize", "usercustomize", *OTHERS.split()):
        (folder / f"{name}.py").write_text(POISON)
    return folder


def run_in(folder: Path, *line: str | Path) -> str:
    """What Python prints for a line, in the folder; nothing of the folder has run."""
    words = [sys.executable, *map(str, line)]
    done = subprocess.run(
        words, cwd=folder, env=environment(), capture_output=True, encoding="utf-8", check=False
    )
    assert [path.name for path in folder.glob(f"{RAN}*")] == [], done.stderr
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_no_command_runs_a_module_of_the_folder(poisoned: Path, tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    entry = tmp_path / "bin" / "command"
    entry.write_text(ENTRY)
    run_in(poisoned, entry, "new", "arm", "--mechanism", "planar-two-link")
    run_in(poisoned, entry, "simulate", "arm/project.toml", "--out", "arm/poses.csv", "--seed", "1")
    run_in(poisoned, entry, "check", "arm/project.toml")
    with xlsxwriter.Workbook(poisoned / "poses.xlsx") as book:
        sheet = book.add_worksheet()
        for row, cells in enumerate([["a", "b"], [1.0, 2.0], [1.1, 2.1], [0.9, 2.2]]):
            sheet.write_row(row, 0, cells)
    run_in(poisoned, entry, "noise", "poses.xlsx")  # read in a child of its own


def test_a_function_of_the_users_imports_what_is_installed(poisoned: Path, tmp_path: Path) -> None:
    """Whatever was not loaded before it; another module of its folder stays importable."""
    (tmp_path / "bin").mkdir()
    entry = tmp_path / "bin" / "command"
    entry.write_text(ENTRY)
    run_in(poisoned, entry, "new", "arm", "--mechanism", "function")
    (poisoned / "beside.py").write_text("import fractions\n")
    loops = (poisoned / "arm" / "loops.py").read_text()
    (poisoned / "loops.py").write_text(f"import wave, scipy.odr, beside\n{loops}")
    named = ("--mechanism", "loops.py:loops")
    run_in(poisoned, entry, "simulate", "arm/project.toml", "--out", "poses.csv", *named)


def test_python_m_loopcal_runs_none_that_python_does_not(poisoned: Path) -> None:
    for name in BEFORE_US:
        (poisoned / f"{name}.py").unlink(missing_ok=True)
    run_in(poisoned, "-m", "loopcal", "new", "arm", "--mechanism", "planar-two-link")


@pytest.mark.parametrize("script", [POOL, WORKER], ids=["pool", "worker of the app"])
def test_no_pool_and_no_run_of_the_app_runs_a_module_of_the_folder(
    poisoned: Path, tmp_path: Path, script: str
) -> None:
    (tmp_path / "script").mkdir()
    path = tmp_path / "script" / "begun.py"
    path.write_text(script)
    run_in(poisoned, path)


def test_the_working_directory_is_dropped_under_every_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    names = ["", ".", "../here", str(tmp_path / "here"), str(tmp_path / "link")]
    assert without_folder([*names, "/usr/lib", os.fspath(tmp_path)]) == ["/usr/lib", str(tmp_path)]


def test_processes_are_started_by_modules_that_this_file_knows() -> None:
    package = Path(loopcal.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if {"subprocess", "multiprocessing"} & {name.partition(".")[0] for name in names}:
                found.add(path.relative_to(package).as_posix())
    known = {"files/guarded.py", "execution/local.py", "companions/app/worker.py"}
    known.add("companions/app/refits.py")
    assert found == known
