"""A camera goes into ROS, Kalibr, OpenCV, easy_handeye and a URDF as it was calibrated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.robot.exports.format import ExportOptions
from loopcal.companions.robot.exports.registry import format_named
from loopcal.document.exported import Exported
from loopcal.document.fit import ParameterEntry
from loopcal.files.cameras.document import read_document, transform
from loopcal.files.cameras.intrinsics import read_intrinsics, read_rig
from loopcal.files.machines.urdf import read_urdf
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.chain import fixed_frame, product
from loopcal.mechanisms.origins import calibrated_origins
from loopcal.mechanisms.parameters import Role
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.station import Station
from tests.refusals import refused

EYE = Intrinsics("brown5", 1352.0, 1356.5, 789.7, 627.3, (-0.2, 0.06, 1e-3, -8e-4, 0.0))
PLACE = {"x": 0.03, "y": -0.05, "z": 0.1, "rz": -1.55, "ry": 0.02, "rx": -0.03}
URDF = """<robot name="arm">
  <link name="world"/> <link name="base"/> <link name="arm"/> <link name="tool0"/>
  <link name="camera_link"/> <link name="eye_optical_frame"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0.5 0 1"/></joint>
  <joint name="j1" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="tool" type="fixed"><parent link="arm"/><child link="tool0"/>
    <origin xyz="0 0 0.4" rpy="0 1.5 0"/></joint>
  <joint name="mount" type="fixed"><parent link="{on}"/><child link="camera_link"/>
    <origin xyz="0.1 0 0"/></joint>
  <joint name="optics" type="fixed"><parent link="camera_link"/><child link="eye_optical_frame"/>
    <origin xyz="0 0.015 0" rpy="-1.5707963267948966 0 -1.5707963267948966"/></joint>
</robot>
"""


def machine(role: Role, cameras: tuple[str, ...] = ("eye",), lens: Intrinsics = EYE) -> Exported:
    """A machine with cameras on the flange ("mounting") or beside it ("placement")."""
    entries, values = [], {}
    numbers_of: dict[Role, dict[str, float]] = {role: PLACE, "lens": lens.values}
    for i, name in enumerate(cameras):
        for of, numbers in numbers_of.items():
            for key, value in numbers.items():
                value += 0.1 * i if key == "x" else 0.0
                full = f"{name}_{key}"
                entries.append(
                    ParameterEntry(
                        full,
                        "1",
                        0.0,
                        value,
                        None,
                        None,
                        False,
                        True,
                        None,
                        role=of,
                        owner=name,
                    )
                )
                values[full] = value
    return Exported("arm", None, (), tuple(entries), values)


def files(name: str, exported: Exported, folder: Path, source: Path | None = None) -> list[Path]:
    done = format_named(name).write(exported, ExportOptions(source=source))
    for file, content in done.files.items():
        assert isinstance(content, str)
        (folder / file).write_text(content, "utf-8")
    return [folder / file for file in done.files]


def place() -> np.ndarray:
    """The six numbers of the station as a motion."""
    return product(Station("eye").steps, {}, {f"eye_{key}": v for key, v in PLACE.items()})


def test_opencv_and_ros_get_the_intrinsics(tmp_path: Path) -> None:
    (path,) = files("opencv", machine("placement"), tmp_path)
    assert read_intrinsics(path)["camera"] == EYE
    with refused("missing-key", "image"):
        files("camera_info", machine("placement"), tmp_path)
    sizes = tmp_path / "before.yaml"
    sizes.write_text("{fx: 1, fy: 1, cx: 0, cy: 0, width: 1600, height: 1200}", "utf-8")
    (path,) = files("camera_info", machine("placement"), tmp_path, sizes)
    one = read_intrinsics(path)["eye"]
    assert (one.image, one.values) == ((1600, 1200), EYE.values)


@pytest.mark.parametrize("role", ["placement", "mounting"])
def test_easy_handeye_gets_the_place_of_the_camera(role: Role, tmp_path: Path) -> None:
    (path,) = files("easy_handeye", machine(role), tmp_path)
    one = read_document(path)
    on_hand = one.part("parameters").part("eye_on_hand").flag
    assert on_hand == (role == "mounting") == path.name.endswith("on_hand.yaml")
    # Beside the robot the parameters are the place of the base in the camera.
    expected = place() if on_hand else inverse(place())
    np.testing.assert_allclose(transform(one.part("transformation")), expected, atol=1e-14)


@pytest.mark.parametrize("role", ["placement", "mounting"])
def test_kalibr_gets_the_cameras_beside_each_other(role: Role, tmp_path: Path) -> None:
    sizes = tmp_path / "before.yaml"
    sizes.write_text("{fx: 1, fy: 1, cx: 0, cy: 0, width: 6, height: 4}", "utf-8")
    (path,) = files("camchain", machine(role, ("eye", "right")), tmp_path, sizes)
    rig = read_rig(path)
    assert [one.values for one in rig.cameras.values()] == [EYE.values] * 2
    second = place()
    second[0, 3] += 0.1
    expected = second @ inverse(place()) if role == "placement" else inverse(second) @ place()
    np.testing.assert_allclose(rig.T_camera_first["cam1"], expected, atol=1e-14)


def test_the_largest_lens_is_exported_whole(tmp_path: Path) -> None:
    fisheye = Intrinsics("fisheye", 400.0, 400.0, 3.0, 2.0, (-0.03, 0.01, -0.004, 6e-4))
    (path,) = files("opencv", machine("placement", lens=fisheye), tmp_path)
    assert read_intrinsics(path)["camera"] == fisheye


def test_ros_gets_the_optical_frame_as_a_static_transform(tmp_path: Path) -> None:
    (path,) = files("tf", machine("mounting"), tmp_path)
    words = path.read_text("utf-8").replace('"', " ").split()
    stated = {word[2:]: words[i + 1] for i, word in enumerate(words) if word.startswith("--")}
    assert (stated["frame-id"], stated["child-frame-id"]) == ("flange", "eye_optical_frame")
    assert float(stated["x"]) == PLACE["x"]


@pytest.mark.parametrize(("role", "on"), [("mounting", "tool0"), ("placement", "world")])
def test_the_optical_frame_of_a_urdf_stands_where_it_was_calibrated(
    role: Role, on: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.urdf").write_text(URDF.format(on=on), "utf-8")
    joints = read_urdf(tmp_path / "arm.urdf", "base", "tool0")
    drawn = {p.name: p.nominal for joint in joints for p in joint.origin}
    origins = calibrated_origins(joints, drawn | {"tool_x": 0.002}, axes=False, apart=False)
    bare = machine(role)
    exported = Exported("arm", None, origins, bare.parameters, bare.values)
    done = format_named("urdf").write(exported, ExportOptions(source=tmp_path / "arm.urdf"))
    content = done.files["arm.urdf"]
    assert isinstance(content, bytes)
    (tmp_path / "new.urdf").write_bytes(content)
    assert done.warnings == ()
    if role == "mounting":
        T = fixed(tmp_path / "new.urdf", "tool0")
        np.testing.assert_allclose(T, place(), atol=1e-12)
    else:
        T = inverse(product(fixed_frame((0.5, 0.0, 1.0), (0.0, 0.0, 0.0)), {}, {}))
        np.testing.assert_allclose(
            T @ fixed(tmp_path / "new.urdf", "world"), inverse(place()), atol=1e-12
        )
    assert 'xyz="0 0.015 0"' in content.decode()
    again = format_named("urdf").write(exported, ExportOptions(source=tmp_path / "new.urdf"))
    assert again.files["new.urdf"] == content


def fixed(path: Path, holder: str) -> np.ndarray:
    """The place of the optical frame in a link that it hangs on by fixed joints."""
    from lxml import etree

    T, link = np.eye(4), "eye_optical_frame"
    root = etree.parse(path).getroot()
    while link != holder:
        (joint,) = (j for j in root.iter("joint") if j.find("child").get("link") == link)
        origin = joint.find("origin")
        xyz, rpy = (tuple(map(float, origin.get(key, "0 0 0").split())) for key in ("xyz", "rpy"))
        T = product(fixed_frame(xyz, rpy), {}, {}) @ T
        link = joint.find("parent").get("link")
    return T


def test_a_urdf_without_the_frame_says_so(tmp_path: Path) -> None:
    for text, word in (
        (URDF.format(on="tool0").replace("eye_optical_frame", "lens"), "'eye_optical_frame'"),
        (URDF.format(on="base"), "fixed joints"),
    ):
        (tmp_path / "arm.urdf").write_text(text, "utf-8")
        joints = read_urdf(tmp_path / "arm.urdf", "base", "tool0")
        drawn = {p.name: p.nominal for joint in joints for p in joint.origin}
        bare = machine("mounting")
        origins = calibrated_origins(joints, drawn, axes=False, apart=False)
        exported = Exported("arm", None, origins, bare.parameters, bare.values)
        done = format_named("urdf").write(exported, ExportOptions(source=tmp_path / "arm.urdf"))
        assert word in done.warnings[0]
        assert done.files["arm.urdf"] == text.encode()
