"""Trees of bodies: paths between any two, what observations determine, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from loopcal.mechanisms.bodies import Hanging, tree_machine
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.instruments.camera import camera
from loopcal.mechanisms.instruments.contact import contact, held_part, plane
from loopcal.mechanisms.instruments.inclinometer import inclinometer
from loopcal.mechanisms.instruments.length import distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.seen_plane import seen_plane
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.redundancy import fix_redundant
from loopcal.mechanisms.structure.structured import structured
from tests.refusals import refused


def limb(name: str, parent: str, joints: int, seed: int) -> list[Hanging]:
    """Bodies NAME0, NAME1, ... below each other, each turned about a general axis."""
    draw = np.random.default_rng(seed)
    made = []
    for i in range(joints):
        x, y, z = draw.uniform(-0.4, 0.4, 3).tolist()
        roll, pitch, yaw = draw.uniform(-1.0, 1.0, 3).tolist()
        axis = draw.normal(size=3)
        a, b, c = (axis / np.linalg.norm(axis)).tolist()
        joint = LinkJoint(f"q_{name}{i}", "revolute", (x, y, z), (roll, pitch, yaw), (a, b, c))
        made.append(Hanging(f"{name}{i}", parent, joint))
        parent = f"{name}{i}"
    return made


def arms(joints: int = 3) -> Machine:
    """Two arms on one base, whose hands are the last bodies."""
    bodies = [*limb("l", "base", joints, 1), *limb("r", "base", joints, 2)]
    return tree_machine(bodies, root="base")


def humanoid() -> Machine:
    """A waist of two joints that carries a head of two, and two arms of three."""
    waist = limb("w", "ground", 2, 3)
    limbs = (("h", 2), ("l", 3), ("r", 3))
    bodies = [b for i, (name, n) in enumerate(limbs) for b in limb(name, "w1", n, 4 + i)]
    return tree_machine([*waist, *bodies], root="ground")


def marker(name: str, on: str, against: str, target: str) -> Instrument:
    """The pose of a marker on one body, seen by a camera on another one."""
    columns = [f"{name}_{part}" for part in ("qw", "qx", "qy", "qz")]
    readings = [f"{name}_{axis}" for axis in "xyz"]
    return pose(
        name,
        on=on,
        against=against,
        readings=readings,
        columns=columns,
        target=target,
        station="eye",
    )


def seen(name: str, on: str) -> Instrument:
    """A reflector on a body, seen by the one tracker."""
    readings = [f"{name}_{axis}" for axis in "xyz"]
    return point(name, on=on, readings=readings, target=f"{name}_at", station="tracker")


def free(machine: Machine, looking: Sequence[Instrument]) -> int:
    """How many parameters these observations determine."""
    return len(fix_redundant(assemble(machine, looking)).parameters.free)


BOARD = {f"{i}": (0.03 * (i % 3), 0.03 * (i // 3), 0.0) for i in range(6)}


def eye(name: str, on: str, points: dict[str, tuple[float, float, float]]) -> Instrument:
    """Pixels that the head's camera sees of a hand: four parameters of a pinhole besides."""
    board = f"{name}_at"
    return camera(name, on="h1", sees=on, eye="eye", board=board, points=points, lens="pinhole")


LONE = {"0": (0.0, 0.0, 0.0)}
SIGHT = eye("left", "l2", BOARD)  # and four of the print
POINTS = [eye("left", "l2", LONE), eye("right", "r2", LONE)]

SEEING = (("a", "l2"), ("b", "r2"))

# R revolute joints on the paths and L leaves, stations among them, tied by poses: 4 R + 6 (L - 1);
# 3 fewer for a leaf of which a point alone is seen, and for each sight of a plane; 1 fewer where no
# length is read. Of turns alone each joint has 2 and a leaf 3; gravity does not show a turn about
# itself.
HEAD = [marker("left", "l2", "h1", "left_at"), marker("right", "r2", "h1", "right_at")]
GROUND = marker("wall", "ground", "h1", "wall_at")


@pytest.mark.parametrize(
    ("machine", "looking", "rank"),
    [
        (arms(), [marker("a", "l2", "r2", "a_at")], 4 * 6 + 6),
        (arms(), [point("a", on="l2", against="r2", target="a_at", station="eye")], 4 * 6 + 3),
        (arms(), [distance("a", on="l2", against="r2")], 4 * 6),
        (arms(), [contact("a", between=("l2", "r2"), radius=(0.058, 0.058))], 4 * 6),
        (arms(), [seen("a", "l2"), seen("b", "r2")], 4 * 6 + 12 - 6),
        (humanoid(), HEAD[:1], 4 * 5 + 6),
        (humanoid(), HEAD, 4 * 8 + 12),
        (humanoid(), [*HEAD, GROUND], 4 * 10 + 18),
        (arms(), [plane("a", on="l2", target="ball")], 4 * 3 + 6 - 3 - 3 - 1),
        (arms(), [plane("a", on="l2", against="r2", target="ball")], 4 * 6 + 6 - 3 - 3 - 1),
        (arms(), [seen_plane("a", on="l2")], 4 * 3 + 6 - 3),
        (arms(), [seen_plane("a", on="l2", against="r2")], 4 * 6 + 6 - 3),
        (arms(), [seen_plane(a, on=on, plane="wall") for a, on in SEEING], 4 * 6 + 12 - 6),
        (arms(), [inclinometer("a", on="l2")], 2 * 3 + 3 - 1),
        (humanoid(), [SIGHT], 4 * 5 + 6 + 4 + 4),
        (humanoid(), POINTS[:1], 4 * 5 + 6 - 3 - 1 + 4),
        (humanoid(), POINTS, 4 * 8 + 12 - 6 - 1 + 4),
    ],
    ids=[
        *("pose", "point", "distance", "contact", "tracker", "head", "both hands", "wall"),
        *(
            "plane",
            "plate",
            "seen plane",
            "seen plate",
            "one wall",
            "gravity",
            "pixels",
            "pixel",
            "both pixels",
        ),
    ],
)
def test_as_many_parameters_are_free_as_the_observation_determines(
    machine: Machine, looking: list[Instrument], rank: int
) -> None:
    assert free(machine, looking) == rank


def test_a_part_held_by_both_hands_closes_a_ring_of_axes_and_measures_no_length() -> None:
    # 4 parameters between each two of 12 axes that follow each other in a ring, less its size
    assert free(arms(6), [held_part("part", between=("l5", "r5"))]) == 4 * 12 - 1


def test_joints_that_both_bodies_share_drop_out_and_are_held() -> None:
    made = assemble(humanoid(), HEAD)
    assert {"q_w0", "q_w1"} <= made.unused
    held = fix_redundant(made)
    assert all(held.parameters[f"q_w{i}_{k}"].fixed for i in range(2) for k in ("x", "rz"))
    assert any("changes no reading" in words for words in held.remarks)


def test_a_body_is_seen_from_another_one_as_both_are_from_the_ground() -> None:
    machine = humanoid()
    assert machine.tree is not None
    q = np.random.default_rng(7).uniform(-1.0, 1.0, (4, len(machine.quantities)))
    hand, head = machine.fk(q, on="l2"), machine.fk(q, on="h1")
    np.testing.assert_allclose(
        machine.fk(q, on="l2", against="h1"), np.linalg.inv(head) @ hand, atol=1e-14
    )
    values = {p.name: p.nominal for p in machine.parameters.values()}
    joints = dict(zip(machine.quantities, q[0].tolist(), strict=True))
    step_by_step = product(machine.tree.path("l2", "h1"), joints, values)
    np.testing.assert_allclose(step_by_step, np.linalg.inv(head[0]) @ hand[0], atol=1e-14)


def test_a_displaced_body_moves_what_is_seen_of_it_and_from_it() -> None:
    made = assemble(arms(), [contact("a", between=("l2", "r2"), radius=(0.05, 0.05))])
    assert made.body is not None
    assert set(made.body.displacements) == {"l2", "r2"}
    whole = structured(made, discrepancy=4)
    assert {"discrepancy_l2_x_cos1", "discrepancy_r2_x_cos1"} <= set(whole.parameters.names)
    assert not any("_rx_" in n for n in whole.parameters.names if n.startswith("discrepancy"))
    assert whole.structure is not None
    assert whole.structure.smooth["l2"].joints == ("q_l0", "q_l1", "q_l2")


@pytest.mark.parametrize(
    ("bodies", "code", "stated"),
    [
        ([*limb("l", "base", 1, 0), *limb("l", "base", 1, 0)], "duplicate-name", ("'l0'",)),
        (limb("l", "bass", 1, 0), "unknown-name", ("'l0'", "'bass'", "'base'")),
        (
            [Hanging("a", "b", LinkJoint("j")), Hanging("b", "a", LinkJoint("k"))],
            "invalid-value",
            ("a", "b"),
        ),
        ([Hanging("a", "base", LinkJoint("j", "fixed"))], "missing-key", ("'base'",)),
    ],
)
def test_bodies_that_make_no_tree_are_refused(
    bodies: list[Hanging], code: str, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):  # type: ignore[arg-type]
        tree_machine(bodies, root="base")


def test_observations_that_name_no_two_bodies_are_refused() -> None:
    for looking, code in (
        ([point(station="s")], "missing-key"),
        ([point(on="l9")], "unknown-name"),
        ([distance("a", on="l2", against="l2")], "conflicting-keys"),
        ([point("a", on="l2"), point("b", on="r2", readings=("u", "v", "w"))], "duplicate-name"),
    ):
        with refused(code):  # type: ignore[arg-type]
            assemble(arms(), looking)
