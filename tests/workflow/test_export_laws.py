"""Exports of every machine: advice that holds; source, masses and limits of the project's file."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

import loopcal as lc
from loopcal.companions.robot.exports.registry import EXPORTS
from loopcal.errors import InputError
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import new_project
from tests.refusals import refused

INERTIAL = """<inertial><origin xyz="0.01 -0.02 0.3" rpy="0.1 0.2 -0.3"/><mass value="{mass}"/>
<inertia ixx="0.3" iyy="0.4" izz="0.5" ixy="0.01" ixz="-0.02" iyz="0.03"/></inertial>"""

ARMS = ("serial", "exponentials", "urdf")
KINDS = (*ARMS, "planar-two-link", "linear-delta")
"""With and without a chain, a URDF and outputs."""


def result_of(kind: str, folder: Path) -> Path:
    """The folder of a quick calibration of a template."""
    project = folder / kind / "project.toml"
    if not (folder / f"{kind}-result").exists():
        new_project(str(folder / kind), kind)
        text = re.sub(r"(?m)^poses = \d+", "poses = 25", project.read_text("utf-8"))
        project.write_text(text, "utf-8")
        run_simulation(project, out=folder / kind / "poses.csv", seed=1)
        request = Request(method="least-squares", report=False)
        run_calibration(project, request, out=folder / f"{kind}-result")
    return folder / f"{kind}-result"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("laws")


@pytest.mark.parametrize("kind", KINDS)
def test_advice_names_only_formats_that_take_this_machine(kind: str, folder: Path) -> None:
    result = result_of(kind, folder)
    made, advised = set(), {}
    for name in EXPORTS:
        try:
            lc.export(result, name)
            made.add(name)
        except InputError as error:
            advised[name] = {one for one in EXPORTS if f"'{one}'" in (error.remedy or "")}
    assert "json" in made
    assert all(its == made for its in advised.values()), advised


def test_an_own_function_is_advised_too() -> None:
    line = lc.Mechanism.from_function(
        lambda q, p: (p["a"] * q["x"] - q["y"],),
        quantities={"x": "m", "y": "m"},
        parameters={"a": (1.0, "1")},
        outputs=("y",),
    )
    x = np.linspace(0.0, 1.0, 20)
    result = lc.calibrate(line, {"x": x, "y": 1.1 * x}, noise=lc.Noise({"*": 1e-3}))
    for name in set(EXPORTS) - {"json"}:
        with refused("unsupported", "'json'"):
            lc.export(result, name)


def test_the_source_is_the_file_that_the_project_names(folder: Path) -> None:
    """Also where the result lies elsewhere, and after both were moved."""
    result = result_of("urdf", folder)
    assert set(lc.export(result, "urdf").files) == {"robot.urdf"}
    moved = folder / "moved"
    shutil.copytree(folder / "urdf", moved / "urdf")
    shutil.copytree(result, moved / result.name)
    (moved / "urdf" / "robot.urdf").rename(moved / "urdf" / "other.urdf")
    with refused("missing-key", "--source"):
        lc.export(moved / result.name, "urdf")
    stated = lc.export(moved / result.name, "urdf", source=moved / "urdf" / "other.urdf")
    assert set(stated.files) == {"other.urdf"}


def weighing(folder: Path, text: str) -> Path:
    """The URDF of the template with other text, calibrated."""
    (folder / "arm").mkdir(parents=True)
    shutil.copytree(folder.parent / "urdf", folder / "arm", dirs_exist_ok=True)
    (folder / "arm" / "robot.urdf").write_text(text)
    out = folder / "arm-result"
    request = Request(method="least-squares", report=False)
    run_calibration(folder / "arm" / "project.toml", request, out=out)
    return out


@pytest.fixture(scope="module")
def heavy(folder: Path) -> Path:
    """A robot whose moving links all weigh, the tool behind a fixed joint too."""
    result_of("urdf", folder)
    text = (folder / "urdf" / "robot.urdf").read_text()
    for i, link in enumerate([*(f"link_{n}" for n in range(1, 7)), "tool0"], 1):
        inertial = INERTIAL.format(mass=1.5 * i)
        assert f'<link name="{link}"/>' in text
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{inertial}</link>')
    return weighing(folder / "heavy", text)


def mujoco_model(result: Path) -> tuple[Any, Any]:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (make partners)")
    model = mujoco.MjModel.from_xml_string(lc.export(result, "mjcf").files["robot.xml"].decode())
    return mujoco, model


def test_mjcf_has_masses_and_limits_of_the_source(heavy: Path) -> None:
    """Centre of mass and inverse dynamics are those of MuJoCo's own reading of the patched URDF."""
    mujoco, ours = mujoco_model(heavy)
    patched = lc.export(heavy, "urdf").files["robot.urdf"].decode()
    theirs = mujoco.MjModel.from_xml_string(patched)
    assert ours.body_subtreemass[0] == pytest.approx(1.5 * sum(range(1, 8)))
    assert np.array_equal(ours.jnt_limited, theirs.jnt_limited)
    np.testing.assert_allclose(ours.jnt_range, theirs.jnt_range)
    rng = np.random.default_rng(2)
    for _ in range(5):
        moved, seen = rng.uniform(-1.0, 1.0, (3, 6)), []
        for model in (ours, theirs):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:], data.qacc[:] = moved
            mujoco.mj_inverse(model, data)
            seen.append((data.subtree_com[0], data.qfrc_inverse))
        for mine, its in zip(*seen, strict=True):
            np.testing.assert_allclose(mine, its, rtol=1e-6, atol=1e-8)
    assert not any("mass" in words for words in lc.export(heavy, "mjcf").warnings)


def test_sdf_has_masses_and_limits_of_the_source(heavy: Path) -> None:
    done = lc.export(heavy, "sdf")
    root = etree.fromstring(done.files["robot.sdf"])
    masses = [float(one.text) for one in root.iter("mass")]
    assert masses == [1.5 * i for i in range(1, 8)]
    lows = [float(one.text) for one in root.iter("lower")]
    assert lows[:2] == [-2.9, -1.1]
    assert b"1e16" not in done.files["robot.sdf"]
    links = {one.get("name") for one in root.iter("link")}
    assert {one.text for tag in ("parent", "child") for one in root.iter(tag)} <= links


@pytest.mark.parametrize("kind", ["urdf", "serial", "exponentials"])
def test_what_no_source_states_is_left_out_and_said(kind: str, folder: Path) -> None:
    result = result_of(kind, folder)
    _, model = mujoco_model(result)
    assert model.nv > 0
    for name in ("mjcf", "sdf"):
        done = lc.export(result, name)
        (text,) = done.files.values()
        assert b'mass="1"' not in text
        assert b"1e16" not in text
        assert any("mass" in words for words in done.warnings)
        free = any("limits" in words for words in done.warnings)
        assert free == (text.count(b"range=") + text.count(b"<lower>") < model.njnt)


def test_inertia_that_no_body_has_is_left_out(heavy: Path, folder: Path) -> None:
    text = (heavy.parent / "arm" / "robot.urdf").read_text()
    odd = weighing(folder / "odd", text.replace('ixx="0.3"', 'ixx="9.3"', 1))
    assert mujoco_model(odd)[1].nv == 6
    assert any("'joint_1'" in words for words in lc.export(odd, "mjcf").warnings)
