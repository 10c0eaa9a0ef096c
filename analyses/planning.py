"""Do planned poses keep what they promise, and by how much do they beat random ones?

Simulated: on a UR10-like arm, the MA1400 and a Stewart-Gough platform, the predicted variance of 30
planned poses beside 48 random ones, and the scatter of calibrations beside the promised sds.
Measured: on the MA1400's workspace set, 60 of the poses from 170 on chosen by plan and by random
draws; error of both on the other poses.

    LOOPCAL_DATA=... python -m analyses.planning [--draws 500] [--sets 50] [--write FILE]
    python -m analyses.planning --svg FILE
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.machines import STEWART_GOUGH, TOOL
from analyses.written import write_block
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.planar import motoman_ma1400

Array = NDArray[np.float64]
SIX_AXIS = Path(__file__).parents[1] / "examples" / "six_axis" / "project.toml"
MEASURED = Path(__file__).parents[1] / "examples" / "motoman" / "right_arm_elastic.toml"
FROM, CHOSEN = 170, 60
"""From this pose on the reflector of the workspace set sat still."""


@dataclass(frozen=True)
class Case:
    """A machine, where it is driven, and the sds of its sensors."""

    mechanism: Mechanism
    ranges: Mapping[str, tuple[float, float]]
    noise: Mapping[str, float]

    def settings(self, number: int) -> lc.PlanSettings:
        """Geometry alone, from so many candidates."""
        return lc.PlanSettings(self.ranges, number=number, model_error="none")


def ur10() -> Mechanism:
    """The UR10 by Denavit and Hartenberg, its parallel axes by Hayati; 27 parameters remain."""
    joints = [lc.Joint(f"theta_{i}", "hayati" if i in (2, 3) else "dh") for i in range(1, 7)]
    half = math.pi / 2
    nominal = {
        **{"d_1": 0.1273, "alpha_1": half, "a_2": -0.612, "a_3": -0.5723, "d_4": 0.163941},
        **{"alpha_4": half, "d_5": 0.1157, "alpha_5": -half, "d_6": 0.0922},
        **{"tool_x": 0.05, "tool_z": 0.1, "base_x": 2.5, "base_rz": 0.7},
    }
    made = lc.serial_arm(joints, nominal, name="UR10")
    fixed = ["d_1", "offset_1", "a_6", "d_6", "alpha_6", "offset_6"]
    return made.with_parameters(made.parameters.with_fixed(fixed))


def cases() -> dict[str, Case]:
    """The three machines."""
    joints = {f"theta_{i}": (-2.0, 2.0) for i in range(1, 7)}
    arm = {"theta_*": 50e-6, "x": 15e-6, "y": 15e-6, "z": 15e-6}
    platform = assemble(stewart_gough(), [point()])
    free = set(platform.parameters.free)
    platform = platform.with_nominal({n: v for n, v in TOOL.items() if n in free})
    unread = dict.fromkeys((q for q in platform.quantities if q.startswith("platform_")), math.inf)
    legs = {"*": 10e-6, **unread}
    return {
        "UR10": Case(ur10(), joints, arm),
        "MA1400": Case(motoman_ma1400(), joints, arm),
        "Stewart-Gough": Case(platform, STEWART_GOUGH, legs),
    }


@dataclass(frozen=True)
class Beside:
    """Mean predicted variance [SI squared] of planned poses and of random sets."""

    planned: float
    random: float
    efficiency: float


def beside_random(case: Case, candidates: int, planned: int, random: int, sets: int) -> Beside:
    """The same candidates, chosen and drawn."""
    settings = case.settings(candidates)
    made = lc.plan(case.mechanism, planned, noise=case.noise, settings=settings)
    assert made.expected.end_point is not None
    draws = promised_by_random(case, candidates, random, sets)
    return Beside(made.expected.end_point**2, float(np.mean(draws)), made.efficiency)


def promised_by_random(case: Case, candidates: int, number: int, sets: int) -> list[float]:
    """Mean predicted variance of random sets of the candidates, over the same test poses."""
    from loopcal.measurements.noise import Noise
    from loopcal.planning.candidates import drawn, ranges_of
    from loopcal.planning.plan import pooled
    from loopcal.planning.search import criterion_value

    settings = case.settings(candidates)
    pool = drawn(case.mechanism, ranges_of(case.mechanism, case.ranges, None), settings)
    draw = pooled(case.mechanism, pool, None, Noise(dict(case.noise)), settings).draws[0]
    rng = np.random.default_rng(7)
    return [
        criterion_value(draw, draw.of(rng.permutation(pool.even)[:number]), "I")
        for _ in range(sets)
    ]


@dataclass(frozen=True)
class Kept:
    """Root mean square of (scatter / promised sd) over parameters, and its standard error."""

    ratio: float
    error: float
    end_point: float


def kept(case: Case, candidates: int, poses: int, draws: int) -> Kept:
    """Calibrations of simulated readings at the planned poses, beside what the plan promised."""
    made = lc.plan(case.mechanism, poses, noise=case.noise, settings=case.settings(candidates))
    names = [n for n in made.units if made.expected.parameters[n] is not None]
    promised = np.array([made.expected.parameters[n] for n in names], dtype=float)
    driven = {q: made.poses[q] for q in made.poses.readings if q in case.ranges}
    truth = {p.name: p.nominal for p in case.mechanism.parameters}
    found = []
    for seed in range(draws):
        read = lc.simulate(case.mechanism, driven, noise=case.noise, seed=seed)
        result = lc.calibrate(
            case.mechanism,
            read.dataset,
            noise=case.noise,
            method="implicit-loop",
            start="nominal",
        )
        found.append([result.value[n] - truth[n] for n in names])
    squares = np.square(np.array(found) / promised)
    by_draw = squares.mean(axis=1)
    ratio = math.sqrt(by_draw.mean())
    error = float(by_draw.std(ddof=1)) / math.sqrt(draws) / (2.0 * ratio)
    return Kept(ratio, error, float(np.mean(made.expected.end_point or math.nan)))


def measured(sets: int, draws_of: Sequence[str] = ("none", "structured")) -> list[str]:
    """Rms [mm] on the poses that were not chosen, planned beside random."""
    project = lc.read_project(MEASURED)
    machine = project.mechanism
    off = [n for names in machine.effects.values() for n in names]
    machine = machine.with_parameters(machine.parameters.with_fixed(off))
    data = lc.load_dataset(project).dataset
    late = np.array([float(pose) >= FROM for pose in data.poses])
    data = data.take(np.flatnonzero(late))
    lines = []
    for model_error in draws_of:
        planned = chosen_measured(machine, data, model_error)
        lines.append(_line(machine, data, planned, model_error, sets))
    return lines


NOISE = {"theta_*": 50e-6, "x": 50e-6, "y": 50e-6, "z": 50e-6}


def chosen_measured(machine: Mechanism, data: lc.Dataset, model_error: str) -> NDArray[np.intp]:
    """Positions of the poses that the plan chooses: it sees joints, no point."""
    aligned = lc.calibrate(machine, data.take(np.arange(0, len(data), 20)), method="least-squares")
    made = lc.plan(
        aligned.calibrated,
        CHOSEN,
        noise=NOISE,
        candidates=data,
        settings=lc.PlanSettings(model_error=model_error),
    )
    where = {pose: i for i, pose in enumerate(data.poses)}
    return np.array([where[pose] for pose in made.poses.poses])


def _line(
    machine: Mechanism, data: lc.Dataset, planned: NDArray[np.intp], model_error: str, sets: int
) -> str:
    own = error_elsewhere(machine, data, planned, model_error)
    rng = np.random.default_rng(1)
    others = np.array(
        [
            error_elsewhere(machine, data, rng.permutation(len(data))[:CHOSEN], model_error)
            for _ in range(sets)
        ]
    )
    low, middle, high = np.percentile(others, [5, 50, 95])
    beaten = float((others > own).mean())
    return (
        f"{model_error:<12}{own:>9.3f}{middle:>15.3f}{low:>9.3f}{high:>9.3f}{100 * beaten:>14.0f} %"
    )


def error_elsewhere(
    machine: Mechanism, data: lc.Dataset, chosen: NDArray[np.intp], model_error: str
) -> float:
    """Rms [mm] of the points of all other poses; gross errors beside the middle count as 10."""
    rest = np.setdiff1d(np.arange(len(data)), chosen)
    fitted = lc.calibrate(
        machine, data.take(chosen), method="least-squares", model_error=model_error
    )
    other = data.take(rest)
    ahead = lc.predict(fitted, other)
    gap = np.array([ahead.outputs[q] - other[q] for q in "xyz"])
    size = 1e3 * np.sqrt(np.square(gap).sum(axis=0))
    return float(np.sqrt(np.square(size).mean()))


def table(draws: int, sets: int) -> str:
    """Everything, as text."""
    lines = [f"{'':<16}{'30 planned':>12}{'48 random':>12}{'bound':>8}{'scatter / promised':>22}"]
    for name, case in cases().items():
        found = beside_random(case, 3000, 30, 48, sets)
        held = kept(case, 3000, 30, draws)
        planned, random = (1e6 * math.sqrt(v) for v in (found.planned, found.random))
        lines.append(
            f"{name:<16}{planned:>9.1f} um{random:>9.1f} um{100 * found.efficiency:>6.0f} %"
            f"{held.ratio:>13.3f} +- {held.error:.3f}"
        )
    return "\n".join(lines)


WIDE, HIGH = 560, 300


def picture(candidates: int = 3000, poses: int = 60) -> str:
    """The UR10's expected sd by the number of poses, planned and random, as SVG."""
    case = cases()["UR10"]
    made = lc.plan(case.mechanism, poses, noise=case.noise, settings=case.settings(candidates))
    assert made.random is not None
    planned = [(p.poses, p.end_point) for p in made.curve if p.end_point]
    random = [(n, sd) for n, sd in zip(made.random.poses, made.random.end_point, strict=True) if sd]
    random = [(n, sd) for n, sd in random if n <= 2 * poses]
    planned = [(n, sd) for n, sd in planned if sd < 2.0 * random[0][1]]
    every = [1e6 * sd for _, sd in planned + random]
    low, high = math.log10(0.9 * min(every)), math.log10(1.1 * max(every))

    def at(n: int, sd: float) -> str:
        x = 60 + (WIDE - 80) * n / (2 * poses)
        y = 20 + (HIGH - 70) * (high - math.log10(1e6 * sd)) / (high - low)
        return f"{x:.1f},{y:.1f}"

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {HIGH}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{WIDE}" height="{HIGH}" fill="#fff"/>',
    ]
    for mark in (10, 20, 30, 50, 100, 200):
        if low < math.log10(mark) < high:
            left, right = at(0, mark * 1e-6), at(2 * poses, mark * 1e-6)
            lines.append(f'<polyline points="{left} {right}" stroke="#ddd" fill="none"/>')
            x, y = left.split(",")
            lines.append(
                f'<text x="{float(x) - 6:.0f}" y="{float(y) + 4:.0f}" '
                f'text-anchor="end">{mark}</text>'
            )
    for n in range(0, 2 * poses + 1, 20):
        x = at(n, 1e-6 * 10**low).split(",")[0]
        lines.append(f'<text x="{x}" y="{HIGH - 32}" text-anchor="middle">{n}</text>')
    for points, colour, name in ((random, "#8d8f96", "random"), (planned, "#2b7bd6", "planned")):
        drawn = " ".join(at(n, sd) for n, sd in points)
        lines.append(f'<polyline points="{drawn}" stroke="{colour}" stroke-width="2" fill="none"/>')
        x, y = at(*points[len(points) // 3]).split(",")
        shift = -10 if name == "planned" else 10
        anchor = "end" if name == "planned" else "start"
        lines.append(
            f'<text x="{float(x) + shift:.0f}" y="{float(y) - shift / 2:.0f}" fill="{colour}" '
            f'text-anchor="{anchor}">{name}</text>'
        )
    lines.append(
        f'<text x="{WIDE / 2:.0f}" y="{HIGH - 10}" text-anchor="middle">poses</text>'
        f'<text x="16" y="{HIGH / 2 - 20:.0f}" text-anchor="middle" '
        f'transform="rotate(-90 16 {HIGH / 2 - 20:.0f})">expected sd of the end point [um]</text>'
    )
    return "\n".join([*lines, "</svg>", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--svg", type=Path)
    given = parser.parse_args()
    if given.svg:
        given.svg.write_text(picture(), "utf-8")
        return
    text = table(given.draws, given.sets)
    head = f"{'model error':<12}{'planned':>9}{'random, median':>15}{'5 %':>9}{'95 %':>9}"
    text += f"\n\n{head}{'worse than plan':>16}\n" + "\n".join(measured(given.sets))
    print(text)
    if given.write:
        write_block(given.write, "planning", text)


if __name__ == "__main__":
    main()
