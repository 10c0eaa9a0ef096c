"""`init` of whole robots whose cameras see one point of each hand, and no board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.trees import ARM, HEADER, Limb, limb, placed, table
from loopcal.mechanisms.instruments.camera import before_lens
from tests.refusals import refused

Array = NDArray[np.float64]
POSES = 40
F, CENTRE = 1500.0, np.array([900.0, 700.0])
POINTS = {"l": np.array([0.03, -0.05, 0.08, 1.0]), "r": np.array([-0.06, 0.02, 0.05, 1.0])}
T_CAMERA_BASE = placed([0.1, 0.5, 2.4], [1.5, 0.1, -0.1])
LENS = f'{{"camera": {{"fx": {F}, "fy": {F}, "cx": {CENTRE[0]}, "cy": {CENTRE[1]}}}}}'


@dataclass(frozen=True)
class World:
    """Joints as read and exact pixels (POSES, 2) of a point of each hand; bodies as drawn."""

    limbs: dict[str, Limb]
    joints: dict[str, Array]
    pixels: dict[str, Array]
    folder: Path

    def write(self, name: str, columns: Mapping[str, Array | list[str]]) -> Path:
        path = self.folder / name
        path.write_text(table(columns), "utf-8")
        return path

    def begun(self, *files: Path, observe: list[str]) -> lc.InitialProject:
        return lc.init(*files, dh=self.folder / "bodies.csv", observe=observe)


@pytest.fixture
def world(tmp_path: Path) -> World:
    draw = np.random.default_rng(3)
    limbs: dict[str, Limb] = {}
    joints: dict[str, Array] = {}
    pixels: dict[str, Array] = {}
    lines = [HEADER]
    for side, at in (("l", 90.0), ("r", -90.0)):
        limbs[side], more = limb(side, (at, 0.4, 0.1), (*ARM[:4], (0.1, 0.15, 0)))
        lines += more
        q = draw.uniform(-0.9, 0.9, (POSES, 5))
        joints |= {name: q[:, i] for i, name in enumerate(limbs[side].joints)}
        P = (T_CAMERA_BASE @ limbs[side].hand(q) @ POINTS[side])[:, :3]
        assert P[:, 2].min() > 0.5
        pixels[side] = F * P[:, :2] / P[:, 2:] + CENTRE
    (tmp_path / "bodies.csv").write_text("\n".join(lines) + "\n", "utf-8")
    (tmp_path / "lens.json").write_text(LENS, "utf-8")
    return World(limbs, joints, pixels, tmp_path)


def columns_of(world: World) -> dict[str, Array]:
    return {f"{a}_{s}": world.pixels[s][:, i] for s in "lr" for i, a in enumerate("uv")}


def check(made: lc.InitialProject, boards: dict[str, str]) -> None:
    """Camera and points are where they are, and no pixel misses: nothing was disturbed."""
    begun = {p.name: p.nominal for p in made.mechanism.parameters}
    (eye,) = {name.removesuffix("_aspect") for name in begun if name.endswith("_aspect")}
    T = [begun[f"{eye}_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(T, T_CAMERA_BASE[:3, 3], atol=2e-3)
    for side, board in boards.items():
        at = [begun[f"{board}_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(at, POINTS[side][:3], atol=2e-3)
    off = made.mechanism.loop_values(made.dataset)
    assert np.nanmax(np.abs(list(off.values()))) < 0.5


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("unit", ["", " [px]"])
def test_a_point_has_columns_among_those_of_the_joints(
    world: World, apart: bool, unit: str
) -> None:
    pixels = {f"{name}{unit}": v for name, v in columns_of(world).items()}
    if apart:
        for side in "lr":
            of_arm = {n: v for n, v in world.joints.items() if n.startswith(side)}
            uv = {f"{a}{unit}": pixels[f"{a}_{side}{unit}"] for a in "uv"}
            world.write(f"{side}.csv", {**of_arm, **uv})
        files = [world.folder / "l.csv", world.folder / "r.csv"]
        seen = {"l": "columns=u,v file=l.csv", "r": "columns=u,v file=r.csv"}
    else:
        files = [world.write("both.csv", {**world.joints, **pixels})]
        seen = {side: f"columns=u_{side},v_{side}" for side in "lr"}
    observe = [f"camera name={side} sees={side}_5 {seen[side]}" for side in "lr"]
    made = world.begun(*files, world.folder / "lens.json", observe=observe)
    assert len(made.dataset) == (2 * POSES if apart else POSES)
    check(made, {"l": "l_board", "r": "r_board"})


@pytest.mark.parametrize("with_joints", [False, True])
def test_what_no_board_describes_is_a_point(world: World, with_joints: bool) -> None:
    """The joints stand in a table of their own under other names, or in every row."""
    ids = [f"p{k}" for k in range(POSES)]
    both: dict[str, Array | list[str]] = {"pose": ids * 2, "arm": ["l"] * POSES + ["r"] * POSES}
    uv = np.concatenate([world.pixels["l"], world.pixels["r"]])
    corners = {**both, "u_px": uv[:, 0], "v_px": uv[:, 1]}
    joints = ""
    if with_joints:
        repeated = {name: np.concatenate([v, v]) for name, v in world.joints.items()}
        files = [world.write("pixels.csv", {**corners, **repeated})]
    else:
        world.write("pixels.csv", corners)
        other = {name: f"{name}_rad".replace("l", "k") for name in world.joints}
        world.write("poses.csv", {"pose": ids, **{other[n]: v for n, v in world.joints.items()}})
        joints = " joints=" + ",".join(f"{n}:{o.removesuffix('_rad')}" for n, o in other.items())
        files = [world.folder / "pixels.csv", world.folder / "poses.csv"]
    observe = [f"camera name={s} on=base sees={s}_5 board={s}{joints}" for s in "lr"]
    made = world.begun(*files, world.folder / "lens.json", observe=observe)
    check(made, {"l": "l_board", "r": "r_board"})


def test_a_lens_that_nobody_states_is_adjusted(world: World) -> None:
    file = world.write("both.csv", {**world.joints, **columns_of(world)})
    observe = [f"camera name={s} sees={s}_5 columns=u_{s},v_{s}" for s in "lr"]
    made = world.begun(file, observe=observe)
    begun = {p.name: p.nominal for p in made.mechanism.parameters}
    assert begun["camera_1_f"] == pytest.approx(F, rel=0.01)


def test_two_columns_are_u_and_v(world: World) -> None:
    file = world.write("both.csv", {**world.joints, **columns_of(world)})
    with refused("wrong-shape", "4 columns are named"):
        world.begun(file, observe=["camera name=a sees=l_5 columns=u_l,v_l,u_r,v_r"])


def test_an_image_shows_what_is_before_the_lens(world: World) -> None:
    file = world.write("both.csv", {**world.joints, **columns_of(world)})
    lens = world.folder / "lens.json"
    made = world.begun(file, lens, observe=["camera name=l sees=l_5 columns=u_l,v_l"]).mechanism
    q = np.stack([world.joints[name] for name in world.limbs["l"].joints], axis=1)
    P = (T_CAMERA_BASE @ world.limbs["l"].hand(q) @ POINTS["l"])[:, :3]
    r = np.hypot(*P[:, :2].T) / P[:, 2]

    def seen(**values: float) -> NDArray[np.bool_]:
        parameters = made.parameters.with_nominal({f"camera_1_{k}": v for k, v in values.items()})
        machine = made.with_parameters(parameters)
        return before_lens(machine, machine.families[0], world.joints, POSES)

    assert seen().all()
    assert not seen(z=-T_CAMERA_BASE[2, 3]).any()
    middle = float(np.median(r))
    # r (1 + k1 r^2) turns back where 3 k1 r^2 = -1
    turning = seen(k1=-1.0 / (3.0 * middle**2))
    np.testing.assert_array_equal(turning, r < middle)
