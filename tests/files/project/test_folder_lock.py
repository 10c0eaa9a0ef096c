"""A folder has one server at a time, and none that is gone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_folder import FolderLock

HOLDS = """
import sys
from pathlib import Path
from loopcal.files.project.project_folder import FolderLock
lock = FolderLock(Path(sys.argv[1]), "http://there")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_one_is_refused_with_the_address_of_the_first(tmp_path: Path) -> None:
    first = FolderLock(tmp_path, "http://127.0.0.1:8765")
    with pytest.raises(InputError, match=r"at http://127\.0\.0\.1:8765") as caught:
        FolderLock(tmp_path, "http://127.0.0.1:8766")
    assert caught.value.code == "unwritable-file"
    first.release()
    FolderLock(tmp_path, "http://127.0.0.1:8766").release()


def test_a_killed_process_leaves_no_lock(tmp_path: Path) -> None:
    line = [sys.executable, "-c", HOLDS, str(tmp_path)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(InputError, match="http://there"):
            FolderLock(tmp_path, "http://here")
        process.kill()
    FolderLock(tmp_path, "http://here").release()


def test_a_folder_that_is_gone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        FolderLock(tmp_path / "gone", "http://here")
    assert caught.value.code == "unwritable-file"
