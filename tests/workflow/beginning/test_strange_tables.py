"""Tables as laboratories keep them: stations, reflectors, titles, summaries, other languages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from tests.reference import dh_arm
from tests.refusals import refused

N = 40
JOINTS = dh_arm.poses(N)
FRAMES = dh_arm.seen(JOINTS, sd=5e-5)
DEGREES, POINTS = np.degrees(JOINTS), FRAMES[:, :3, 3]
NAMES = [f"J{i}" for i in range(1, 7)]
IDS = [f"P{i:03d}" for i in range(1, N + 1)]


def moved(points: np.ndarray) -> np.ndarray:
    """As an instrument sees them from another place."""
    turn = Rotation.from_euler("ZYX", [0.8, 0.05, -0.1]).as_matrix()
    return points @ turn.T + [1.5, -0.8, 0.1]


def text(
    head: Sequence[str], columns: Iterable[Any], separator: str = ",", decimal: str = "."
) -> str:
    rows = [separator.join(head)]
    for row in zip(*columns, strict=True):
        cells = [f"{c:.6f}".replace(".", decimal) if isinstance(c, float) else str(c) for c in row]
        rows.append(separator.join(cells))
    return "\n".join(rows) + "\n"


def begun(folder: Path, *contents: str, out: bool = False) -> lc.InitialProject:
    """The project of files with these contents."""
    table = folder / "dh.csv"
    table.write_text(dh_arm.dh_table(), "utf-8")
    files = [folder / f"{i}.csv" for i in range(len(contents))]
    for path, content in zip(files, contents, strict=True):
        path.write_text(content, "utf-8")
    return lc.init(*files, dh=table, out=folder / "out" if out else None)


def fitted(project: lc.InitialProject) -> float:
    """Rms distance [m] of a least-squares fit."""
    result = lc.calibrate(project, method="least-squares")
    assert result.status.converged
    assert result.accuracy_after is not None
    return result.accuracy_after.rms


@pytest.mark.parametrize("names", [("1", "2"), ("north", "south")])
def test_a_column_of_stations_gives_each_a_place_and_all_one_reflector(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    second = np.arange(N) % 2 == 1
    points = 1e3 * np.where(second[:, None], moved(POINTS), POINTS)
    where = [names[int(s)] for s in second]
    table = text(["pose", "sta", *NAMES, "x", "y", "z"], [IDS, where, *DEGREES.T, *points.T])
    made = begun(tmp_path, table, out=True)
    assert any(
        f"x_1, y_1, z_1: target tool, station base ({names[0]}); "
        f"x_2, y_2, z_2: target tool, station station_2 ({names[1]})" in words
        for words in made.remarks
    )
    assert fitted(made) == pytest.approx(8e-5, rel=0.3)
    project = lc.read_project(tmp_path / "out" / "project.toml")
    assert len(lc.load_dataset(project).dataset) == N


def test_stations_that_agree_in_one_coordinate_read_it_each(tmp_path: Path) -> None:
    """Trackers on one floor: z is a reading of both, no column of the pose."""
    other = 1e3 * (POINTS[:, [1, 0, 2]] * (-1.0, 1.0, 1.0) + (0.3, 0.2, 0.0))
    points = np.concatenate([1e3 * POINTS, other])
    columns = [*np.tile(DEGREES.T, 2), *points.T]
    table = text(
        ["pose", "sta", *NAMES, "x", "y", "z"], [[*IDS, *IDS], ["1"] * N + ["2"] * N, *columns]
    )
    made = begun(tmp_path, table)
    assert len(made.dataset) == N
    assert any("x_2, y_2, z_2: target tool, station station_2" in words for words in made.remarks)
    assert fitted(made) < 1.2e-4


def test_a_station_with_too_few_rows_is_refused(tmp_path: Path) -> None:
    where = ["1"] * (N - 2) + ["2"] * 2
    table = text(["sta", *NAMES, "x", "y", "z"], [where, *DEGREES.T, *(1e3 * POINTS).T])
    with refused("too-few-poses", "station 2", "sta"):
        begun(tmp_path, table)


@pytest.mark.parametrize("names", [("1", "2"), ("SMR top", "SMR side")])
def test_a_row_per_reflector_becomes_a_row_per_pose(tmp_path: Path, names: tuple[str, str]) -> None:
    other = POINTS + FRAMES[:, :3, :3] @ np.array([0.1, 0.05, 0.02])
    points = 1e3 * np.stack([POINTS, other], axis=1).reshape(-1, 3)
    twice = np.repeat(DEGREES, 2, axis=0)
    columns = [np.repeat(IDS, 2), [*names] * N, *twice.T, *points.T]
    made = begun(tmp_path, text(["pose", "target", *NAMES, "x", "y", "z"], columns))
    assert len(made.dataset) == N
    assert fitted(made) < 1.2e-4


TABLE = text(["pose", *NAMES, "x", "y", "z"], [IDS, *DEGREES.T, *(1e3 * POINTS).T])
UNITS = ",deg,deg,deg,deg,deg,deg,mm,mm,mm\n"
SUMMARY = "\n".join(
    ",".join([word, *(f"{v:.3f}" for v in np.hstack([DEGREES, 1e3 * POINTS]).mean(axis=0))])
    for word in ("mean", "Standardabweichung", "Max")
)


@pytest.mark.parametrize(
    "content",
    [
        "Robot 7\nDate: 2024-05-01\n\n" + TABLE,
        ",robot,,,,,,tracker,,\n" + TABLE,
        ",robot,,,,,,tracker,,\n" + TABLE.replace("z\n", "z\n" + UNITS, 1),
        "# cell 3\n# operator AB\n" + TABLE,
        TABLE + SUMMARY + "\n",
        text(
            [
                "Messung",
                *(f"Achse {i} [Grad]" for i in range(1, 7)),
                "Rechtswert [mm]",
                "Hochwert [mm]",
                "Höhe [mm]",
            ],
            [IDS, *DEGREES.T, *(1e3 * POINTS).T],
            ";",
            ",",
        ),
        text(
            ["poloha", *(f"kloub{i} [°]" for i in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"],
            [IDS, *DEGREES.T, *(1e3 * POINTS).T],
            ";",
            ",",
        ),
        text(
            [
                "numéro",
                *(f"axe{i} (degrés)" for i in range(1, 7)),
                "X mesuré (mm)",
                "Y mesuré (mm)",
                "Z mesuré (mm)",
            ],
            [IDS, *DEGREES.T, *(1e3 * POINTS).T],
            ";",
            ",",
        ),
        text(
            [
                "pose",
                *NAMES,
                "X_nom",
                "Y_nom",
                "Z_nom",
                "X_meas",
                "Y_meas",
                "Z_meas",
                "dX",
                "dY",
                "dZ",
            ],
            [IDS, *DEGREES.T, *(1e3 * POINTS + 0.3).T, *(1e3 * POINTS).T, *np.full((3, N), -0.3)],
        ),
    ],
    ids=[
        "titles",
        "groups",
        "units",
        "comments",
        "summary",
        "German",
        "Czech",
        "French",
        "nominal",
    ],
)
def test_what_stands_around_the_readings_is_recognised(tmp_path: Path, content: str) -> None:
    made = begun(tmp_path, content)
    assert made.dataset.poses == tuple(IDS)
    assert np.allclose(made.dataset["J2"], JOINTS[:, 1], atol=1e-6)
    assert np.allclose(made.dataset["x"], POINTS[:, 0], atol=1e-6)
