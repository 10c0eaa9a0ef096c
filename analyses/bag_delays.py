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
from tests.bags import write_bag

DELAY, OFF, NOISE = 0.037, 1e-3, 2e-4
"""[s]; sd of the machine's errors [m, rad]; of readings of joints [rad] and points [m]."""


def errors(draws: int, poses: int, folder: Path, urdf: Path) -> list[tuple[float, float]]:
    """Error and sd [s] of each draw: an arm off its drawing, poses at random."""
    made = []
    nominal = lc.load_urdf(urdf)
    for k in range(draws):
        rng = np.random.default_rng(1000 + k)
        off = {n: p.nominal + OFF * rng.normal() for n, p in nominal.parameters.items()}
        robot = replace(
            nominal,
            parameters={n: replace(p, nominal=off[n]) for n, p in nominal.parameters.items()},
        )
        q = rng.uniform(-1.0, 1.0, (poses, 6))

        def seen(q: Any, robot: lc.Machine = robot) -> Any:
            T = robot.fk(q)
            return T[:, :3, :3] @ np.array([0.03, 0.02, 0.1]) + T[:, :3, 3]

        place = folder / f"{poses}-{k}"
        place.mkdir()
        joints = {name: q[:, i] for i, name in enumerate(nominal.quantities)}
        bag = write_bag(place, "mcap", joints, {"/p": seen}, noise=NOISE, delay=DELAY, seed=k)
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
            z = pairs[:, 0] / pairs[:, 1]
            rms = 1e6 * float(np.sqrt(np.mean(pairs[:, 0] ** 2)))
            print(
                f"{poses} poses, {draws} draws: {np.mean(abs(z) < 1.96):.1%} within 1.96 sd; error "
                f"{rms:.1f} us rms, stated {1e6 * pairs[:, 1].mean():.1f} us"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
