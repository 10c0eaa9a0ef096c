"""One limb of a robot is exported and corrected as the arm that it is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import loopcal as lc
from loopcal.cli.run import main
from loopcal.companions.robot.arms import refuse_limbs
from loopcal.workflow.views import Limb
from tests.refusals import refused

ROWS = ((80, 400, 90), (450, 0, 0), (60, 0, 90), (0, 420, -90), (0, 0, 90), (0, 100, 0))
OF_ARM = """
[[mechanism.instrument]]
type = "point"
name = "SIDE_tracker"
on = "SIDE6"
station = "SIDE_station"
target = "SIDE_target"
readings = ["SIDEx", "SIDEy", "SIDEz"]
"""
STATED = """
[mechanism.parameters]
"[dao]_*" = { sd = 1, unit = "mm" }
"offset_*" = { sd = 1, unit = "mrad" }
"alpha_*" = { sd = 1, unit = "mrad" }
"*_target_x" = { value = 30, sd = 1, unit = "mm" }
"*_target_[yz]" = { value = 40, sd = 1, unit = "mm" }
[data]
file = "poses.csv"
[noise]
"?q?" = { sd = 30, unit = "urad" }
"[lr][xyz]" = { sd = 20, unit = "um" }
[fit]
method = "implicit-loop"
[simulation]
poses = 80
[simulation.truth]
offset_r2 = { value = 1.5, unit = "mrad" }
alpha_r3 = { value = 1.5688, unit = "rad" }
a_r2 = { value = 451.2, unit = "mm" }
d_r4 = { value = 419.1, unit = "mm" }
[simulation.ranges]
"""


def project(sides: str) -> str:
    """Of arms of six joints, each seen from a station of its own; the truth is of the right one."""
    bodies = [
        f'{{ name = "{side}{i}", parent = "{f"{side}{i - 1}" if i > 1 else "base"}", row = '
        f'{{ name = "{side}q{i}", form = "{"hayati" if i == 2 else "dh"}", a = {a / 1e3}, '
        + (f"d = {d / 1e3}, " if i != 2 else "")
        + f"alpha = {np.radians(alpha)} }} }},"
        for side in sides
        for i, (a, d, alpha) in enumerate(ROWS, 1)
    ]
    instruments = [OF_ARM.replace("SIDE", side) for side in sides]
    ranges = [f"{side}q{i} = {{ from = -1.4, to = 1.4 }}" for side in sides for i in range(1, 7)]
    head = ["schema = 1", '[mechanism]\ntype = "tree"\nbody = [', *bodies, "]"]
    return "\n".join([*head, *instruments, STATED, *ranges])


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> tuple[lc.Result, lc.Result]:
    """A robot of two arms, and its right arm alone, calibrated with the same readings."""
    folder = tmp_path_factory.mktemp("limb")
    results = []
    for name, sides in (("both", "lr"), ("right", "r")):
        path = folder / f"{name}.toml"
        path.write_text(project(sides), encoding="utf-8")
        if name == "both":
            poses = str(folder / "poses.csv")
            assert main(["simulate", str(path), "--seed", "1", "--out", poses]) == 0
        results.append(lc.calibrate(path))
    return results[0], results[1]


def targets(*names: str) -> dict[str, np.ndarray]:
    """Joints [rad] of ten targets."""
    rng = np.random.default_rng(3)
    return {name: rng.uniform(-1.2, 1.2, 10) for name in names}


def test_a_limb_is_exported_as_the_arm_alone(robots: tuple[lc.Result, lc.Result]) -> None:
    both, alone = robots
    limb, arm = lc.export(both.limb("r6"), "json").machine, lc.export(alone, "json").machine
    assert limb.chain is not None
    assert arm.chain is not None
    for q in (-1.0, 0.0, 0.7):
        at = {joint.reads: q for joint in arm.chain.joints}
        np.testing.assert_allclose(limb.chain.pose(at), arm.chain.pose(at), atol=1e-8)
    assert {placed.name for placed in limb.frames} == {placed.name for placed in arm.frames}
    reached, stated = limb.of("full"), arm.of("full")
    assert reached is not None
    assert stated is not None
    assert reached.measured is not None
    assert stated.measured is not None
    assert reached.measured.rms == pytest.approx(stated.measured.rms, rel=1e-6)


def test_a_limb_is_corrected_as_the_arm_alone(
    robots: tuple[lc.Result, lc.Result], tmp_path: Path
) -> None:
    both, alone = robots
    asked = targets(*(f"rq{i}" for i in range(1, 7)))
    limb, arm = both.limb("r6").correct(asked), lc.correct(alone, asked)
    assert arm.corrected.done.sum() > 7
    np.testing.assert_array_equal(limb.corrected.done, arm.corrected.done)
    done = arm.corrected.done
    np.testing.assert_allclose(
        limb.corrected.joints[done], arm.corrected.joints[done], rtol=0.0, atol=1e-7
    )
    q = np.stack([*asked.values()], axis=-1)
    np.testing.assert_allclose(both.limb("r6").fk(q), alone.fk(q), rtol=0.0, atol=1e-8)
    path = tmp_path / "targets.csv"
    rows = np.column_stack([np.arange(10), *asked.values()]).tolist()
    head = ",".join(["pose", *asked])
    lines = [f"{int(n)},{','.join(f'{v:.9f}' for v in joints)}" for n, *joints in rows]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    by_file = both.limb("r6").correct(path).corrected
    np.testing.assert_allclose(by_file.joints[done], arm.corrected.joints[done], rtol=0, atol=1e-6)
    before = np.linalg.norm(arm.corrected.before[done, :3], axis=1)
    assert before.min() > 1e-4


def test_several_limbs_are_named_where_one_is_meant(
    robots: tuple[lc.Result, lc.Result], tmp_path: Path
) -> None:
    both, alone = robots
    with refused("unsupported", "l6", "r6", "--limb"):
        lc.export(both, "dh")
    with refused("unsupported", "l6", "r6", "--limb"):
        lc.correct(both, targets("rq1"))
    with refused("unknown-name", "r6"):
        both.limb("r7").export("dh")
    assert {*both.limb("r6").export("dh").files} == {*lc.export(alone, "dh").files}
    # the example is the limb that was read most
    poses = both.poses
    assert poses is not None
    half = poses.with_readings({"rx": np.full(len(poses), np.nan)})
    for readings, most in ((half, "l6"), (poses.with_readings({"lx": half["rx"]}), "r6")):
        with refused("unsupported") as caught:
            refuse_limbs(both.machine, readings, "There are several")
        assert caught.value.options == ("--limb", most)


def test_a_limb_up_to_a_body_that_nothing_sees_is_exported(
    robots: tuple[lc.Result, lc.Result],
) -> None:
    """The wrist, before the body that carries the target."""
    both, _ = robots
    made = both.limb("r5").export("dh")
    chain = made.machine.chain
    assert chain is not None
    assert [joint.reads for joint in chain.joints] == [f"rq{i}" for i in range(1, 6)]


def test_joints_that_move_other_limbs_too_are_named(tmp_path: Path) -> None:
    path = tmp_path / "waist.toml"
    rows = (("w", "base"), ("l", "w"), ("r", "w"))
    bodies = [
        f'[[body]]\nname = "{n}"\nparent = "{p}"\nrow = {{ name = "q{n}", a = 0.3, alpha = 1 }}'
        for n, p in rows
    ]
    bodies.append('[[body]]\nname = "tip"\nparent = "r"\nfixed = true\nrow = { name = "tip" }')
    seen = '[[instrument]]\ntype = "point"\non = "tip"'
    path.write_text("\n".join(['schema = 1\ntype = "tree"', *bodies, seen]), encoding="utf-8")
    whole = SimpleNamespace(machine=lc.read_mechanism(path))
    assert Limb(whole, "tip").shared == ("qw",)
    assert Limb(whole, "r").shared == ("qw",)
    assert Limb(whole, "l").shared == ("qw",)


def test_the_region_names_the_instrument_whose_readings_are_least_sure(
    robots: tuple[lc.Result, lc.Result],
) -> None:
    both, alone = robots
    region = both.document.prediction
    assert region is not None
    assert region.region is not None
    worst = region.region.worst
    assert worst.instrument in ("l_tracker", "r_tracker")
    wide = {f"{side}q{i}": (-3.0, 3.0) for side in "lr" for i in range(1, 7)}
    for result, seen in ((both, True), (alone, False)):
        spans = {q: span for q, span in wide.items() if q in result.mechanism.joints}
        words = lc.verdict(result, region=spans).valid.words
        assert ("_tracker' sees it is" in words) == seen
