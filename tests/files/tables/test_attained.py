"""Tables of attained poses: what is recognised, and what is refused with its place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from loopcal.files.recognition.meanings import rotations
from loopcal.files.tables.attained import read_attained, template
from tests.refusals import refused

HEAD = "pose,cycle,x_cmd [mm],y_cmd [mm],z_cmd [mm],x [mm],y [mm],z [mm]"
ROWS = ["A,1,100,0,0,100.1,0,0", "A,2,100,0,0,100.2,0,0", "B,1,0,100,0,0,100,0"]


def written(folder: Path, *lines: str, name: str = "poses.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def test_columns_are_recognised(tmp_path: Path) -> None:
    read = read_attained(written(tmp_path, HEAD, *ROWS))
    assert read.pose == ("A", "A", "B")
    assert read.cycle == ("1", "2", "1")
    assert read.measured[1] == pytest.approx([0.1002, 0.0, 0.0])
    assert read.commanded[2] == pytest.approx([0.0, 0.1, 0.0])


def test_a_table_without_z_is_one_of_a_plane(tmp_path: Path) -> None:
    head = "pose,cycle,x_cmd [mm],y_cmd [mm],x [mm],y [mm]"
    rows = ["A,1,100,0,100.1,0", "A,2,100,0,100.2,0", "B,1,0,100,0,100"]
    read = read_attained(written(tmp_path, head, *rows))
    assert read.planar
    assert read.measured[1] == pytest.approx([0.1002, 0.0, 0.0])
    assert "no z" in read.notes[0]
    lacking = written(tmp_path, f"{head},z [mm]", *(f"{row},5" for row in rows), name="half.csv")
    with refused("missing-column", "z_cmd"):
        read_attained(lacking)
    asked = written(tmp_path, "pose,x [mm],y [mm],z [mm]", "A,100,0,3", "B,0,100,3", name="at.csv")
    with refused("missing-column"):
        read_attained(
            written(tmp_path, "pose,x [mm],y [mm]", "A,100,0", name="two.csv"), commanded=asked
        )


@pytest.mark.parametrize(
    "head",
    [
        "Point ID;Run;X nominal (mm);Y nominal (mm);Z nominal (mm);X (mm);Y (mm);Z (mm)",
        "pose;rep;cmd_x_mm;cmd_y_mm;cmd_z_mm;meas_x_mm;meas_y_mm;meas_z_mm",
        "pose;cycle;target x/mm;target y/mm;target z/mm;actual x/mm;actual y/mm;actual z/mm",
    ],
)
def test_headers_of_others_mean_the_same(tmp_path: Path, head: str) -> None:
    read = read_attained(written(tmp_path, head, *(row.replace(",", ";") for row in ROWS)))
    assert read.pose == ("A", "A", "B")
    assert read.measured[0] == pytest.approx([0.1001, 0.0, 0.0])


def test_workbooks_and_parquet_mean_the_same(tmp_path: Path) -> None:
    text = read_attained(written(tmp_path, HEAD, *ROWS))
    table = pl.read_csv(tmp_path / "poses.csv")
    table.write_excel(tmp_path / "poses.xlsx")
    table.write_parquet(tmp_path / "poses.parquet")
    for name in ("poses.xlsx", "poses.parquet"):
        read = read_attained(tmp_path / name)
        assert (read.pose, read.cycle) == (text.pose, text.cycle)
        np.testing.assert_array_equal(read.measured, text.measured)


def test_commanded_poses_from_another_table(tmp_path: Path) -> None:
    poses = written(tmp_path, "pose,x [m],y [m],z [m]", "A,0.1,0,0", "B,0,0.1,0", name="c.csv")
    rows = ["A,1,100.1,0,0", "B,1,0,100,0"]
    path = written(tmp_path, "pose,cycle,x,y,z", *rows)
    read = read_attained(path, commanded=poses, units="mm")
    assert read.commanded == pytest.approx(np.array([[0.1, 0, 0], [0, 0.1, 0]]))
    with refused("mismatched-poses", "poses.csv, row 4", "'C'"):
        read_attained(
            written(tmp_path, "pose,cycle,x,y,z", *rows, "C,1,0,0,0"), commanded=poses, units="mm"
        )


def test_a_missing_measurement_is_left_out_and_said(tmp_path: Path) -> None:
    read = read_attained(written(tmp_path, HEAD, *ROWS, "B,2,0,100,0,,,"))
    assert len(read) == 3
    assert any("row 5" in note for note in read.notes)


def test_without_pose_and_cycle_columns_places_and_rows_count(tmp_path: Path) -> None:
    lines = [",".join(line.split(",")[2:]) for line in (HEAD, *ROWS)]
    read = read_attained(written(tmp_path, *lines))
    assert read.pose == ("P1", "P1", "P2")
    assert read.cycle == ("1", "2", "1")
    assert any("cycle" in note for note in read.notes)


def test_payload_speed_direction_time_and_block_are_read(tmp_path: Path) -> None:
    head = f"{HEAD},payload [kg],speed [mm/s],approach direction,time [min],block"
    path = written(tmp_path, head, *(f"{row},5,250,+x,{i},1" for i, row in enumerate(ROWS)))
    read = read_attained(path)
    assert read.conditions == {"payload [kg]": ("5",) * 3, "speed [mm/s]": ("250",) * 3}
    assert read.direction == ("+x",) * 3
    assert read.block == ("1",) * 3
    assert read.time == pytest.approx([0.0, 60.0, 120.0])


@pytest.mark.parametrize(
    ("unit", "seconds"), [("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0)]
)
def test_a_time_is_in_the_unit_of_its_header(tmp_path: Path, unit: str, seconds: float) -> None:
    rows = [f"{row},{250 * i}" for i, row in enumerate(ROWS)]
    read = read_attained(written(tmp_path, f"{HEAD},time [{unit}]", *rows))
    assert read.time == pytest.approx([0.0, 250 * seconds, 500 * seconds])


def test_dates_are_times(tmp_path: Path) -> None:
    rows = [f"{row},2026-03-01T08:{10 + i}:00" for i, row in enumerate(ROWS)]
    read = read_attained(written(tmp_path, f"{HEAD},timestamp", *rows))
    assert read.time == pytest.approx([0.0, 60.0, 120.0])
    with refused("invalid-value", "row 5", "'timestamp'", "noon"):
        read_attained(written(tmp_path, f"{HEAD},timestamp", *rows, "B,2,0,100,0,0,0,0,noon"))


def test_orientations_in_their_conventions(tmp_path: Path) -> None:
    """A turn of 90 degrees about z, written in four ways."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for names, form, values in (
        ("roll [deg],pitch [deg],yaw [deg]", None, "0,0,90"),
        ("a [deg],b [deg],c [deg]", "zyx", "90,0,0"),
        ("rx [rad],ry [rad],rz [rad]", "rotvec", "0,0,1.5707963267948966"),
        ("qw,qx,qy,qz", None, "0.7071067811865476,0,0,0.7071067811865476"),
    ):
        asked = ",".join(f"cmd_{name}" for name in names.split(","))
        path = written(
            tmp_path, f"{HEAD},{names},{asked}", *(f"{r},{values},{values}" for r in ROWS)
        )
        read = read_attained(path, angles=form)
        assert read.measured_turns is not None
        assert read.measured_turns[0] == pytest.approx(quarter)
        if form is not None:
            with refused("conflicting-keys", "--angles"):
                read_attained(path)


def test_rpy_and_zyx_are_the_same_turns_in_the_opposite_order() -> None:
    angles = np.array([[0.1, -0.4, 1.0]])
    assert rotations(angles, "xyz") == pytest.approx(rotations(angles[:, ::-1], "ZYX"))


@pytest.mark.parametrize(
    ("code", "stated", "lines"),
    [
        ("unknown-unit", ("'x'", "--units"), [HEAD.replace(",x [mm]", ",x"), *ROWS]),
        ("wrong-unit", ("'x [deg]'",), [HEAD.replace(",x [mm]", ",x [deg]"), *ROWS]),
        ("missing-column", ("commanded", "--commanded"), ["pose,x [mm],y [mm],z [mm]", "A,1,2,3"]),
        ("missing-column", ("measured",), ["pose,x_cmd [mm]", "A,1"]),
        ("invalid-number", ("row 3", "'y [mm]'", "1o0"), [HEAD, ROWS[0], "A,2,100,0,0,1,1o0,0"]),
        ("duplicate-name", ("row 3", "row 2"), [HEAD, ROWS[0], ROWS[0]]),
        ("mismatched-poses", ("row 3", "'A'"), [HEAD, ROWS[0], "A,2,101,0,0,1,1,0"]),
        ("missing-reading", ("row 3",), [HEAD, ROWS[0], "A,2,,0,0,1,1,0"]),
        ("no-data", ("poses.csv",), [HEAD, "A,1,100,0,0,,,"]),
        ("duplicate-column", ("'x [mm]'", "'act x [mm]'"), [f"{HEAD},act x [mm]", f"{ROWS[0]},1"]),
        ("unknown-unit", ("'time'",), [f"{HEAD},time", f"{ROWS[0]},1"]),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_with_its_place(
    tmp_path: Path, code: str, stated: tuple[str, ...], lines: list[str]
) -> None:
    with refused(code, *stated):  # type: ignore[arg-type]
        read_attained(written(tmp_path, *lines))


def test_a_person_is_asked_once_for_each_dimension(tmp_path: Path) -> None:
    asked: list[str] = []

    def ask(question: str, answers: Sequence[str]) -> int:
        asked.append(question)
        return answers.index("mm")

    path = written(tmp_path, HEAD.replace(" [mm]", ""), *ROWS)
    assert read_attained(path, ask=ask).measured[0, 0] == pytest.approx(0.1001)
    assert len(asked) == 1


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD, *ROWS)
    with refused("unknown-name", "zxz"):
        read_attained(path, angles="zxz")
    with refused("wrong-unit", "kg"):
        read_attained(path, units="kg")


def test_the_template_has_five_poses_in_one_plane_and_thirty_cycles(tmp_path: Path) -> None:
    with refused("no-data"):
        read_attained(written(tmp_path, template()))
    filled = [f"{line[:-3]},1,2,3" if i else line for i, line in enumerate(template().splitlines())]
    read = read_attained(written(tmp_path, *filled))
    assert len(read) == 150
    places = np.unique(read.commanded, axis=0)
    assert len(places) == 5
    assert np.linalg.matrix_rank(places - places.mean(axis=0), tol=1e-9) == 2
