"""Runs of poses that are split off in a project, and taken back."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.companions.app.session import Session
from loopcal.errors import InputError

PROJECT = """\
schema = 1

[mechanism]
type = "planar-two-link"

[data]
file = "poses.csv"
pose = "name"  # of each pose
[data.columns]
xP = { column = "xP", unit = "mm" }
yP = { column = "yP", unit = "mm" }
phi2 = { column = "phi2", unit = "deg" }
phi3 = { column = "phi3", unit = "deg" }

[noise]
"?P" = { sd = 0.1, unit = "mm" }
"phi?" = { sd = 1, unit = "mrad" }
"""
ROWS = "name,phi2,phi3,xP,yP\n" + "\n".join(
    f"{name},{10 * i},{5 * i},{100 + i},{200 + i}" for i, name in enumerate("abcdefgh")
)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    pytest.importorskip("tomlkit", reason="tomlkit is absent; `pip install .[app]` installs it")
    (tmp_path / "project.toml").write_text(PROJECT, "utf-8")
    (tmp_path / "poses.csv").write_text(ROWS + "\n", "utf-8")
    return Session(tmp_path, lambda words: 0)


def test_a_run_is_split_at_its_own_rows_whatever_was_left_out_before(session: Session) -> None:
    session.excluded(["b", "e"], "bad reading")
    session.shifted(["xA"], ["d", "e", "f"], "moved")
    assert session.steps() == [4.0, 7.0]  # rows d and g of the file
    data = session.readings()
    assert data is not None
    assert data.dataset.poses == ("a", "c", "d", "f", "g", "h")
    assert data.dataset["pose"].tolist() == [1.0, 3.0, 4.0, 6.0, 7.0, 8.0]
    text = session.folder.text() or ""
    assert 'pose = "name"  # of each pose' in text
    session.folder.undo()
    session.folder.undo()
    assert session.folder.text() == PROJECT


def test_a_run_of_all_poses_or_of_none_in_use_is_refused(session: Session) -> None:
    with pytest.raises(InputError):
        session.shifted(["xA"], list("abcdefgh"), "moved")
    session.excluded(["c"], "bad reading")
    with pytest.raises(InputError):
        session.shifted(["xA"], ["c"], "moved")


def test_a_removed_project_comes_back(session: Session) -> None:
    session.folder.remove("another robot")
    assert session.project() is None
    session.folder.undo()
    assert session.folder.text() == PROJECT
