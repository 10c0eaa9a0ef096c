"""Figures and table of a camera: sds of pixels by draws, boards by two ways, rms by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

import loopcal as lc
from loopcal.figures.images import ImagePlane, over_radius
from loopcal.mechanisms.cameras.lens import project
from loopcal.mechanisms.skeleton import body_poses
from loopcal.report.drawn import figures
from loopcal.report.images import (
    CameraView,
    _placed,
    camera_views,
    image_table,
    projection_sd,
)
from loopcal.report.page import report_html
from loopcal.report.source import Source, read_source
from loopcal.workflow.result import write_result
from tests.mechanisms.test_camera import LENS, POINTS, hands, mechanism, pixels, placed, readings

SD = 0.3
GONE = 5
"""Corners that the first image lacks, and two besides."""


@pytest.fixture(scope="module", params=["base", "body"])
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Source:
    """A calibration of one camera from simulated images, read back from the disk."""
    random = np.random.default_rng(8)
    T = hands(10, 2)
    uv = pixels(T, on=request.param) + random.normal(0.0, SD, (len(POINTS), 2, len(T)))
    uv[: GONE + 2, :, 0] = np.nan
    noise = lc.Noise({"[xyz]": 1e-4, "w?": 1e-4, "eye": SD})
    data = lc.Dataset.from_arrays(readings(T, uv))
    result = lc.calibrate(mechanism(request.param), data, noise=noise, method="implicit-loop")
    folder = tmp_path_factory.mktemp("camera") / "result"
    write_result(result, folder, title="camera", inputs={}, warnings=())
    return read_source(folder)


def view_of(source: Source) -> CameraView:
    (view,) = camera_views(source)
    return view


def test_the_sd_of_a_pixel_is_that_of_draws_of_place_and_lens(source: Source) -> None:
    view, on = view_of(source), "body" if view_of(source).on_body else "base"
    P = np.array([[0.1, -0.05, 1.0], [-0.2, 0.15, 0.8]])
    covariance = source.document.covariance
    random = np.random.default_rng(1)
    assert source.mechanism is not None
    nominal = np.array([source.mechanism.parameters[n].nominal for n in covariance.names])
    # A tenth of the sds: the figure's are of first order.
    draws = random.multivariate_normal(nominal, 1e-2 * np.array(covariance.matrix), 1500)
    six = [covariance.names.index(f"eye_{n}") for n in ("x", "y", "z", "rz", "ry", "rx")]
    lens = {k: covariance.names.index(f"eye_{k}") for k in LENS.values}

    def place(numbers: np.ndarray) -> np.ndarray:
        T = placed(tuple(numbers[six]))
        return np.linalg.inv(T) if on == "body" else T

    held = np.linalg.inv(place(nominal)) @ np.column_stack([P, np.ones(2)]).T
    seen = []
    for numbers in draws:
        X, Y, Z = (place(numbers) @ held)[:3]
        seen.append(project(LENS.lens, (X, Y, Z), {k: numbers[i] for k, i in lens.items()}))
    pixels_drawn = np.array(seen)
    most = [10.0 * np.sqrt(np.linalg.eigvalsh(np.cov(pixels_drawn[:, :, i].T))[-1]) for i in (0, 1)]
    assert projection_sd(source, view, P) == pytest.approx(most, rel=0.08)


def test_boards_stand_where_corners_alone_put_them(source: Source) -> None:
    view = view_of(source)
    blind = CameraView(**{**vars(view), "T": np.full_like(view.T, np.nan)})
    row = {p: i for i, p in enumerate(view.board.points)}
    alone = _placed(blind, np.array([row[p] for p in view.points]))
    full = np.bincount(view.image) == len(POINTS)
    off = np.abs(alone - view.T)[full, :3, 3]
    # 0.3 px at f = 900 px and 1 m: 0.3 mm across, some mm in depth.
    assert off.max() < 0.02
    assert np.median(np.abs(view.T[full, 2, 3])) > 0.3


def test_the_table_counts_corners_and_their_rms_by_image(source: Source) -> None:
    view, table = view_of(source), image_table(source)
    assert table is not None
    rows = {row[0]: row for row in table.rows}
    first = source.table.poses[0]
    assert rows[first][1] == str(len(POINTS) - GONE - 2)
    # 5 of 12 are less than half.
    assert rows[first][-1] == "few corners"
    squares = np.square(view.residuals[:, view.image == 3]).sum(axis=0)
    assert float(rows[source.table.poses[3]][2]) == pytest.approx(np.sqrt(squares.mean()), rel=5e-3)
    sizes = [float(row[2]) for row in table.rows]
    assert sizes == sorted(sizes, reverse=True)


def test_plotly_accepts_the_figures_and_the_page_holds_them(source: Source) -> None:
    drawn = figures(source)
    keys = ["scene", "image-eye", "radius-eye", "projection-eye"]
    assert [key for key in drawn if key in keys] == keys
    for key in keys:
        made = go.Figure(data=list(drawn[key].data), layout=dict(drawn[key].layout))
        assert len(made.data) == len(drawn[key].data)
    # Panels by camera, not by corner.
    assert {t["name"] for t in drawn["residuals"].data} == {"eye"}
    assert len(drawn["drift"].data) < 10
    assert 'id="images"' in report_html([source])


def test_the_lens_turns_back_where_its_radius_is_largest() -> None:
    view = CameraView(
        "eye",
        LENS.of("brown5", LENS.values | {"k1": -0.4, "k2": 0.0, "k3": 0.0, "p1": 0.0, "p2": 0.0}),
        (1280.0, 960.0),
        False,
        *(None,) * 7,  # type: ignore[arg-type]
    )
    r = np.linspace(0.0, 2.0, 20001)
    largest = 900.0 * (r * (1.0 - 0.4 * r**2)).max()
    assert view.plane.turns == pytest.approx(largest, rel=1e-6)
    assert f"{largest:.0f} px" in view.plane.words


def test_a_lens_error_shows_along_the_radius_and_a_turn_across_it() -> None:
    plane = ImagePlane("eye", (1000.0, 800.0), np.array([500.0, 400.0]))
    uv = np.random.default_rng(0).uniform([[0.0], [0.0]], [[1000.0], [800.0]], (2, 400))
    away = uv - plane.centre[:, None]
    along = over_radius(plane, uv, 1e-3 * away)
    across = over_radius(plane, uv, 1e-3 * np.array([-away[1], away[0]]))
    assert along is not None
    assert across is not None
    for figure, moved, still in ((along, 1, 3), (across, 3, 1)):
        assert max(map(abs, figure.data[moved]["y"])) > 0.3
        assert max(map(abs, figure.data[still]["y"])) < 1e-9


def test_poses_of_bodies_together_are_those_one_by_one(tmp_path: Path) -> None:
    T = hands(4, 5)
    table = readings(T, pixels(T, on="base"))
    table |= {f"w{a}": np.full(4, 0.01 * i) for i, a in enumerate("xyz")}
    together = body_poses(mechanism("base"), table)
    assert together is not None
    for i in range(4):
        alone = lc.machines.free_body().fk({k: v[i] for k, v in table.items()})
        assert together[i] == pytest.approx(alone, abs=1e-14)
