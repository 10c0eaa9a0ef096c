"""Bad input ends with code 3 (or 2), one message with place and remedy, and nothing changed."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests import command_line
from tests.cli.conftest import Run, contents

CALIBRATE = ["calibrate", "project.toml"]


def edit(file: str, old: str, new: str) -> Callable[[Path], None]:
    """Replace some text in a file; it must be there."""

    def change(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return change


def project(old: str, new: str) -> Callable[[Path], None]:
    return edit("project.toml", old, new)


def write(file: str, content: str | bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        data = content.encode() if isinstance(content, str) else content
        (folder / file).write_bytes(data)

    return change


def remove(file: str) -> Callable[[Path], None]:
    return lambda folder: (folder / file).unlink()


def make_folder(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        (folder / name).mkdir()

    return change


def cell(row: int, column: int, text: str) -> Callable[[Path], None]:
    """Replace a cell of the readings; rows and columns count from 0, the header is row 0."""

    def change(folder: Path) -> None:
        rows = [line.split(",") for line in (folder / "readings.csv").read_text().splitlines()]
        rows[row][column] = text
        (folder / "readings.csv").write_text("\n".join(map(",".join, rows)) + "\n")

    return change


def every_cell(column: int, text: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        rows = [line.split(",") for line in (folder / "readings.csv").read_text().splitlines()]
        for row in rows[1:]:
            row[column] = text
        (folder / "readings.csv").write_text("\n".join(map(",".join, rows)) + "\n")

    return change


def long_line(folder: Path) -> None:
    """200 MB in one line, of which all but the first 3 MB is a hole that takes no space."""
    with (folder / "readings.csv").open("wb") as file:
        file.write(b"pose,x,y,a,b\n" + b"1" * 3_000_000)
        file.truncate(200_000_000)


def renamed_readings(name: str, content: bytes) -> Callable[[Path], None]:
    """Readings in another file than the project's CSV."""

    def change(folder: Path) -> None:
        (folder / name).write_bytes(content)
        project('"readings.csv"', f'"{name}"')(folder)

    return change


def nothing(folder: Path) -> None:
    """The arguments alone are wrong."""


BAD: dict[str, tuple[Callable[[Path], None], list[str], int, list[str]]] = {
    # name: (what is changed, arguments, exit code, what the message says)
    "missing project": (remove("project.toml"), CALIBRATE, 3, ["project.toml", "no such file"]),
    "mistyped project": (
        nothing,
        ["calibrate", "projekt.toml"],
        3,
        ["projekt.toml", "did you mean 'project.toml'"],
    ),
    "project is a folder": (nothing, ["calibrate", "."], 3, ["folder"]),
    "empty project": (write("project.toml", ""), CALIBRATE, 3, ["project.toml", "schema"]),
    "no TOML": (write("project.toml", "schema = 1\n[data\n"), CALIBRATE, 3, ["line 2"]),
    "NUL in the project": (write("project.toml", b"schema = 1\n\0\n"), CALIBRATE, 3, ["line 2"]),
    "not UTF-8": (
        write("project.toml", b"schema = 1\ntitle = '\xb5'\n"),
        CALIBRATE,
        3,
        ["line 2", "UTF-8"],
    ),
    "wrong schema": (project("schema = 1", "schema = 2"), CALIBRATE, 3, ["schema is 2"]),
    "no schema": (project("schema = 1", ""), CALIBRATE, 3, ["schema"]),
    "unknown key": (
        project("[data.columns]", "[data.collumns]"),
        CALIBRATE,
        3,
        ["collumns", "did you mean 'columns'"],
    ),
    "unknown table": (
        project("[noise]", "[nois]"),
        CALIBRATE,
        3,
        ["nois", "did you mean 'noise'"],
    ),
    "no mechanism": (
        project('[mechanism]\ntype = "planar-two-link"\n', ""),
        CALIBRATE,
        3,
        ["project.toml", "mechanism"],
    ),
    "unknown mechanism": (
        project('"planar-two-link"', '"planar-two-links"'),
        CALIBRATE,
        3,
        ["mechanism", "did you mean 'planar-two-link'"],
    ),
    "missing mechanism file": (
        project('type = "planar-two-link"', 'file = "arm.toml"'),
        CALIBRATE,
        3,
        ["arm.toml", "no such file"],
    ),
    "no data": (
        lambda folder: write(
            "project.toml",
            (folder / "project.toml").read_text().split("[data]")[0],
        )(folder),
        CALIBRATE,
        3,
        ["project.toml", "[data]"],
    ),
    "no variable": (
        project('"readings.csv"', '"${NO_SUCH_FOLDER}/readings.csv"'),
        CALIBRATE,
        3,
        ["data.file", "NO_SUCH_FOLDER"],
    ),
    "missing readings": (
        remove("readings.csv"),
        CALIBRATE,
        3,
        ["readings.csv", "there is no file"],
    ),
    "readings are a folder": (make_folder("readings.csv"), CALIBRATE, 3, ["folder"]),
    "empty readings": (write("readings.csv", ""), CALIBRATE, 3, ["readings.csv", "empty"]),
    "header only": (write("readings.csv", "pose,x,y,a,b\n"), CALIBRATE, 3, ["readings.csv"]),
    "wrong delimiter": (
        project('pose = "pose"', 'pose = "pose"\ndelimiter = ";"'),
        CALIBRATE,
        3,
        ["readings.csv"],
    ),
    "unknown column": (
        project('column = "x"', 'column = "xx"'),
        CALIBRATE,
        3,
        ["readings.csv", "'xx'"],
    ),
    "one column twice": (project('column = "y"', 'column = "x"'), CALIBRATE, 3, ["'x'"]),
    "text in a number": (cell(7, 2, "lost"), CALIBRATE, 3, ["row 8", "'y'", "lost"]),
    "infinite reading": (cell(7, 2, "inf"), CALIBRATE, 3, ["row 8", "'y'"]),
    "row too long": (cell(9, 4, "1.0,2.0"), CALIBRATE, 3, ["row 10"]),
    "unknown unit": (project('unit = "mm"', 'unit = "mmm"'), CALIBRATE, 3, ["'mmm'", "xP"]),
    "unit that does not fit": (project('unit = "mm"', 'unit = "deg"'), CALIBRATE, 3, ["xP"]),
    "degrees declared rad": (
        project('"a", unit = "deg"', '"a", unit = "rad"'),
        CALIBRATE,
        3,
        ["'a'", "degrees"],
    ),
    "all readings missing": (every_cell(3, ""), CALIBRATE, 3, ["'a'", "no reading"]),
    "NUL in the readings": (cell(4, 1, "1\0"), CALIBRATE, 3, ["row 5", "NUL"]),
    "a line of 200 MB": (long_line, CALIBRATE, 3, ["row 2", "longer"]),
    "a picture": (write("readings.csv", b"\x89PNG\r\n\x1a\n" * 9), CALIBRATE, 3, ["PNG"]),
    "broken workbook": (
        renamed_readings("readings.xlsx", b"PK\x03\x04 broken"),
        CALIBRATE,
        3,
        ["readings.xlsx"],
    ),
    "broken Parquet": (
        renamed_readings("readings.parquet", b"PAR1 broken"),
        CALIBRATE,
        3,
        ["readings.parquet"],
    ),
    "negative sd": (project("sd = 0.1", "sd = -0.1"), CALIBRATE, 3, ["noise", "-0.1"]),
    "sd is NaN": (project("sd = 0.1", "sd = nan"), CALIBRATE, 3, ["noise", "nan"]),
    "sd is text": (project("sd = 0.1", 'sd = "0,1"'), CALIBRATE, 3, ["noise", "0,1"]),
    "no sd": (project('"phi?"', '"phi2"'), CALIBRATE, 3, ["project.toml", "'phi3'"]),
    "noise of nothing": (project('"phi?"', '"psi?"'), CALIBRATE, 3, ["psi?"]),
    "nothing uncertain": (
        project(
            '"?P" = { sd = 0.1, unit = "mm" }\n"phi?" = { sd = 1', '"*" = 0\n"phi?" = { sd = 0'
        ),
        CALIBRATE,
        3,
        ["project.toml", "cannot close"],
    ),
    "prior of nothing": (project('"*" = { sd = inf }', '"l9" = 1.0'), CALIBRATE, 3, ["l9"]),
    "negative prior": (project("sd = inf", "sd = -1"), CALIBRATE, 3, ["prior", "-1"]),
    "NaN in a parameter": (
        project("[prior]", "[parameters]\nl2 = nan\n[prior]"),
        CALIBRATE,
        3,
        ["parameters.l2"],
    ),
    "unknown parameter": (
        project("[prior]", "[parameters]\nl4 = 1.0\n[prior]"),
        CALIBRATE,
        3,
        ["parameters.l4", "'l2'"],
    ),
    "nothing to estimate": (
        project("[prior]", '[parameters]\n"*" = { fixed = true }\n[prior]'),
        CALIBRATE,
        3,
        ["every parameter is fixed"],
    ),
    "too few poses": (
        project('pose = "pose"', "every = 40"),
        CALIBRATE,
        3,
        ["4 loop equations (2 poses)"],
    ),
    "thinning by nothing": (project('pose = "pose"', "every = 0"), CALIBRATE, 3, ["data.every"]),
    "no such pose": (
        project('pose = "pose"', 'pose = "pose"\nexclude = [99]'),
        CALIBRATE,
        3,
        ["readings.csv", "'99'"],
    ),
    "unknown method in the project": (
        project("implicit-loop", "implicit-lop"),
        CALIBRATE,
        3,
        ["fit.method", "did you mean 'implicit-loop'"],
    ),
    "unknown method": (
        nothing,
        [*CALIBRATE, "--method", "least-square"],
        2,
        ["did you mean 'least-squares'"],
    ),
    "unknown option": (nothing, [*CALIBRATE, "--metod", "x"], 2, ["--method"]),
    "unknown command": (nothing, ["calibrat", "project.toml"], 2, ["calibrate"]),
    "missing argument": (nothing, ["calibrate"], 2, ["PROJECT"]),
    "missing truth": (nothing, [*CALIBRATE, "--truth", "t.json"], 3, ["t.json", "no such file"]),
    "truth is no JSON": (
        write("t.json", '{"schema": 1,\n "parameters": }'),
        [*CALIBRATE, "--truth", "t.json"],
        3,
        ["t.json, line 2"],
    ),
    "truth is a list": (write("t.json", "[1]"), [*CALIBRATE, "--truth", "t.json"], 3, ["t.json"]),
    "truth of another machine": (
        write("t.json", json.dumps({"schema": 1, "parameters": {"l4": 1.0}})),
        [*CALIBRATE, "--truth", "t.json"],
        3,
        ["t.json: parameters", "'l4'"],
    ),
    "truth holds NaN": (
        write("t.json", '{"schema": 1, "parameters": {"l2": NaN}}'),
        [*CALIBRATE, "--truth", "t.json"],
        3,
        ["t.json", "NaN"],
    ),
    "truth in another unit": (
        write("t.json", '{"schema": 1, "parameters": {"l2": {"value": 1, "unit": "deg"}}}'),
        [*CALIBRATE, "--truth", "t.json"],
        3,
        ["t.json: parameters.l2", "deg"],
    ),
    "out is a file": (nothing, [*CALIBRATE, "--out", "readings.csv"], 3, ["readings.csv", "file"]),
    "a folder is there": (
        lambda folder: (folder / "o" / "residuals.csv").mkdir(parents=True),
        [*CALIBRATE, "--out", "o"],
        3,
        ["residuals.csv", "folder"],
    ),
    "function for a machine without one": (
        write("f.py", "def loops(x, p):\n    return [x.xP]\n"),
        [*CALIBRATE, "--mechanism", "f.py:loops"],
        3,
        ["project.toml", "function"],
    ),
    "function that is not named": (nothing, [*CALIBRATE, "--mechanism", "f.py"], 3, ["FILE.py"]),
    "no such function": (
        write("f.py", "def loop(x, p):\n    return [x.xP]\n"),
        [*CALIBRATE, "--mechanism", "f.py:loops"],
        3,
        ["f.py", "did you mean 'loop'"],
    ),
    "syntax error": (
        write("f.py", "import math\ndef loops(x, p)\n"),
        [*CALIBRATE, "--mechanism", "f.py:loops"],
        3,
        ["f.py, line 2", "SyntaxError"],
    ),
    "nothing to simulate": (
        lambda folder: write(
            "project.toml",
            (folder / "project.toml").read_text().split("[simulation")[0],
        )(folder),
        ["simulate", "project.toml", "--out", "readings.csv"],
        3,
        ["project.toml", "[simulation"],
    ),
    "unknown ending": (
        nothing,
        ["simulate", "project.toml", "--out", "readings.xls"],
        3,
        ["readings.xls", ".csv"],
    ),
    "a folder where the truth belongs": (
        make_folder("readings.truth.json"),
        ["simulate", "project.toml", "--out", "readings.csv", "--seed", "5"],
        3,
        ["readings.truth.json", "folder"],
    ),
    "negative seed": (
        nothing,
        ["simulate", "project.toml", "--out", "readings.csv", "--seed", "-1"],
        2,
        ["--seed"],
    ),
    "a project is there already": (nothing, ["new", ".", "--mechanism", "serial"], 3, ["project"]),
    "unknown kind of project": (
        nothing,
        ["new", "arm", "--mechanism", "seriel"],
        2,
        ["did you mean 'serial'"],
    ),
    "unknown schema": (nothing, ["schema", "reslt"], 2, ["did you mean 'result'"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told_and_changes_nothing(name: str, folder: Path, run: Run) -> None:
    change, arguments, code, told = BAD[name]
    change(folder)
    before = {} if name == "a line of 200 MB" else contents(folder)
    done = run(*arguments)
    assert done.code == code, done.err
    for words in told:
        assert words in done.err
    assert done.out == ""
    assert "Traceback" not in done.err
    if code == 3:
        first, remedy, head, command = done.err.strip().splitlines()
        assert first.startswith("loopcal: ")
        assert remedy.startswith("  What to do: ")
        assert head in ("  Next command:", "  Then run:")
        assert command.startswith(("    loopcal ", "    pip install "))
    if before:
        assert contents(folder) == before
    earlier = (folder / "project-result" / "result.json").read_bytes()
    assert json.loads(earlier)["status"]["converged"]


def test_a_line_of_200_megabytes_costs_neither_time_nor_memory(folder: Path, run: Run) -> None:
    import tracemalloc

    long_line(folder)
    tracemalloc.start()
    assert run(*CALIBRATE).code == 3
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30e6


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_disk_that_fails_while_writing_leaves_the_earlier_result(
    number: int, folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    real, calls = os.fsync, []

    def failing(handle: int) -> None:
        calls.append(handle)
        if len(calls) == 2:
            raise OSError(number, os.strerror(number))
        real(handle)

    monkeypatch.setattr(os, "fsync", failing)
    done = run(*CALIBRATE)
    assert done.code == 3
    assert "residuals.csv" in done.err
    assert "What to do" in done.err
    assert contents(folder) == before


def test_a_folder_that_may_not_be_written_to(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    real: Callable[..., Any] = Path.open

    def refusing(path: Path, mode: str = "r", *more: Any, **options: Any) -> Any:
        if "x" in mode:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return real(path, mode, *more, **options)

    monkeypatch.setattr(Path, "open", refusing)
    done = run(*CALIBRATE)
    assert done.code == 3
    assert "no permission to write here" in done.err
    assert contents(folder) == before


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are of Unix")
def test_a_real_limit_on_file_sizes_is_told_as_a_full_disk(folder: Path) -> None:
    import resource
    import subprocess

    before = contents(folder)
    done = subprocess.run(
        [sys.executable, "-m", "loopcal", *CALIBRATE],
        env=command_line.environment(),
        capture_output=True,
        encoding="utf-8",
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )
    assert done.returncode == 3
    assert "the disk is full" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert contents(folder) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_stdout_on_a_full_disk_is_told(folder: Path) -> None:
    import subprocess

    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "loopcal", *CALIBRATE, "--json"],
            env=command_line.environment(),
            stdout=full,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            check=False,
        )
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert "standard output" in done.stderr
    assert (folder / "project-result" / "result.json").is_file()


def test_an_unreadable_folder_for_real(folder: Path, run: Run) -> None:
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    locked = folder / "locked"
    locked.mkdir(mode=0o500)
    done = run(*CALIBRATE, "--out", "locked")
    assert done.code == 3
    assert "no permission to write here" in done.err
    assert list(locked.iterdir()) == []


@pytest.mark.parametrize("folder", [".", "/"])
def test_a_folder_without_name_or_result_is_no_fault(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = run("report", folder)
    assert said.code == 3
    assert "no result in this folder" in said.err
