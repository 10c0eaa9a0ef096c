"""A project by `loopcal init` beside one written by hand, which knows where the reflector is.

Both are calibrated by default. Arms differ from their drawings by 0.5 mm and 0.5 mrad and give way
under their weight. The true errors [mm, rms] are those at 500 fresh poses, in the joint ranges that
were measured and in the whole ones.

    python -m analyses.initial_projects --draws 4
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc

Array = NDArray[np.float64]
ENCODER, TRACKER, DRAWN = 50e-6, 30e-6, 3e-3
FRESH, GIVES = 500, 0.4e-3
ROBOTS: dict[str, list[tuple[float, float, float, float]]] = {
    "UR10": [
        (0, 127.3, 90, 0),
        (-612, 0, 0, 0),
        (-572.3, 0, 0, 0),
        (0, 163.941, 90, 0),
        (0, 115.7, -90, 0),
        (0, 92.2, 0, 0),
    ],
    "IRB 120": [
        (0, 290, -90, 0),
        (270, 0, 0, -90),
        (70, 0, -90, 0),
        (0, 302, 90, 0),
        (0, 0, -90, 0),
        (0, 72, 0, 180),
    ],
    "LBR iiwa": [
        (0, 360, -90, 0),
        (0, 0, 90, 0),
        (0, 420, 90, 0),
        (0, 0, -90, 0),
        (0, 400, -90, 0),
        (0, 0, 90, 0),
        (0, 126, 0, 0),
    ],
}
"""Rows a, d [mm], alpha, theta [deg] of the classical convention."""


@dataclass(frozen=True)
class Kind:
    """What was measured: poses, half the range of the joints [rad], and where the reflector is."""

    name: str
    poses: int
    half: float
    target: tuple[float, float, float]


KINDS = (
    Kind("corner, 60 poses", 60, 0.35, (0.03, 0.02, 0.06)),
    Kind("corner, reflector 0.3 m out", 60, 0.35, (0.2, -0.1, 0.2)),
    Kind("corner, 20 poses", 20, 0.25, (0.03, 0.02, 0.06)),
    Kind("whole range, 60 poses", 60, 1.8, (0.03, 0.02, 0.06)),
    Kind("whole range, reflector 0.3 m out", 60, 1.8, (0.2, -0.1, 0.2)),
    Kind("whole range, 14 poses", 14, 1.8, (0.03, 0.02, 0.06)),
)


def points(rows: Array, q: Array, u: Array, gives: float) -> Array:
    """(N, 3) end points [m] of joints (N, n); the second and third give way by `gives` [rad/m]."""
    origins, axes, p = _frames(rows, q, u)
    turned = q.copy()
    down = np.array([0.0, 0.0, -1.0])
    for j in (1, 2):
        moment = np.cross(p - origins[j], down)
        turned[:, j] += gives * (axes[j] * moment).sum(axis=1)
    return _frames(rows, turned, u)[2]


def _frames(rows: Array, q: Array, u: Array) -> tuple[list[Array], list[Array], Array]:
    R, o = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    origins, axes = [], []
    for (a, d, alpha, theta), angle in zip(rows, q.T, strict=True):
        origins.append(o)
        axes.append(R[:, :, 2])
        turn = Rotation.from_euler("z", (angle + theta)[:, None]).as_matrix()
        R = R @ turn
        o = o + R @ np.array([a, 0.0, d])
        R = R @ Rotation.from_euler("x", alpha).as_matrix()
    return origins, axes, o + R @ u


def drawing(robot: str) -> Array:
    """(n, 4) rows in m and rad."""
    table: Array = np.array(ROBOTS[robot], float) * [1e-3, 1e-3, np.pi / 180, np.pi / 180]
    return table


def errors(robot: str, kind: Kind, seed: int, folder: Path) -> Iterator[tuple[str, float, float]]:
    """Who calibrated, and the rms true errors [m] in the measured and in the whole joint ranges."""
    rng = np.random.default_rng(seed)
    drawn = drawing(robot)
    n = len(drawn)
    true = drawn + rng.normal(0.0, 5e-4, drawn.shape)
    u = np.array(kind.target)
    S, t = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-3, 3, 3)
    middle = rng.uniform(-1.8 + kind.half, 1.8 - kind.half, n)

    def seen(q: Array) -> Array:
        there: Array = points(true, q, u, GIVES) @ S.T + t
        return there

    joints = middle + rng.uniform(-kind.half, kind.half, (kind.poses, n))
    measured = seen(joints) + rng.normal(0.0, TRACKER, (kind.poses, 3))
    read = joints + rng.normal(0.0, ENCODER, joints.shape)
    table = folder / "dh.csv"
    table.write_text(
        "a,d,alpha,theta\n"
        + "\n".join(f"{a},{d},{alpha},{theta}" for a, d, alpha, theta in ROBOTS[robot])
    )
    names = [f"J{i}" for i in range(1, n + 1)]
    columns = dict(zip([*names, "x", "y", "z"], [*read.T, *measured.T], strict=True))
    made = lc.init(columns, dh=table)
    told = made.mechanism.parameters
    mounted = [f"tool_{a}" for a in "xyz"]
    stated = dict(zip(mounted, u + rng.normal(0.0, DRAWN, 3), strict=True))
    by_hand = told.with_nominal(stated).with_prior(dict.fromkeys(mounted, np.inf))
    fresh = {
        "near": middle + rng.uniform(-kind.half, kind.half, (FRESH, n)),
        "far": rng.uniform(-1.8, 1.8, (FRESH, n)),
    }
    for name, parameters in (("init", told), ("by hand", by_hand)):
        machine = made.mechanism.with_parameters(parameters)
        result = lc.calibrate(machine, made.dataset, noise=made.noise)
        off = {
            where: _error(result, dict(zip(names, q.T, strict=True)), seen(q))
            for where, q in fresh.items()
        }
        yield name, off["near"], off["far"]


def _error(result: lc.Result, joints: dict[str, Array], true: Array) -> float:
    out = lc.predict(result, joints).outputs
    off = np.array([out[a] for a in "xyz"]).T - true
    return float(np.sqrt(np.square(off).sum(axis=1).mean()))


def main() -> None:
    """Print the geometric means over the draws of every robot and kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--kinds", nargs="+", type=int, default=list(range(len(KINDS))))
    given = parser.parse_args()
    draws, kinds = given.draws, [KINDS[i] for i in given.kinds]
    print(f"{'':44}{'measured ranges':>20}{'whole ranges':>20}")
    print(f"{'rms true error [mm]':44}{'init':>10}{'by hand':>10}{'init':>10}{'by hand':>10}")
    with TemporaryDirectory() as folder:
        for robot in given.robots:
            for kind in kinds:
                rows: dict[str, list[tuple[float, float]]] = {}
                for seed in range(draws):
                    for name, near, far in errors(robot, kind, seed, Path(folder)):
                        rows.setdefault(name, []).append((near, far))
                means = {k: 1e3 * np.exp(np.log(v).mean(axis=0)) for k, v in rows.items()}
                cells = [means[k][i] for i in (0, 1) for k in ("init", "by hand")]
                print(
                    f"{robot + ', ' + kind.name:44}" + "".join(f"{c:10.3f}" for c in cells),
                    flush=True,
                )


if __name__ == "__main__":
    main()
