"""How often the stated sd of a delay in a bag holds: seeded recordings, true delay 37 ms.

python -m analyses.bag_delays [DRAWS]
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import loopcal as lc
from loopcal.files.project.new_project import write_new_project
from loopcal.files.tables.recording import Recording, Series
from tests.bags import HOLD, MOVE, motion, write_bag

DELAY, DRIFT, OFF, NOISE = 0.037, 40e-6, 1e-3, 2e-4
"""[s], [s/s]; sd of the machine's errors [m, rad]; of readings of joints [rad] and points [m]."""


def off_its_drawing(nominal: lc.Machine, rng: np.random.Generator) -> lc.Machine:
    """A machine whose parameters all err."""
    off = {n: p.nominal + OFF * rng.normal() for n, p in nominal.parameters.items()}
    return replace(
        nominal, parameters={n: replace(p, nominal=off[n]) for n, p in nominal.parameters.items()}
    )


def target(robot: lc.Machine, q: Any) -> Any:
    """(N, 3) [m] what the instrument sees."""
    T = robot.fk(q)
    return T[:, :3, :3] @ np.array([0.03, 0.02, 0.1]) + T[:, :3, 3]


def drifts(draws: int, urdf: Path) -> Any:
    """(D, 4) errors and sds of delay [s] and drift, of recordings of 12 minutes, without bags."""
    made, nominal = [], lc.load_urdf(urdf)
    for k in range(draws):
        rng = np.random.default_rng(5000 + k)
        robot = off_its_drawing(nominal, rng)
        poses = rng.uniform(-1.0, 1.0, (480, 6))
        end = len(poses) * (HOLD + MOVE)
        t, seen = np.arange(0.0, end, 0.04), np.arange(0.01, end, 0.05)
        q = motion(poses, t) + NOISE * rng.normal(size=(len(t), 6))
        late = DELAY + DRIFT * (seen - 0.5 * end)
        points = target(robot, motion(poses, seen - late))
        points += NOISE * rng.normal(size=points.shape)
        joints = {n: Series(1e3 + t, q[:, [i]], (n,)) for i, n in enumerate(nominal.quantities)}
        measured = {"/p": Series(1e3 + seen, points, ("x [m]", "y [m]", "z [m]"))}
        (one,) = lc.init(Recording(joints, measured), urdf=urdf).delays
        made.append((one.value - DELAY, one.sd, (one.drift or np.nan) - DRIFT, one.drift_sd))
    return np.array(made)


def errors(draws: int, poses: int, folder: Path, urdf: Path) -> list[tuple[float, float]]:
    """Error and sd [s] of each draw: an arm off its drawing, poses at random."""
    made = []
    nominal = lc.load_urdf(urdf)
    for k in range(draws):
        rng = np.random.default_rng(1000 + k)
        robot = off_its_drawing(nominal, rng)
        q = rng.uniform(-1.0, 1.0, (poses, 6))

        def seen(q: Any, robot: lc.Machine = robot) -> Any:
            return target(robot, q)

        place = folder / f"{poses}-{k}"
        place.mkdir()
        joints = {name: q[:, i] for i, name in enumerate(nominal.quantities)}
        bag = write_bag(
            place, "mcap", joints, {"/p": seen}, noise=NOISE, delay=DELAY, publishers=2, seed=k
        )
        (delay,) = lc.init(bag, urdf=urdf).delays
        made.append((delay.value - DELAY, delay.sd))
    return made


def main(draws: int) -> None:
    """Print a line for each number of poses."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in write_new_project(folder / "robot", "urdf"):
            print("simulated with", path.name)
        for poses in (13, 30):
            pairs = np.array(errors(draws, poses, folder, folder / "robot" / "robot.urdf"))
            said(f"{poses} poses, {draws} draws", pairs, "us")
        both = drifts(draws, folder / "robot" / "robot.urdf")
        said(f"drifting clocks, {draws} draws", both[:, :2], "us")
        said("their drift", both[:, 2:], "ppm")


def said(what: str, pairs: Any, unit: str) -> None:
    """Print how often the's sd held: errors and sds."""
    within = np.mean(abs(pairs[:, 0] / pairs[:, 1]) < 1.96)
    rms, stated = 1e6 * np.sqrt(np.mean(pairs[:, 0] ** 2)), 1e6 * pairs[:, 1].mean()
    print(f"{what}: {within:.1%} within 1.96 sd; error {rms:.3g} {unit} rms, stated {stated:.3g}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
