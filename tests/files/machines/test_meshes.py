"""Meshes of links: what the files of three kinds say, and where a pose puts them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.machines import meshes
from loopcal.files.machines.meshes import box, mesh_file, read_links, read_mesh, simplified
from tests.mechanisms.test_branches import JOINTS, dual_arm
from tests.refusals import refused

BOX = box((0.2, 0.4, 0.6))


def _stl(triangles: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *one.ravel(), 0) for one in triangles)
    return b"solid by chance".ljust(80) + struct.pack("<I", len(triangles)) + rows


def _plain_stl(triangles: np.ndarray) -> bytes:
    lines = ["solid box"]
    for one in triangles:
        corners = "\n".join(f"vertex {x} {y} {z}" for x, y, z in one)
        lines.append(f"facet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet")
    return "\n".join([*lines, "endsolid box"]).encode()


def _obj(triangles: np.ndarray) -> bytes:
    lines = ["# corners, then faces that count from the end"]
    for a, b, c in triangles:
        lines += [f"v {x} {y} {z}" for x, y, z in (a, b, c)] + ["f -3/1/1 -2/1/1 -1/1/1"]
    return "\n".join(lines).encode()


def _dae(triangles: np.ndarray) -> bytes:
    """In millimetres, its node turned about x and moved, as a polylist of triangles.

    Its axis up is not followed, as by RViz (rviz/mesh_loader.cpp, "Don't convert to y-up").
    """
    x, y, z = 1e3 * triangles.reshape(-1, 3).T
    # What a turn by -90 degrees about x and a shift by 1 mm along it bring to the corners.
    inside = np.column_stack([x - 1.0, -z, y])
    text = " ".join(f"{v}" for v in inside.ravel())
    index = " ".join(f"{i} 0" for i in range(len(inside)))
    count = " ".join(["3"] * len(triangles))
    inputs = "".join(
        f'<input semantic="{kind}" source="#{source}" offset="{i}"/>'
        for i, (kind, source) in enumerate([("VERTEX", "v"), ("NORMAL", "p")])
    )
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.001"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{inside.size}">{text}</float_array><technique_common>
<accessor source="#a" count="{len(inside)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{len(triangles)}">{inputs}<vcount>{count}</vcount><p>{index}</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node>
<rotate>1 0 0 -90</rotate><translate>1 0 0</translate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene>
</COLLADA>""".encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", _stl(BOX)),
        ("b.STL", _plain_stl(BOX)),
        ("c.obj", _obj(BOX)),
        ("d.dae", _dae(BOX)),
    ],
)
def test_each_kind_of_file_holds_the_same_box(tmp_path: Path, name: str, content: bytes) -> None:
    if name.endswith(".dae"):
        pytest.importorskip("collada")
    (tmp_path / name).write_bytes(content)
    assert read_mesh(tmp_path / name) == pytest.approx(BOX, abs=1e-7)


def test_a_node_of_a_library_is_followed_and_a_lacking_material_hides_nothing(
    tmp_path: Path,
) -> None:
    # As SketchUp writes nodes, and as one foot of a published robot names its materials.
    pytest.importorskip("collada")
    (tmp_path / "d.dae").write_bytes(
        _dae(BOX)
        .replace(b'<instance_geometry url="#g"/>', b'<instance_node url="#n"/>')
        .replace(
            b"<library_visual_scenes>",
            b'<library_nodes><node id="n"><instance_geometry url="#g"><bind_material>'
            b'<technique_common><instance_material symbol="a" target="#b"/></technique_common>'
            b"</bind_material></instance_geometry></node></library_nodes><library_visual_scenes>",
        )
    )
    assert read_mesh(tmp_path / "d.dae") == pytest.approx(BOX, abs=1e-7)


@pytest.mark.parametrize("name", ["x.stl", "x.obj", "x.dae", "x.glb"])
def test_what_is_no_mesh_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"v 1 2\nf 1 2 9\nvertex nan 0 0")
    with refused("wrong-file-type"):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b'<instance_geometry url="#g"/>', b'<instance_geometry url="#g"/>' * 9, "too many"),
        (b"<vcount>3 3", b"<vcount>3 999999999", "polygons"),
        (b"<vcount>3 3", b"<vcount>-3 9", "polygons"),
    ],
)
def test_a_small_file_does_not_make_a_large_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: bytes, new: bytes, why: str
) -> None:
    pytest.importorskip("collada")
    monkeypatch.setattr(meshes, "MOST_TRIANGLES", 100)
    (tmp_path / "d.dae").write_bytes(_dae(BOX).replace(old, new))
    with refused("wrong-file-type", why):
        read_mesh(tmp_path / "d.dae")


def test_a_shape_without_a_size_is_left_out(tmp_path: Path) -> None:
    links = (
        '<link name="a"><visual><geometry><cylinder/></geometry></visual></link><link name="b"/>'
    )
    joint = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/></joint>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{links}{joint}</robot>', "utf-8")
    drawn = read_links(tmp_path / "r.urdf")
    assert drawn is not None
    assert drawn.absent == ("the shape of a",)


def test_the_longest_end_of_a_path_is_taken_and_none_outside_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "cell"
    (folder / "meshes").mkdir(parents=True)
    for file in (folder / "base.stl", folder / "meshes/base.stl", tmp_path / "out.stl"):
        file.write_bytes(_stl(BOX))
    (folder / "link.stl").symlink_to(tmp_path / "out.stl")
    assert mesh_file(folder, "package://arm/meshes/base.stl") == folder / "meshes/base.stl"
    assert mesh_file(folder, "file:///elsewhere/base.stl") == folder / "base.stl"
    for name in ("../out.stl", "package://arm/../../out.stl", "link.stl", "http://a/base.stl"):
        assert mesh_file(folder, name) is None


def test_a_simplified_mesh_keeps_its_extent(tmp_path: Path) -> None:
    fine = BOX
    for _ in range(5):  # each triangle becomes four
        a, b, c = fine[:, 0], fine[:, 1], fine[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        fine = np.concatenate([np.stack(part, axis=1) for part in parts])
    coarse = simplified(fine, 300)
    assert 100 < len(coarse) <= 300
    for end in (np.min, np.max):
        assert end(coarse, axis=(0, 1)) == pytest.approx(end(BOX, axis=(0, 1)), abs=0.1)


def test_links_stand_where_the_machine_puts_them(tmp_path: Path) -> None:
    path = dual_arm(tmp_path)
    shape = '<visual><geometry><mesh filename="package://twin/hand.stl"/></geometry></visual>'
    text = path.read_text("utf-8")
    for side in ("left", "right"):
        text = text.replace(f'<link name="{side}_hand">', f'<link name="{side}_hand">{shape}')
    path.write_text(text, "utf-8")
    nothing = read_links(path)
    assert nothing is not None
    assert nothing.absent == ("hand.stl", "hand.stl")
    assert not nothing.corners
    (tmp_path / "hand.stl").write_bytes(_stl(BOX))
    drawn = read_links(path)
    assert drawn is not None
    assert drawn.absent == ()
    rng = np.random.default_rng(1)
    q = dict(zip(JOINTS, rng.uniform(-1.0, 1.0, len(JOINTS)), strict=True))
    machine = lc.machines.tree(str(path), use=["left_hand", "right_hand"])
    at = drawn.placed({**q, "right_1": np.nan}).reshape(2, -1, 3).mean(axis=1)
    stand = {**q, "right_1": 0.0}  # a joint that is not read
    for side, middle in zip(("left", "right"), at, strict=True):
        T = machine.fk([stand[name] for name in machine.quantities], on=f"{side}_hand")
        assert middle == pytest.approx(T[:3, 3], abs=1e-6)
