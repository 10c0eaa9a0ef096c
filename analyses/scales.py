"""How often scales of stations, and of the drawing, are named, by their size.

Arms of `analyses.lives_truth` are measured at 90 poses in random order by a tracker of 10 to 30 um
and calibrated with a structured model error. The equations of that calibration are then drawn
anew: noise, and parameters within their priors, the sd of lengths learnt from those of the draw. In
"station" the second half of the poses is measured from another place, whose scale differs. In
"drawing" all lengths differ in proportion, and are off it by 0.02 mm or 0.3 mm (sd) besides.
Counted are p-values below 5 % and those that the verdict names; z is the root mean square of
(size - truth) / sd.

    python -m analyses.scales [--draws 100] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.lives_truth import Machine, machine, write_readings
from analyses.written import write_block
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.calibrate import calibrate
from loopcal.statistics.judged_readings import RARE
from loopcal.statistics.ordered_system import OrderedSystem, ordered_system
from loopcal.statistics.scales import scale_columns, scales

PAGE = Path("docs/explanation/verdict.md")
MACHINES, POSES = (0, 1, 14), 90
"""A six-axis arm, an IRB and a UR of the fleet."""
SCALES, LARGE = (0.0, 20e-6, 100e-6), (0.0, 1e-3, 5e-3)
"""Of trackers, and of instruments whose scale is a guess."""


def begun(
    number: int | Machine, stations: int, scale: float = 0.0, ratio: float = 1.0, joint: int = 3
) -> OrderedSystem:
    """The equations of a calibration; scale: by which the second half of its readings differs;
    ratio: the true angles of this joint over what is read."""
    user = machine(number) if isinstance(number, int) else number
    user = replace(user, stations=stations, described="dh", order="random", poses=POSES)
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder, rng = Path(name), np.random.default_rng([44, user.number])
        q = user.posed(POSES, rng)
        conditions = user.placed(user.conditions(POSES), rng, stations)
        joints, points = user.measured(q, conditions, rng)
        points[POSES // 2 :] *= 1.0 + scale
        joints[:, joint] /= ratio
        write_readings(folder / "a.csv", user, joints, points, user.columns(conditions))
        user.description(folder)
        made = lc.init(folder / "a.csv", dh=folder / "dh.csv")
        fit = lc.Fit(method="implicit-loop", model_error="structured")
        noise, data = made.noise, made.dataset
        return ordered_system(calibrate(made.mechanism, data, noise=noise, fit=fit, trusted=True))


def lengths_of(system: OrderedSystem) -> list[int]:
    """The positions of the lengths that keep to the drawing."""
    parameters = system.problem.mechanism.parameters
    roles = [parameters[name].role for name in system.problem.names]
    return [i for i, role in enumerate(roles) if role == "length" and system.precision[i] > 0.0]


def within(system: OrderedSystem, length: float) -> OrderedSystem:
    """The system with lengths that are known to so much [m]."""
    precision = system.precision.copy()
    precision[lengths_of(system)] = length**-2
    return replace(system, precision=precision)


def drawn(system: OrderedSystem, scale: float, seed: int) -> tuple[ScaleEntry, ...]:
    """The scales of equations drawn anew, the last station's scale being this."""
    rng, known = np.random.default_rng([45, seed]), system.precision > 0.0
    sds = np.where(known, 1.0 / np.sqrt(np.where(known, system.precision, 1.0)), 0.0)
    sds[len(sds) - system.smooth :] = 0.0
    noise = rng.standard_normal(system.E.shape) * system.rows
    errors = sds * rng.standard_normal(len(sds))
    E = system.Z @ errors + noise
    # A calibration learns how well the lengths keep to the drawing from these lengths.
    at, parameters = lengths_of(system), system.problem.mechanism.parameters
    nominal = np.array([parameters[system.problem.names[i]].nominal for i in at])
    off = errors[at] + scale * nominal * (not system.problem.mechanism.families[1:])
    system = within(system, float(np.sqrt(np.square(off).mean())))
    E = E + scale * scale_columns(system)[-1][1][:, :, 0]
    # A calibration has its equations where it ends.
    flat, rows = system.Z.reshape(-1, len(sds)), E.reshape(-1)
    prior = np.diag(np.sqrt(system.precision))
    z = np.linalg.lstsq(np.vstack([flat, prior]), np.pad(rows, (0, len(sds))), rcond=None)[0]
    z[len(z) - system.smooth :] = 0.0
    return scales(replace(system, E=E - system.Z @ z, pull=-system.precision * z).fitted())


def row(kind: str, length: float, systems: list[OrderedSystem], scale: float, draws: int) -> str:
    every = [drawn(one, scale, seed) for one in systems for seed in range(draws)]
    some = [
        (one, one.p_value * len(entries) < RARE)
        for entries in every
        for one in entries
        if bool(one.instruments) == (kind == "station")
    ]
    sizes, sds = (np.array([getattr(one, key) for one, _ in some]) for key in ("size", "sd"))
    below = 100.0 * np.mean([one.p_value < 0.05 for one, _ in some])
    named = 100.0 * np.mean([sure for _, sure in some])
    z = np.sqrt(np.mean(np.square((sizes - scale) / sds)))
    return (
        f"{kind:<8}{1e3 * length:>13.2f}{1e6 * scale:>13.0f}{len(some):>7}{below:>9.0f} %"
        f"{named:>5.0f} %{1e6 * sizes.mean():>12.0f}{1e6 * np.median(sds):>10.0f}{z:>6.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=70, help="of each machine")
    parser.add_argument("--write", type=Path, nargs="?", const=PAGE)
    given = parser.parse_args()
    rows = [
        "kind     lengths [mm]  scale [ppm]  draws  below 5 %  named  mean [ppm]  sd [ppm]     z"
    ]
    for kind, stations, lengths in (("station", 2, (3e-4,)), ("drawing", 1, (2e-5, 3e-4))):
        systems = [begun(number, stations) for number in MACHINES]
        for length in lengths:
            some = [within(one, length) for one in systems]
            for scale in LARGE if kind == "drawing" and length == 3e-4 else SCALES:
                rows.append(row(kind, length, some, scale, given.draws))
                print(rows[-1], flush=True)
    if given.write is not None:
        write_block(given.write, "scales", "\n".join(rows))


if __name__ == "__main__":
    main()
