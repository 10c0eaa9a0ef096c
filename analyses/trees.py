"""Do calibrations of whole robots hold? Coverage of stated 95 % regions at poses not used.

Robots are simulated by code of their own: two arms that touch each other under a tracker; a head
camera that sees boards on both hands; two robots that hold one part; an arm that reaches points of
the plate of a positioner, and one on a rail that does. Of each draw the files of a user go through

    loopcal init FILES --dh bodies.csv --observe ...

and its calibration by the implicit loop, learnt sds included. A region of an instrument (of one
corner, where a camera looks) holds where

    (prediction - truth)^T C^-1 (prediction - truth)

is at most the stated limit; C the covariance that `predict` states.

    python -m analyses.trees [--draws 100] [--kinds NAMES] [--processes 2] [--keep FILE]

Draws are kept in FILE as they end, and a run goes on where an earlier one stopped.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.kept import Draw, complete
from loopcal.small_samples import f_limit

Array = NDArray[np.float64]
ARM = ((0.06, 0.35, 90), (0.42, 0.02, 0), (0.05, 0.0, 90), (0.0, 0.40, -90), (0.0, 0.0, 90))
"""a [m], d [m], alpha [deg] of the first five joints of an arm; the sixth carries the hand."""
HEAD = ((0.05, 0.10, 90), (0.08, 0.0, 0))
TABLE = ((0.0, 0.30, 90), (0.0, 0.15, 0))
LENGTH, TWIST, ZERO = 0.4e-3, 1e-3, 2e-3
"""Sds by which robots are off their drawings [m, rad, rad]."""
ENCODER, TRACKER, GAP, CORNER, HOLE = 3e-5, 2e-5, 5e-5, 0.2, 3e-5
"""Sds of readings [rad, m, m, px, m]."""
F, CENTRE = 900.0, np.array([640.0, 480.0])
RAIL = -0.4, 0.4
"""How far the foot of an arm slides [m]."""
POSES, FRESH = 70, 40


def steps(theta: Array, a: Array, d: Array, alpha: Array) -> Array:
    """(..., n, 4, 4) of n rows with angles theta (..., n)."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    T = np.zeros((*np.shape(theta), 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2], T[..., 0, 3] = c, -s * ca, s * sa, a * c
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = s, c * ca, -c * sa, a * s
    T[..., 2, 1], T[..., 2, 2], T[..., 2, 3], T[..., 3, 3] = sa, ca, d, 1.0
    return T


@dataclass(frozen=True)
class Limb:
    """rows: (n, 4) theta, a, d, alpha of the true limb, the first one that of what carries it;
    rail: whether its first joint slides."""

    name: str
    rows: Array
    rail: bool = False

    @property
    def joints(self) -> list[str]:
        return [f"{self.name}{i}" for i in range(1, len(self.rows))]

    def hand(self, q: Array) -> Array:
        """T_base_hand (..., 4, 4) at joints (..., n)."""
        theta, a, d, alpha = self.rows.T
        # Of what carries it nothing moves.
        moves = np.concatenate([np.zeros((*q.shape[:-1], 1)), q], axis=-1)
        slides = np.arange(len(theta)) == (1 if self.rail else -1)
        turned, slid = theta + np.where(slides, 0.0, moves), d + np.where(slides, moves, 0.0)
        T, *others = np.moveaxis(steps(turned, a, slid, alpha), -3, 0)
        for other in others:
            T = T @ other
        return np.asarray(T)


def limb(
    name: str,
    at: tuple[float, float, float],
    rows: Sequence[tuple[float, float, float]],
    *,
    rail: bool = False,
) -> tuple[Limb, list[str]]:
    """A limb as drawn, and its lines of the table of bodies; at: theta [deg], a, d of its foot;
    rail: its foot slides along y."""
    slide = [(0.0, 0.0, 0.0, 90.0)] if rail else []
    drawn = [(*at, -90.0 if rail else 0.0), *slide, *((0.0, *row) for row in rows)]
    lines = []
    for i, (theta, a, d, alpha) in enumerate(drawn):
        parent, joint = ("base", "") if i == 0 else (f"{name}_{i - 1}", f"{name}{i}")
        kind = "prismatic" if rail and i == 1 else ""
        lines.append(f"{name}_{i},{parent},{joint},{1e3 * a},{1e3 * d},{alpha},{theta},{kind}")
    made = np.array([(np.radians(t), a, d, np.radians(al)) for t, a, d, al in drawn])
    return Limb(name, made, rail), lines


def off(one: Limb, random: np.random.Generator) -> Limb:
    """The limb as it really is."""
    sds = np.array([ZERO, LENGTH, LENGTH, TWIST])
    return Limb(one.name, one.rows + sds * random.standard_normal(one.rows.shape), one.rail)


def placed(xyz: ArrayLike, turn: ArrayLike) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), xyz
    return T


def to(one: Limb, point: Array, goal: Array) -> Callable[[Array], Array]:
    """How far a point of the hand is from a goal (3,) [m], by joints (..., n)."""

    def away(q: Array) -> Array:
        return np.asarray((one.hand(q) @ point)[..., :3] - goal)

    return away


def reached(residual: Callable[[Array], Array], starts: Array) -> Array | None:
    """Joints that make a residual of joints (..., n) vanish, from the first start that leads there.

    By Gauss and Newton with differences, damped (Levenberg 1944).
    """
    for start in starts:
        q: Array = start.copy()
        damping = 1e-3
        n = len(q)
        every = residual(np.vstack([q, q + 1e-7 * np.eye(n)]))
        for _ in range(60):
            f, J = every[0], (every[1:] - every[0]).T / 1e-7
            if np.abs(f).max() < 1e-10:
                break
            move = -np.linalg.solve(J.T @ J + damping * np.eye(n), J.T @ f)
            if np.abs(move).max() < 1e-8 and np.abs(f).max() > 1e-6:
                break  # as near as it comes from there: out of reach
            trial = q + move
            there = residual(np.vstack([trial, trial + 1e-7 * np.eye(n)]))
            if np.abs(there[0]).max() < np.abs(f).max():
                q, every, damping = trial, there, 0.1 * damping
            else:
                damping *= 10.0
        if np.abs(every[0]).max() < 1e-9 and np.abs(q).max() < 2.6:
            return q
    return None


@dataclass(frozen=True)
class World:
    """A table of bodies, files by name, what to observe, and fresh poses with what is true there:
    columns of readings, and truth by output."""

    bodies: str
    files: dict[str, str]
    observe: tuple[str, ...]
    fresh: dict[str, Array]
    truth: dict[str, Array]


HEADER = "body,parent,joint,a [mm],d [mm],alpha [deg],theta [deg],type"


def table(columns: Mapping[str, Array | Sequence[str]]) -> str:
    rows = [",".join(columns)]
    for values in zip(*columns.values(), strict=True):
        rows.append(",".join(v if isinstance(v, str) else f"{v:.9g}" for v in values))
    return "\n".join(rows) + "\n"


def arms(random: np.random.Generator, apart: float) -> tuple[Limb, Limb, list[str]]:
    hand = (0.02, 0.12, 0)
    left, lines = limb("l", (90.0, 0.5 * apart, 0.4), (*ARM, hand))
    right, more = limb("r", (-90.0, 0.5 * apart, 0.4), (*ARM, hand))
    return off(left, random), off(right, random), [*lines, *more]


def read(random: np.random.Generator, *limbs_q: tuple[Limb, Array]) -> dict[str, Array]:
    """Columns of joints as read, of true ones (N, n) each."""
    return {
        name: q[:, i] + random.normal(0.0, ENCODER, len(q))
        for one, q in limbs_q
        for i, name in enumerate(one.joints)
    }


def tracked(T: Array, one: Limb, q: Array, target: Array) -> Array:
    """(N, 3) a target on the hand in the tracker."""
    return np.asarray((T @ one.hand(q) @ target)[:, :3])


def named(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}


def under_tracker(
    random: np.random.Generator,
    T: Array,
    limbs: tuple[Limb, Limb],
    targets: Sequence[Array],
    counts: tuple[int, int],
) -> tuple[dict[str, str], dict[str, Array], dict[str, Array]]:
    """Files in which a tracker sees each hand in so many poses; joints and truth of fresh ones."""
    files: dict[str, str] = {}
    joints: dict[str, Array] = {}
    truth: dict[str, Array] = {}
    for one, target, count, name in zip(limbs, targets, counts, "ab", strict=True):
        q = random.uniform(-1.4, 1.4, (count + FRESH, 6))
        seen = tracked(T, one, q, target)
        columns = read(random, (one, q))
        near = named(name, seen + random.normal(0.0, TRACKER, seen.shape))
        files[f"seen_{name}.csv"] = table({k: v[:count] for k, v in {**columns, **near}.items()})
        joints |= {k: v[count:] for k, v in columns.items()}
        truth |= named(name, seen[count:])
    return files, joints, truth


def touching(random: np.random.Generator) -> World:
    """Two arms whose balls touch, 116 mm apart, and a tracker that sees both hands."""
    left, right, lines = arms(random, 0.5)
    T = placed([1.5, -2.0, 0.3], random.normal(0.0, 0.5, 3))
    balls = [np.append(random.normal([0.0, 0.0, 0.05], 5e-3), 1.0) for _ in range(2)]
    targets = [np.append(random.normal(0.0, 0.03, 3), 1.0) for _ in range(2)]
    both: list[tuple[Array, Array]] = []
    while len(both) < POSES:
        a = random.uniform(-1.2, 1.2, 6)
        at = (left.hand(a) @ balls[0])[:3]
        u = random.standard_normal(3)
        goal = at + (0.116 + random.normal(0.0, GAP)) * u / np.linalg.norm(u)
        b = reached(to(right, balls[1], goal), random.uniform(-1.5, 1.5, (3, 6)))
        if b is not None:
            both.append((a, b))
    q = [np.array(side) for side in zip(*both, strict=True)]
    files, joints, truth = under_tracker(random, T, (left, right), targets, (30, 30))
    files["touch.csv"] = table(read(random, (left, q[0]), (right, q[1])))
    observe = (
        "contact name=touch between=l_6,r_6 radius=58mm,58mm file=touch",
        "point name=a on=l_6 station=tracker columns=a_x,a_y,a_z",
        "point name=b on=r_6 station=tracker columns=b_x,b_y,b_z",
    )
    return World("\n".join([HEADER, *lines]), files, observe, joints, truth)


def holding(random: np.random.Generator) -> World:
    """Two robots hold one part; a tracker sees the hand of one of them, and rarely of the other."""
    left, right, lines = arms(random, 1.0)
    T = placed([2.0, -1.5, 0.3], random.normal(0.0, 0.5, 3))
    part = placed([0.3, 0.1, 0.2], [0.5, 2.5, 0.3])
    targets = [np.append(random.normal(0.0, 0.03, 3), 1.0) for _ in range(2)]
    both: list[tuple[Array, Array]] = []
    while len(both) < POSES:
        # A walk: where both robots reach one pose of the part, they reach those near by as well.
        a = both[-1][0] + random.uniform(-0.6, 0.6, 6) if both else random.uniform(-1.2, 1.2, 6)
        slack = placed(random.normal(0.0, GAP, 3), random.normal(0.0, 1e-4, 3))
        goal: Array = np.asarray(np.linalg.inv(left.hand(a) @ part @ slack), dtype=float)

        def error(q: Array, goal: Array = goal) -> Array:
            E = goal @ right.hand(q)
            turns = Rotation.from_matrix(E[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
            return np.concatenate([E[..., :3, 3], turns.reshape(*E.shape[:-2], 3)], axis=-1)

        starts = both[-1][1][None] if both else random.uniform(-1.8, 1.8, (20, 6))
        b = reached(error, starts)
        if b is not None and np.abs(a).max() < 1.6:
            both.append((a, b))
    q = [np.array(side) for side in zip(*both, strict=True)]
    files, joints, truth = under_tracker(random, T, (left, right), targets, (40, 10))
    files["part.csv"] = table(read(random, (left, q[0]), (right, q[1])))
    observe = (
        "held-part name=part between=l_6,r_6 file=part",
        "point name=a on=l_6 station=tracker columns=a_x,a_y,a_z",
        "point name=b on=r_6 station=tracker columns=b_x,b_y,b_z",
    )
    return World("\n".join([HEADER, *lines]), files, observe, joints, truth)


def reaching(random: np.random.Generator, *, rail: bool = False) -> World:
    """An arm puts its ball into holes of the plate of a positioner, whose places are known."""
    arm, lines = limb("l", (0.0, 0.0, 0.0), (*ARM, (0.02, 0.12, 0)), rail=rail)
    plate, more = limb("t", (0.0, 0.75, 0.1), TABLE)
    arm, plate = off(arm, random), off(plate, random)
    T = placed(random.normal(0.0, 5e-3, 3), random.normal(0.0, 0.02, 3))
    ball = np.append(random.normal([0.0, 0.0, 0.08], 0.01), 1.0)
    rows: list[tuple[Array, Array, Array]] = []
    while len(rows) < POSES + FRESH:
        turns = random.uniform(-1.0, 1.0, 2)
        hole = np.append(random.uniform(-0.15, 0.15, 2), [0.05, 1.0])
        goal = (plate.hand(turns) @ T @ hole)[:3]
        starts = random.uniform(-1.5, 1.5, (3, 6))
        if rail:
            along = random.uniform(*RAIL)
            away = to(arm, ball, goal)

            def beside(q: Array, along: float = along, away: Any = away) -> Array:
                """The same, where the arm stands there on its rail."""
                return np.asarray(away(np.insert(q, 0, along, axis=-1)))

            q = reached(beside, starts)
            q = q if q is None else np.insert(q, 0, along)
        else:
            q = reached(to(arm, ball, goal), starts)
        if q is not None:
            rows.append((q, turns, hole[:3]))
    q, turns, holes = (np.array(part) for part in zip(*rows, strict=True))
    columns = read(random, (arm, q), (plate, turns))
    near = named("hole", holes + random.normal(0.0, HOLE, holes.shape))
    used = {k: v[:POSES] for k, v in {**columns, **near}.items()}
    hand = f"l_{len(arm.joints)}"
    observe = (f"point name=hole on={hand} against=t_2 station=plate columns=hole_x,hole_y,hole_z",)
    fresh = {k: v[POSES:] for k, v in columns.items()}
    lines = [HEADER, *lines, *more]
    truth = named("hole", holes[POSES:])
    return World("\n".join(lines), {"holes.csv": table(used)}, observe, fresh, truth)


def watching(random: np.random.Generator) -> World:
    """A head camera with a known board on each hand."""
    left, right, lines = arms(random, 0.5)
    head, more = limb("h", (0.0, 0.0, 1.0), HEAD)
    head = off(head, random)
    camera = placed([0.03, 0.02, 0.01], random.normal(0.0, 0.02, 3)) @ placed(
        [0.0, 0.0, 0.0], [0.0, np.pi / 2, 0.0]
    )
    points = {f"{i}": np.array([i % 4 * 0.025, i // 4 * 0.025, 0.0, 1.0]) for i in range(12)}
    boards = {n: placed(random.normal(0.0, 0.02, 3), random.normal(0.0, 0.3, 3)) for n in "lr"}
    n = POSES // 2 + FRESH // 2
    corners: list[str] = ["pose,camera,board,point,u_px,v_px"]
    joints: list[Array] = []
    pixels: dict[str, list[float]] = {}
    for one in (left, right):
        kept = 0
        while kept < n:
            q = random.uniform(-1.5, 1.5, 6)
            at = (one.hand(q) @ boards[one.name])[:3, 3]

            def aim(turns: Array, at: Array = at) -> Array:
                P = np.linalg.inv(head.hand(turns) @ camera) @ np.append(at, 1.0)
                return np.asarray(P[..., :2])

            turns = reached(aim, random.uniform(-1.0, 1.0, (3, 2)))
            if turns is None:
                continue
            turns = turns + random.uniform(-0.15, 0.15, 2)
            T = np.linalg.inv(head.hand(turns) @ camera) @ one.hand(q) @ boards[one.name]
            facing = -T[:3, 2] @ T[:3, 3] / np.linalg.norm(T[:3, 3])
            if T[2, 3] < 0.25 or facing > -0.4:  # the z axis of a board points into it
                continue
            other = right if one is left else left
            rest = random.uniform(-1.0, 1.0, 6)
            pose = [q, rest] if one is left else [rest, q]
            name = f"{one.name}{kept}"
            fresh = kept >= POSES // 2
            for label, X in points.items():
                P = T @ X
                uv = F * P[:2] / P[2] + CENTRE
                if fresh:
                    for axis, value in zip("uv", uv, strict=True):
                        for side in (one, other):
                            column = pixels.setdefault(f"eye:{side.name}:{label}:{axis}", [])
                            column.append(float(value) if side is one else np.nan)
                else:
                    uv = uv + random.normal(0.0, CORNER, 2)
                    corners.append(f"{name},eye,{one.name},{label},{uv[0]:.4f},{uv[1]:.4f}")
            joints.append(np.concatenate([*pose, turns]))
            kept += 1
    q = np.array(joints)
    ids = [f"{side}{k}" for side in "lr" for k in range(n)]
    some = np.array([k >= POSES // 2 for _ in "lr" for k in range(n)])
    columns = read(random, (left, q[:, :6]), (right, q[:, 6:12]), (head, q[:, 12:]))
    used = {k: v[~some] for k, v in columns.items()}
    board = ["board,point,x_m,y_m,z_m"]
    board += [f"{s},{k},{X[0]:.4f},{X[1]:.4f},0" for s in "lr" for k, X in points.items()]
    files = {
        "images/poses.csv": table(
            {"pose": [i for i, fresh in zip(ids, some, strict=True) if not fresh], **used}
        ),
        "images/readings.csv": "\n".join(corners) + "\n",
        "images/board.csv": "\n".join(board) + "\n",
    }
    observe = (
        "camera name=left on=h_2 sees=l_6 board=l",
        "camera name=right on=h_2 sees=r_6 board=r",
    )
    fresh_joints = {k: v[some] for k, v in columns.items()}
    truth = {name: np.array(values) for name, values in pixels.items()}
    return World("\n".join([HEADER, *lines, *more]), files, observe, fresh_joints, truth)


KINDS: dict[str, Callable[[np.random.Generator], World]] = {
    "dual arm": touching,
    "one part": holding,
    "positioner": reaching,
    "head camera": watching,
    "rail": partial(reaching, rail=True),
}


def drawn(kind: str, draw: int) -> Draw:
    """One draw: regions that hold, of how many, and errors over stated sds."""
    world = KINDS[kind](np.random.default_rng([draw, list(KINDS).index(kind)]))
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        for name, text in {"bodies.csv": world.bodies + "\n", **world.files}.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, "utf-8")
        given = sorted({folder / Path(name).parts[0] for name in world.files})
        lc.init(*given, dh=folder / "bodies.csv", observe=world.observe, out=folder / "cell")
        result = lc.calibrate(folder / "cell" / "project.toml", method="implicit-loop")
    predicted = result.predict(world.fresh)
    names = list(predicted.outputs)
    holds, count, squares, sizes = 0, 0, 0.0, 0.0
    for group in predicted.groups:
        rows = list(group.rows)
        for first in range(0, len(rows), 2 if group.points > 1 else len(rows)):
            some = rows[first : first + (2 if group.points > 1 else len(rows))]
            away = np.array([predicted.outputs[names[i]] - world.truth[names[i]] for i in some]).T
            C = predicted.covariance[:, some][:, :, some]
            limit = f_limit(0.95, len(some), predicted.denominator)
            for d, cov, most in zip(away, C, np.broadcast_to(limit, len(away)), strict=True):
                if np.isfinite(d).all():
                    holds += bool(d @ np.linalg.solve(cov, d) <= most)
                    count += 1
                    squares += float(d @ d)
                    sizes += float(np.trace(cov))
    return {
        "kind": kind,
        "draw": draw,
        "holds": holds,
        "count": count,
        "error": float(np.sqrt(squares / count)),
        "stated": float(np.sqrt(sizes / count)),
        "converged": result.status.converged,
    }


def shown(draws: Sequence[Draw]) -> str:
    """A line for each kind: share of regions that hold with its interval over draws."""
    lines = [
        "| robot | draws | regions that hold | over draws | error over stated |",
        "|" + " --- |" * 5,
    ]
    for kind in dict.fromkeys(one["kind"] for one in draws):
        some = [one for one in draws if one["kind"] == kind]
        shares = np.array([one["holds"] / one["count"] for one in some])
        ratio = np.sqrt(np.mean([(one["error"] / one["stated"]) ** 2 for one in some]))
        half = 1.96 * shares.std(ddof=1) / np.sqrt(len(some)) if len(some) > 1 else np.nan
        lines.append(
            f"| {kind} | {len(some)} | {100 * shares.mean():.1f} % | ± {100 * half:.1f} % | "
            f"{ratio:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=Path(".cache/trees.jsonl"))
    asked = parser.parse_args()
    wanted = [(kind, i) for i in range(asked.draws) for kind in asked.kinds.split(",")]
    print(shown(complete(asked.keep, wanted, partial(drawn), asked.processes)))


if __name__ == "__main__":
    main()
