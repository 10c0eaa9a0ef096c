"""Joints and instruments in separate files, as a project names them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_data import LoadedData, load_dataset, validation_arguments
from loopcal.files.project.project_file import read_project
from loopcal.files.tables import delimited
from loopcal.files.tables.raw import Text, read_text
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.checking import run_simulation
from tests.refusals import refused

MECHANISM = """
schema = 1
[mechanism]
type = "serial"
[[mechanism.joint]]
name = "q1"
a = 0.4
alpha = 1.0
[[mechanism.joint]]
name = "q2"
a = 0.3
[[mechanism.instrument]]
type = "point"
name = "east"
readings = ["x", "y", "z"]
station = "east"
[[mechanism.instrument]]
type = "socket"
name = "cup"
[noise]
"q*" = 1e-5
"*" = 1e-5
"""
DATA = """
[data]
file = "joints.csv"
pose = "id"
exclude = ["p4"]
[data.columns]
q1 = { column = "J1", unit = "deg" }
q2 = { column = "J2", unit = "deg" }
[[data.join]]
file = "tracker.csv"
pose = "pose"
units = { length = "mm" }
[[data.join]]
file = "cup.csv"
pose = "pose"
instrument = ["cup"]
"""
JOINTS = "id,J1,J2\np1,10,20\np2,20,30\np3,30,40\np4,40,50\np5,50,60\n"
TRACKER = "pose,x,y,z\np2,100,200,300\np1,110,210,310\np9,1,1,1\n"
CUP = "pose,who\np3,Ann\np4,Ann\n"


def load(folder: Path, text: str = MECHANISM + DATA, **files: str) -> LoadedData:
    for name, content in {"joints": JOINTS, "tracker": TRACKER, "cup": CUP, **files}.items():
        (folder / f"{name}.csv").write_text(content)
    (folder / "project.toml").write_text(text)
    return load_dataset(read_project(folder / "project.toml"))


def test_each_of_several_files_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def noted(path: Path, encoding: str | None) -> Text:
        opened.append(path.name)
        return read_text(path, encoding)

    monkeypatch.setattr(delimited, "read_text", noted)
    load(tmp_path)
    assert sorted(opened) == ["cup.csv", "joints.csv", "tracker.csv"]


def test_each_pose_takes_what_the_files_say_of_it(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    data = loaded.dataset
    assert data.poses == ("p1", "p2", "p3")  # p5: no instrument, p4: excluded
    assert data["q1"] == pytest.approx(np.radians([10, 20, 30]))
    assert np.array_equal(data["x"], [0.11, 0.1, np.nan], equal_nan=True)
    gap = next(q for q in data.quantities if q.startswith("cup"))
    assert np.array_equal(data[gap], [np.nan, np.nan, 0.0], equal_nan=True)
    told = " ".join(map(str, loaded.warnings))
    assert "joints.csv: 1 pose is not in the other files and left out (p5)" in told
    assert "tracker.csv: 1 pose is" in told


def test_messages_name_the_file_that_is_meant(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        load(tmp_path, tracker="pose,x,y,z\np1,1,2,3\np2,1,2,far\n")
    assert "tracker.csv, row 3, column 'z'" in str(refused.value)
    data = load(tmp_path).dataset
    assert data.place(1, "x").endswith("tracker.csv, row 2, column 'x'")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('pose = "pose"\nunits', "units", "pose = "),
        ('instrument = ["cup"]', 'instrument = ["mug"]', "'mug'"),
        ('file = "tracker.csv"', 'file = "nowhere.csv"', "nowhere.csv"),
        ('q2 = { column = "J2", unit = "deg" }', "", "no column is named for the quantity 'q2'"),
        ("instrument = [", "columns = { q2 = 0 }\ninstrument = [", "'q2' is read from"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (MECHANISM + DATA).replace(old, new, 1)
    with pytest.raises(InputError) as refused:
        load(tmp_path, text)
    assert words in str(refused.value)


def test_a_known_constant_without_a_column_asks_for_the_column(tmp_path: Path) -> None:
    """No constant can be unmeasured, whatever the noise says of it."""
    effect = """
[[mechanism.effect]]
type = "drift"
changing = ["a_1"]
column = "temperature"
"""
    with pytest.raises(InputError) as refused:
        load(tmp_path, (MECHANISM + effect + DATA))
    assert "known constant 'temperature'" in refused.value.message
    assert refused.value.remedy is not None
    assert 'temperature = "its column"' in refused.value.remedy
    assert "inf" not in refused.value.remedy


SIMULATED = """
schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "serial"
[[mechanism.joint]]
name = "q1"
a = 0.4
alpha = 1.0
[[mechanism.joint]]
name = "q2"
a = 0.3
[noise]
"*" = 1e-5
[data]
file = "joints.csv"
pose = "pose"
units = { angle = "deg" }
[[data.join]]
file = "tracker.csv"
pose = "pose"
columns = { x = "x", y = "y", z = "z" }
units = { length = "mm" }
[parameters]
"[ad]_2" = { fixed = true }
"alpha_2" = { fixed = true }
"offset_*" = { fixed = true }
d_1 = { fixed = true }
[simulation]
poses = 30
ranges = { q1 = { from = -2, to = 2 }, q2 = { from = -2, to = 2 } }
truth = { a_1 = 0.401, base_x = 1.0 }
"""


def test_a_simulation_writes_the_files_that_the_project_reads(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(SIMULATED)
    made = run_simulation(tmp_path / "project.toml", out=tmp_path / "joints.csv", seed=3)
    assert (tmp_path / "joints.csv").read_text().startswith("pose,q1,q2\n")
    assert (tmp_path / "tracker.csv").read_text().startswith("pose,x,y,z\n")
    done = run_calibration(tmp_path / "project.toml", Request(truth=made.truth_file))
    sd = done.result.sd["a_1"]
    assert sd is not None
    assert abs(done.result.value["a_1"] - 0.401) < 4 * sd
    document = done.written.document
    assert [part.file for part in document.data.joined] == ["tracker.csv"]


def by_row(text: str) -> str:
    return text.replace('pose = "id"', "pose = 0").replace('pose = "pose"', "pose = 0")


def test_files_are_joined_row_by_row_where_that_is_asked_for(tmp_path: Path) -> None:
    text = by_row(MECHANISM + DATA.replace('exclude = ["p4"]', ""))
    repeated = JOINTS.replace("p2", "p1")  # ids that repeat do no harm: they are not looked at
    data = load(tmp_path, text, joints=repeated).dataset
    assert data.poses == ("1", "2", "3")
    assert np.array_equal(data["x"], [0.1, 0.11, 0.001])


GROUPED = """
[fit.validation]
folds = 2
group = "wall"
"""


def test_groups_follow_the_ids_of_the_poses(tmp_path: Path) -> None:
    joints = "id,J1,J2,wall\np5,50,60,9\np1,10,20,1\np2,20,30,2\np3,30,40,1\np4,40,50,2\n"
    loaded = load(tmp_path, MECHANISM + DATA + GROUPED, joints=joints)
    project = read_project(tmp_path / "project.toml")
    assert project.fit.validation is not None
    found = validation_arguments(project, project.fit.validation, loaded.dataset.poses)
    assert loaded.dataset.poses == ("p1", "p2", "p3")  # p5 is lost, p4 excluded
    assert found["groups"] == (1.0, 2.0, 1.0)
    text = MECHANISM + DATA.replace('exclude = ["p4"]', "") + GROUPED
    elsewhere = load(tmp_path, text, cup="pose,wall\np3,7\np1,8\np2,9\n")
    found = validation_arguments(project, project.fit.validation, elsewhere.dataset.poses)
    assert dict(zip(elsewhere.dataset.poses, found["groups"], strict=True))["p3"] == 7.0


def test_a_group_that_no_file_has_is_refused(tmp_path: Path) -> None:
    loaded = load(tmp_path, MECHANISM + DATA + GROUPED)
    project = read_project(tmp_path / "project.toml")
    assert project.fit.validation is not None
    with refused("missing-column", "'wall'"):
        validation_arguments(project, project.fit.validation, loaded.dataset.poses)
