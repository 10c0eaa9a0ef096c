"""`init` of whole robots: files, columns and rows of what was observed between their bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses import trees
from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.workflow.beginning import from_tree
from loopcal.workflow.readings import new_readings
from tests.refusals import refused

BODIES = """body,parent,joint,a [mm],d [mm],alpha [deg],theta [deg]
l1,base,lq1,60,350,90,0
l2,l1,lq2,420,0,0,0
lh,l2,,0,100,0,0
r1,base,rq1,60,350,90,10
r2,r1,rq2,400,0,0,0
rh,r2,,0,100,0,0
"""
URDF = """<robot name="two">
<link name="base"/><link name="left"/><link name="right"/>
<joint name="lq1" type="revolute"><parent link="base"/><child link="left"/><axis xyz="0 0 1"/>
</joint>
<joint name="rq1" type="revolute"><parent link="base"/><child link="right"/><axis xyz="0 0 1"/>
</joint></robot>
"""
TOUCH = "contact name=touch between=lh,rh radius=20mm,30mm"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A table of bodies, poses of both arms with words, and those of one arm under other names."""
    (tmp_path / "bodies.csv").write_text(BODIES, encoding="utf-8")
    draw = np.random.default_rng(0)
    rows = ["pose,kind,lq1,lq2,rq1,rq2,x,y,z"]
    for i in range(12):
        q = ",".join(f"{v:.3f}" for v in draw.uniform(-20.0, 20.0, 4))
        point = "400.0,100.0,350.0" if i % 3 == 0 else ",,"
        rows.append(f"{i},{'upper' if i < 8 else 'lower'},{q},{point}")
    (tmp_path / "both.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    one = [f"{i},{0.1 * i},{0.2 * i},0.4,0.1,0.3" for i in range(5)]
    head = "pose,A1 [rad],A2 [rad],X [m],Y [m],Z [m]"
    (tmp_path / "one.csv").write_text("\n".join([head, *one]) + "\n", encoding="utf-8")
    return tmp_path


def begun(folder: Path, files: tuple[str, ...], *observe: str) -> lc.InitialProject:
    """The project of these files."""
    paths = [folder / name for name in files]
    return lc.init(*paths, dh=folder / "bodies.csv", observe=observe, out=folder / "cell")


def test_each_file_has_the_observations_whose_joints_and_columns_it_has(folder: Path) -> None:
    made = begun(
        folder,
        ("both.csv", "one.csv"),
        TOUCH,
        "point name=near on=lh station=eye columns=x,y,z file=both",
        "point name=far on=lh station=eye columns=X,Y,Z file=one joints=lq1:A1,lq2:A2",
    )
    data = made.dataset
    assert len(data) == 12 + 5
    assert np.isfinite(data["touch_gap"]).sum() == 12
    assert np.isfinite(data["near_x"]).sum() == 4
    assert np.isfinite(data["far_x"]).sum() == 5
    # degrees and millimetres by the size of all numbers of a kind; the others as stated
    assert np.nanmax(np.abs(data["rq1"])) < np.radians(20.0)
    assert data["lq2"][-1] == pytest.approx(0.8)
    assert data["near_x"][0] == pytest.approx(0.4)
    assert any("joints without a unit are taken in deg" in words for words in made.remarks)
    assert any("readings without a unit are taken in mm" in words for words in made.remarks)
    assert len(set(data.poses)) == 17


def test_a_word_in_a_column_says_in_which_rows_it_was_observed(folder: Path) -> None:
    made = begun(folder, ("both.csv",), f"{TOUCH} where=kind:up*")
    assert len(made.dataset) == 8


def test_the_drawing_is_stated_and_no_length_is_left_without_an_sd(folder: Path) -> None:
    parameters = begun(folder, ("both.csv",), TOUCH).mechanism.parameters
    drawn = [p for p in parameters if p.role in ("length", "twist", "zero")]
    assert all(np.isfinite(p.prior_sd) for p in drawn)
    assert parameters["touch_distance"].nominal == pytest.approx(0.05)
    assert parameters["touch_distance"].fixed


@pytest.mark.parametrize(("off", "stated"), [(0.0, True), (0.05, False)])
def test_a_target_is_where_the_drawing_has_a_body_for_it_unless_points_deny_it(
    folder: Path, off: float, stated: bool
) -> None:
    rows = ["lq1,lq2,x [m],y [m],z [m]"]
    draw = np.random.default_rng(1)
    for _ in range(20):
        a, b = draw.uniform(-100.0, 100.0, 2)
        # both rows of the arm; the second joint turns about the third axis of the first one's row
        arm = (0.42 + off) * np.array([np.cos(np.radians(b)), np.sin(np.radians(b))])
        c, s = np.cos(np.radians(a)), np.sin(np.radians(a))
        point = (c * (0.06 + arm[0]) + s * 0.1, s * (0.06 + arm[0]) - c * 0.1, 0.35 + arm[1])
        rows.append(",".join(f"{v:.6f}" for v in (a, b, *point)))
    (folder / "seen.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    made = begun(folder, ("seen.csv",), "point name=near on=lh columns=x,y,z")
    near = made.mechanism.parameters["near_target_x"]
    assert near.prior_sd == pytest.approx(2e-3 if stated else 0.2)
    assert any("'lh' within 2 mm" in words for words in made.remarks) == stated


@pytest.mark.parametrize(("swing", "sd"), [(60.0, 200.0), (0.1, 2.0)])
def test_a_ball_in_a_socket_denies_the_drawing_where_the_hand_moves_around_it(
    folder: Path, swing: float, sd: float
) -> None:
    """The ball sits on the axis of the elbow, which alone turns."""
    rows = ["pose,lq1,lq2", *(f"{i},20.0,{q:.4f}" for i, q in enumerate(np.linspace(0, swing, 9)))]
    (folder / "socket.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    observe = [f"socket name={name} on=lh target=ball file={name}" for name in ("socket", "other")]
    (folder / "other.csv").write_text("\n".join(rows[:2]) + "\n", encoding="utf-8")
    begun(folder, ("socket.csv", "other.csv"), *observe)
    project = (folder / "cell" / "project.toml").read_text("utf-8")
    assert f'ball_x = {{ value = 0.0, unit = "mm", sd = {sd} }}' in project


@pytest.mark.parametrize(
    ("observe", "sd"), [(TOUCH, 2e-3), ("contact name=touch between=l2,r2", 0.2)]
)
def test_balls_are_centred_where_the_drawing_has_bodies_for_them(
    folder: Path, observe: str, sd: float
) -> None:
    parameters = begun(folder, ("both.csv",), observe).mechanism.parameters
    assert parameters["touch_1_x"].prior_sd == sd
    assert parameters["touch_2_x"].prior_sd == sd


def test_an_inclinometer_is_turned_by_an_unknown_angle(folder: Path) -> None:
    rows = ["lq1 [deg],lq2 [deg],ax [deg],ay [deg]", *(f"{a},30,0,{a / 2}" for a in range(9))]
    (folder / "level.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    made = begun(folder, ("level.csv",), "inclinometer name=level on=lh columns=ax,ay")
    assert made.mechanism.parameters["level_rx"].prior_sd == pytest.approx(np.pi / 3)


def test_a_reading_has_no_name_of_its_station(folder: Path) -> None:
    observe = "point name=eye on=lh station=eye columns=x,y,z"
    mechanism = begun(folder, ("both.csv",), observe).mechanism
    assert mechanism.families[0].readings == ("eye_seen_x", "eye_seen_y", "eye_seen_z")
    assert {*mechanism.quantities}.isdisjoint(mechanism.parameters.names)


def test_cameras_that_see_one_plane_begin_with_one_normal(folder: Path) -> None:
    draw = np.random.default_rng(3)
    rows = ["lq1 [deg],lq2 [deg],rq1 [deg],rq2 [deg],a [rad],b [rad],c [m],d [rad],e [rad],f [m]"]
    for _ in range(9):
        joints, seen = draw.uniform(-40.0, 40.0, 4), draw.uniform(0.1, 0.5, 6)
        rows.append(",".join(f"{v:.4f}" for v in (*joints, *seen)))
    (folder / "wall.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    observe = [
        f"seen-plane name={on} on={on} plane=wall columns={columns}"
        for on, columns in (("lh", "a,b,c"), ("rh", "d,e,f"))
    ]
    made = begun(folder, ("wall.csv",), *observe)
    left, right = made.inputs["mechanism"]["instrument"]
    assert left["normal"] == right["normal"]
    assert np.linalg.norm(left["normal"]) == pytest.approx(1.0, abs=1e-2)
    parameters = made.mechanism.parameters
    assert parameters["lh_x"].prior_sd == parameters["rh_x"].prior_sd == 0.2


def test_a_large_robot_begins_with_one_method(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "method" not in begun(folder, ("both.csv",), TOUCH).inputs.get("fit", {})
    monkeypatch.setattr(from_tree, "LARGE", 100)
    made = lc.init(folder / "both.csv", dh=folder / "bodies.csv", observe=[TOUCH])
    assert made.inputs["fit"]["method"] == "implicit-loop"
    assert any("delete the line" in words for words in made.remarks)


def test_a_urdf_needs_no_list_of_its_links(folder: Path) -> None:
    (folder / "two.urdf").write_text(URDF, encoding="utf-8")
    made = lc.init(
        folder / "both.csv",
        urdf=folder / "two.urdf",
        observe=["point on=left columns=x,y,z", "contact between=left,right"],
    )
    assert dict(made.mechanism.joints) == {"lq1": "rad", "rq1": "rad"}


@pytest.mark.parametrize(
    ("observe", "code", "stated"),
    [
        (("point on=lh columns=x,y",), "wrong-shape", ("3", "2")),
        (("point on=lh columns=x,y,w file=both",), "missing-column", ("'w'", "both.csv")),
        (("point on=hand columns=x,y,z",), "unknown-name", ("'hand'",)),
        (("point on=lh columns=a,b,c",), "missing-column", ("both.csv",)),
        ((f"{TOUCH} where=sort:up",), "missing-column", ("'sort'", "kind")),
        (("point on", TOUCH), "invalid-usage", ("'on'",)),
        ((TOUCH, TOUCH), "invalid-usage", ("'touch'",)),
    ],
)
def test_what_does_not_fit_is_refused(
    folder: Path, observe: tuple[str, ...], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        begun(folder, ("both.csv",), *observe)
    assert not (folder / "cell").exists()


def test_a_tree_is_written_again_bit_for_bit(folder: Path) -> None:
    table = {
        "type": "tree",
        "root": "base",
        "body": [
            {"name": "a", "parent": "base", "row": {"name": "q1", "a": 0.3, "alpha": 1.5}},
            {"name": "b", "parent": "base", "joint": {"name": "q2", "axis": [0, 0, 1]}},
            {"name": "hand", "parent": "b", "row": {"name": "hand", "d": 0.1}, "fixed": True},
        ],
        "instrument": [{"type": "contact", "between": ["a", "hand"], "radius": [0.02, 0.03]}],
        "observation": [{"type": "held-part", "between": ["a", "b"]}],
        "mass": [{"name": "b", "joint": "q2", "point": [0.1, 0.0, 0.0], "mass": 2.0}],
    }
    made = mechanism_from_data(table, "here")
    path = folder / "tree.toml"
    path.write_text(mechanism_to_toml(made), encoding="utf-8")
    again = read_mechanism(path)
    assert again.tree == made.tree
    assert again.tape == made.tape
    assert again.parameters == made.parameters
    assert again.masses == made.masses


def test_a_held_part_begins_where_the_drawing_has_the_hands(folder: Path) -> None:
    rows = ["pose,lq1,lq2,rq1,rq2", *(f"{i},20.0,-10.0,150.0,30.0" for i in range(3))]
    (folder / "part.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    made = begun(folder, ("part.csv",), "held-part name=part between=lh,rh")
    off = np.array(list(made.mechanism.loop_values(made.dataset).values()))
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_a_file_of_one_arm_is_read_on_another_day_as_on_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its columns and joints have the names of the first day; what it lacks was not read."""
    monkeypatch.setattr(trees, "POSES", 30)
    monkeypatch.setattr(trees, "FRESH", 1)
    world = trees.touching(np.random.default_rng([1, 0]))
    for name, text in {"bodies.csv": world.bodies + "\n", **world.files}.items():
        (tmp_path / name).write_text(text, "utf-8")
    renamed = (tmp_path / "seen_a.csv").read_text("utf-8").replace("l1,", "A1,", 1)
    (tmp_path / "seen_a.csv").write_text(renamed, "utf-8")
    observe = [o + " joints=l1:A1" if "name=a" in o else o for o in world.observe]
    files = [tmp_path / name for name in world.files]
    lc.init(*files, dh=tmp_path / "bodies.csv", observe=observe, out=tmp_path / "cell")
    result = lc.calibrate(tmp_path / "cell" / "project.toml", method="implicit-loop")
    (tmp_path / "seen_a_monday.csv").write_text(renamed, "utf-8")
    predicted = result.predict(tmp_path / "seen_a_monday.csv")
    assert np.isfinite(predicted.outputs["a_x"]).all()
    assert np.isnan(predicted.outputs["b_x"]).all()
    assert "30 of 30 poses predicted" in predicted.words()
    assert "sd of b" not in predicted.words()
    day = lc.verify(result, [tmp_path / "seen_a_monday.csv"])
    assert day.calibrated is not None
    assert day.calibrated.rms < 1e-4
    assert not any(one.name.startswith("touch") for one in day.placed)
    updated = lc.update(result, [tmp_path / "seen_a_monday.csv"])
    assert not [words for words in updated.warnings if "Not identifiable" in words]
    with refused("missing-column", "no observation stands in this file"):
        result.predict(tmp_path / "bodies.csv")


def test_a_later_file_of_another_name_is_read_by_its_joints_and_columns(folder: Path) -> None:
    """The words of file names tell files of the first day apart."""
    rows = ["A1 [deg],A2 [deg],x,y,z", *(f"{a},30,{a},0,0" for a in range(-60, 60, 10))]
    (folder / "alone.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    alone = "point name=one on=lh columns=x,y,z joints=lq1:A1,lq2:A2 file=alone"
    both = "point name=two on=rh columns=x,y,z file=both"
    made = begun(folder, ("alone.csv", "both.csv"), alone, both)
    project = lc.read_project(folder / "cell" / "project.toml")
    (folder / "monday.csv").write_bytes((folder / "alone.csv").read_bytes())
    later = new_readings(folder / "monday.csv", project.inputs, made.mechanism, whole=True)
    assert np.isfinite(later["one_x"]).all()
    assert np.isnan(later["two_x"]).all()
    (folder / "monday.csv").write_text("a,b\n1,2\n3,4\n", encoding="utf-8")
    with refused("missing-column", "its name then held 'alone' or 'both'"):
        new_readings(folder / "monday.csv", project.inputs, made.mechanism, whole=True)


def test_a_project_that_was_changed_is_replaced_by_force_alone(folder: Path) -> None:
    begun(folder, ("both.csv",), TOUCH)
    begun(folder, ("both.csv",), TOUCH)
    project = folder / "cell" / "project.toml"
    project.write_text(project.read_text("utf-8") + "# mine\n", "utf-8")
    with refused("unwritable-file", "force=True"):
        begun(folder, ("both.csv",), TOUCH)
    lc.init(
        folder / "both.csv",
        dh=folder / "bodies.csv",
        observe=[TOUCH],
        out=folder / "cell",
        force=True,
    )
    assert project.with_name("project.toml.bak").read_text("utf-8").endswith("# mine\n")


def test_a_touched_plane_begins_where_the_drawing_has_its_points(folder: Path) -> None:
    """A joint about the vertical keeps the height, 350 mm and 420 mm sin 30 degrees."""
    rows = ["lq1 [deg],lq2 [deg]", *(f"{a},30" for a in range(-60, 60, 10))]
    (folder / "floor.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    made = begun(folder, ("floor.csv",), "plane name=floor on=lh")
    (floor,) = made.inputs["mechanism"]["instrument"]
    assert floor["normal"] == [0.0, 0.0, 1.0]
    assert made.mechanism.parameters["floor_distance"].nominal == pytest.approx(0.56)
    stated = begun(folder, ("floor.csv",), "plane name=floor on=lh normal=0,0,-2")
    assert stated.mechanism.parameters["floor_distance"].nominal == pytest.approx(-0.56)


def test_a_later_file_whose_joints_are_named_as_in_the_project_is_read_as_the_first(
    folder: Path,
) -> None:
    made = begun(folder, ("both.csv",), "point name=tip on=lh columns=x,y,z")
    project = lc.read_project(folder / "cell" / "project.toml")
    later = new_readings(folder / "both.csv", project.inputs, made.mechanism, whole=True)
    np.testing.assert_allclose(later["tip_x"], made.dataset["tip_x"])
    own = new_readings(folder / "cell" / "readings.csv", project.inputs, made.mechanism, whole=True)
    np.testing.assert_allclose(own["tip_x"], made.dataset["tip_x"])
