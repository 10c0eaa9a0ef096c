"""Exports of every robot of the description packages, against independent programs.

    python -m analyses.exports [--poses 1000]

Of each URDF of example-robot-data and rtb-data the longest chain is perturbed by 1 mm and 1 mrad,
exported, and moved by Pinocchio, with zero offsets in the origins and apart. Printed per robot: the
largest difference of any entry of the pose [m, 1], MuJoCo's of the MJCF, Drake's of the SDF, and
whether `check_urdf` accepts the file. Asserted: bytes outside <origin> are the same, and a second
export is the first. Robots that a program cannot read by itself are named.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.companions.robot.exports.format import ExportOptions
from loopcal.companions.robot.exports.simulators import mjcf, sdf
from loopcal.companions.robot.exports.urdf import UrdfSource
from loopcal.document.exported import Exported
from loopcal.errors import InputError
from loopcal.files.machines.urdf import Branch, branches, read_urdf
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.origins import calibrated_origins, joint_chain
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rest import RestChain, rest_chain

Array = NDArray[np.float64]
FOLDERS = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data/robots",
    "rtb-data": "rtbdata/xacro",
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, default=1000)
    poses = parser.parse_args().poses
    done, worst = 0, 0.0
    for path in files():
        try:
            chains = branches(path)
        except InputError as error:
            print(f"{path.name}: {error.message}")
            continue
        if not chains:
            print(f"{path.name}: nothing moves")
            continue
        try:
            largest = [one_robot(path, chains, poses, apart=apart) for apart in (False, True)]
        except ValueError as error:
            print(f"{path.name}: {str(error).splitlines()[0]}")
            continue
        print(
            f"{path.name}: {max(largest):.1e}, {mujoco_says(path, chains, poses)}, "
            f"{drake_says(path, chains, poses)}, {checked(path, chains)}"
        )
        done, worst = done + 1, max(worst, *largest)
    print(f"{done} robots, {poses} poses each; largest difference {worst:.1e}")


def files() -> list[Path]:
    """The URDFs of the packages that are installed."""
    found: list[Path] = []
    for package, folder in FOLDERS.items():
        try:
            found += Path(str(distribution(package).locate_file(folder))).rglob("*.urdf")
        except PackageNotFoundError:
            print(f"{package} is not installed")
    return sorted(found)


def longest(chains: Sequence[Branch]) -> Branch:
    return max(chains, key=lambda b: (len(b.joints), b.leaf))


def machine(
    path: Path, chains: Sequence[Branch], *, apart: bool
) -> tuple[Branch, Machine, RestChain, Exported]:
    branch = longest(chains)
    joints = read_urdf(path, branch.base, branch.tip)
    made = joint_chain(joints)
    rng = np.random.default_rng(0)
    values = {n: p.nominal + 1e-3 * rng.normal() for n, p in made.parameters.items()}
    origins = calibrated_origins(joints, values, axes=False, apart=apart)
    chain = rest_chain(made.chain, values)
    return branch, made, chain, Exported("robot", chain, origins, (), values)


def one_robot(path: Path, chains: Sequence[Branch], poses: int, *, apart: bool) -> float:
    import pinocchio as pin

    branch, made, chain, exported = machine(path, chains, apart=apart)
    patched = UrdfSource.of(path).patched(exported.origins).content
    origins = re.compile(rb"<origin[^>]*?/?>")
    assert origins.sub(b"", patched) == origins.sub(b"", path.read_bytes()), path
    with tempfile.TemporaryDirectory() as folder:
        new = Path(folder) / path.name
        new.write_bytes(patched)
        assert UrdfSource.of(new).patched(exported.origins).content == patched, path
        model = pin.buildModelFromUrdf(str(new), mimic=True)
    data = model.createData()
    bottom, top = (model.getFrameId(link) for link in (branch.base, branch.tip))
    offsets = {one.joint.name: one.offset for one in exported.origins}
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(poses):
        q = {n: rng.uniform(-3.0, 3.0) for n in made.quantities}
        v = pin.neutral(model)
        for name, reading in q.items():
            joint, value = model.joints[model.getJointId(name)], reading + offsets.get(name, 0.0)
            own = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
            v[joint.idx_q : joint.idx_q + joint.nq] = own
        pin.framesForwardKinematics(model, data, v)
        found = (data.oMf[bottom].inverse() * data.oMf[top]).homogeneous
        worst = max(worst, float(np.abs(found - chain.pose(q)).max()))
    return worst


def mujoco_says(path: Path, chains: Sequence[Branch], poses: int) -> str:
    try:
        import mujoco
    except ImportError:
        return "MuJoCo is not installed"
    _, made, chain, exported = machine(path, chains, apart=False)
    model = mujoco.MjModel.from_xml_string(str(mjcf(exported, ExportOptions()).files["robot.xml"]))
    data = mujoco.MjData(model)

    def moved(joints: Mapping[str, float]) -> Array:
        for name, value in joints.items():
            data.joint(name).qpos[:] = value
        mujoco.mj_kinematics(model, data)
        site = data.site("tip")
        return rigid(site.xmat.reshape(3, 3), site.xpos)

    return f"MuJoCo {largest_difference(made, chain, moved, poses):.1e}"


def drake_says(path: Path, chains: Sequence[Branch], poses: int) -> str:
    try:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant
    except ImportError:
        return "Drake is not installed"
    _, made, chain, exported = machine(path, chains, apart=False)
    plant = MultibodyPlant(0.0)
    text = sdf(exported, ExportOptions()).files["robot.sdf"]
    Parser(plant).AddModelsFromString(str(text), "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    base, tip = plant.GetFrameByName("base"), plant.GetFrameByName("tip")

    def moved(joints: Mapping[str, float]) -> Array:
        positions = plant.GetPositions(context)
        for name, value in joints.items():
            positions[plant.GetJointByName(name).position_start()] = value
        plant.SetPositions(context, positions)
        return np.array(plant.CalcRelativeTransform(context, base, tip).GetAsMatrix4())

    return f"Drake {largest_difference(made, chain, moved, poses):.1e}"


def largest_difference(
    made: Machine, chain: RestChain, moved: Callable[[Mapping[str, float]], Array], poses: int
) -> float:
    """Of the poses of a program that commands every joint, also those that follow others."""
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(poses):
        q = {n: rng.uniform(-3.0, 3.0) for n in made.quantities}
        own = {j.name: 1.0 if j.name == j.reads else abs(j.factor) for j in chain.joints}
        joints = {j.name: own[j.name] * q[j.reads] for j in chain.joints}
        worst = max(worst, float(np.abs(moved(joints) - chain.pose(q)).max()))
    return worst


def checked(path: Path, chains: Sequence[Branch]) -> str:
    program = shutil.which("check_urdf", path=str(Path(sys.executable).parent))
    if program is None:
        return "check_urdf is not installed"
    *_, exported = machine(path, chains, apart=False)
    says = []
    with tempfile.TemporaryDirectory() as folder:
        new = Path(folder) / path.name
        new.write_bytes(UrdfSource.of(path).patched(exported.origins).content)
        for file in (path, new):
            says.append(subprocess.run([program, file], capture_output=True).returncode == 0)
    return (
        "check_urdf accepts both" if all(says) else f"check_urdf: before {says[0]}, after {says[1]}"
    )


if __name__ == "__main__":
    main()
