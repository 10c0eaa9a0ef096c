"""A hostile table of readings is refused by name, with a remedy; it costs neither much nor long."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from loopcal import InputError, read_dataset
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import read_program
from loopcal.files.recognition.sources import sources_of
from loopcal.files.tables import raw
from tests.command_line import run, run_here
from tests.files.hostile import generated
from tests.refusals import refused

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="memory is measured on Linux")
MOST_MEMORY = 900_000  # KiB that the whole command and its child may take


def refusal(path: Path) -> InputError | None:
    """How a file is refused; None where it is read."""
    try:
        read_dataset(path)
    except InputError as error:
        return error
    return None


def is_whole(error: InputError, path: Path) -> bool:
    """Whether a message names the file and what to do, in a few lines."""
    return path.name in str(error) and bool(error.remedy) and len(str(error)) < 1_000


@pytest.mark.parametrize("ending", generated.HONEST)
def test_the_honest_file_behind_them_is_read(ending: str, tmp_path: Path) -> None:
    read = read_dataset(generated.written(tmp_path, ending, generated.HONEST[ending]()))
    for name, values in generated.columns().items():
        np.testing.assert_allclose(read[name], values, rtol=1e-15)


@pytest.mark.parametrize(("ending", "content"), generated.REFUSED.values(), ids=generated.REFUSED)
def test_a_hostile_file_is_refused_by_name(ending, content, tmp_path: Path) -> None:
    path = generated.written(tmp_path, ending, content())
    error = refusal(path)
    assert error is not None
    assert is_whole(error, path)


@pytest.mark.parametrize(("ending", "content"), generated.HARMLESS.values(), ids=generated.HARMLESS)
def test_what_only_looks_hostile_is_read(ending, content, tmp_path: Path) -> None:
    assert len(read_dataset(generated.written(tmp_path, ending, content()))) == generated.ROWS


@pytest.mark.parametrize("ending", [".xlsx", ".parquet", ".mat"])
def test_a_damaged_file_is_read_or_refused_and_nothing_else(ending: str, tmp_path: Path) -> None:
    for content in generated.damaged(generated.HONEST[ending](), 60, seed=len(ending)):
        path = generated.written(tmp_path, ending, content)
        error = refusal(path)
        assert error is None or is_whole(error, path)


@LINUX
@pytest.mark.parametrize("fault", ["a zip bomb", "a zlib bomb", "a cell far beyond its sheet"])
def test_a_bomb_is_refused_before_memory_is_taken(fault: str, tmp_path: Path) -> None:
    ending, content = generated.REFUSED[fault]
    path = generated.written(tmp_path, ending, content())
    script = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run([sys.executable, '-m', 'loopcal', 'noise', sys.argv[1]])\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
        "sys.exit(done.returncode)"
    )

    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 3, done.stderr
    assert int(done.stdout) < MOST_MEMORY


def test_a_crash_of_a_reader_shows_no_stack_trace(tmp_path: Path) -> None:
    path = generated.written(
        tmp_path, ".xlsx", generated.REFUSED["a malformed cell reference"][1]()
    )
    done = run("noise", path)
    assert done.returncode == 3
    assert "panick" not in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there is no /dev/zero here")
@pytest.mark.parametrize("command", ["noise", "calibrate", "study"])
def test_a_device_is_refused_at_once(command: str) -> None:
    done = run_here(command, "/dev/zero")
    assert done.returncode == 3
    assert "/dev/zero: this is a device" in done.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_that_stays_silent_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw, "PATIENCE", 0.1)
    os.mkfifo(tmp_path / "pipe.csv")
    with refused("unreadable-file"):
        read_dataset(tmp_path / "pipe.csv")
    with refused("unreadable-file"):
        read_program(tmp_path / "pipe.csv", JointAxes({"q": "rad"}))


@pytest.mark.parametrize("fault", ["a cell far beyond its sheet", "a malformed cell reference"])
def test_a_workbook_of_which_no_sheet_can_be_read_is_refused_once(
    fault: str, tmp_path: Path
) -> None:
    ending, content = generated.REFUSED[fault]
    path = generated.written(tmp_path, ending, content())
    with pytest.raises(InputError) as caught:
        sources_of(path, 1)
    assert is_whole(caught.value, path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_that_a_program_writes_into_is_read(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(generated.csv(),))
    writer.start()
    assert len(read_dataset(pipe)) == generated.ROWS
    writer.join()


def test_a_text_larger_than_memory_should_hold_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.write(b"x,y\n")
        file.truncate(raw.MOST_TEXT + 1)  # a hole takes no space
    with refused("too-large", "1"):
        read_dataset(path)
    monkeypatch.setattr(raw, "MOST_TEXT", 1 << 20)
    done = b"x,y\n" + b"1,2\n" * (1 << 20)
    with refused("too-large"):
        read_dataset(BytesIO(done))
