"""What the MA1400's workspace set is made of: what moved, what bends, and how that is judged.

By random folds, by folds of neighbouring poses, and where poses are unlike those that were fitted.

    LOOPCAL_DATA=... python -m analyses.workspace [--svg FILE]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.mechanisms.chain import product

Array = NDArray[np.float64]
PROJECT = Path(__file__).parents[1] / "examples" / "motoman" / "right_arm_elastic.toml"
RUNS = ((1, 13), (14, 86), (86, 170), (170, 1000))
"""Poses between which the reflector sat still."""
LEVELS = {
    "geometric": (),
    "reflector": ("reflector",),
    "elastic drives": ("reflector", "drives"),
    "elastic arm": ("reflector", "drives", "bearings"),
    "elastic arm, drift": ("reflector", "drives", "bearings", "drift"),
    "elastic arm, drift, gears": ("reflector", "drives", "bearings", "drift", "gears"),
}
BLOCK = 20
"""Poses that stay together in folds of neighbours."""


def fitted(project: lc.Project, data: lc.Dataset, effects: tuple[str, ...]) -> lc.Result:
    """Least squares with these effects."""
    off = [
        name
        for effect, own in project.mechanism.effects.items()
        if effect not in effects
        for name in own
    ]
    machine = project.mechanism
    machine = machine.with_parameters(machine.parameters.with_fixed(off))
    return lc.calibrate(machine, data, method="least-squares")


def in_the_flange(result: lc.Result, data: lc.Dataset) -> Array:
    """Measured minus computed point (3, N) [m] in the flange's frame, at a result's parameters."""
    machine, value = result.mechanism, dict(result.value)
    predicted = lc.predict(result, data)
    off = np.array([data[axis] - predicted.outputs[axis] for axis in "xyz"])
    joints = [q for q in machine.quantities if q.startswith("theta")]
    for i in range(len(data)):
        T = product(machine.chain, {q: float(data[q][i]) for q in joints}, value)
        off[:, i] = T[:3, :3].T @ off[:, i]
    return off


def number(data: lc.Dataset) -> Array:
    """Numbers of the poses."""
    return np.array([float(pose) for pose in data.poses])


def where(data: lc.Dataset, chosen: Callable[[Array], NDArray[np.bool_]]) -> lc.Dataset:
    """The poses whose numbers are chosen."""
    return data.take(np.flatnonzero(chosen(number(data))))


def judged(
    project: lc.Project, data: lc.Dataset, groups: list[int] | None, folds: int = 10
) -> dict[str, float]:
    """Rms [mm] on poses not used, by level."""
    models = {name: lc.Model(effects) for name, effects in LEVELS.items() if effects}
    found = lc.compare_models(
        project.mechanism,
        data,
        models,
        method="least-squares",
        folds=folds,
        groups=groups,
    )
    return {
        m.name: float("nan")
        if m.validation is None or m.validation.accuracy is None
        else 1e3 * m.validation.accuracy.rms
        for m in found.models
    }


def drawing(runs: Array, residuals: Array) -> str:
    """The residuals in the flange's frame over the number of the pose, as SVG."""
    wide, high, left, top, most = 720, 300, 60, 20, 3.0
    inks = ("#1f77b4", "#d62728", "#2ca02c")

    def at(pose: float, value: float) -> tuple[float, float]:
        return left + (wide - left - 20) * pose / 690, top + (high - 60) * (most - value) / 12

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{wide}" height="{high}" fill="white"/>',
    ]
    for value in (-8, -6, -4, -2, 0, 2):
        x, y = at(0, value)
        lines.append(f'<path d="M{x:.0f},{y:.1f}H{wide - 20}" stroke="#ddd"/>')
        lines.append(f'<text x="{x - 8:.0f}" y="{y + 4:.1f}" text-anchor="end">{value}</text>')
    for pose in range(0, 700, 100):
        x, y = at(pose, -9)
        lines.append(f'<text x="{x:.0f}" y="{y + 18:.1f}" text-anchor="middle">{pose}</text>')
    for axis, ink, row in zip("xyz", inks, residuals, strict=True):
        dots = "".join(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6"/>'
            for pose, value in zip(runs, row, strict=True)
            for x, y in [at(pose, max(-9.0, min(most, 1e3 * value)))]
        )
        lines.append(f'<g fill="{ink}" fill-opacity="0.7">{dots}</g>')
        x = 540 + 60 * "xyz".index(axis)
        lines.append(f'<text x="{x}" y="200" fill="{ink}">{axis}</text>')
    lines.append(f'<text x="{wide / 2}" y="{high - 6}" text-anchor="middle">pose</text>')
    middle = high / 2 - 20
    lines.append(
        f'<text x="16" y="{middle}" transform="rotate(-90 16 {middle})" text-anchor="middle">'
        "measured minus computed [mm]</text>"
    )
    return "\n".join([*lines, "</svg>", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--svg", type=Path)
    given = parser.parse_args()
    project = lc.read_project(PROJECT)
    data = lc.load_dataset(project).dataset
    late = where(data, lambda n: n >= 170)
    calm = fitted(project, late, ("drives", "bearings"))
    off = in_the_flange(calm, data)
    print("measured minus computed point in the flange's frame, geometry of the poses from 170 on")
    for first, end in RUNS:
        part = off[:, (number(data) >= first) & (number(data) < end)]
        mean, spread = 1e3 * part.mean(axis=1), 1e3 * part.std(axis=1)
        told = " ".join(f"{m:+.2f} ({s:.2f})" for m, s in zip(mean, spread, strict=True))
        print(f"  poses {first:3} to {min(end, 686) - 1:3}: {part.shape[1]:3}  mean (sd) {told} mm")
    if given.svg:
        given.svg.write_text(drawing(number(data), off), "utf-8")
    for used, whose in ((where(data, lambda n: n >= 14), "from 14 on"), (late, "from 170 on")):
        many = len(used)
        ranks = np.argsort(np.argsort(used["theta_1"]))
        ways = {
            "random poses": None,
            f"blocks of {BLOCK} neighbours": [i // BLOCK for i in range(many)],
            "tenths in the order of poses": [10 * i // many for i in range(many)],
            "tenths of the range of S": (10 * ranks // many).tolist(),
        }
        for name, groups in ways.items():
            found = judged(project, used, groups)
            print(f"{name}, {whose} ({many} poses), rms on poses not used [mm]")
            print("  " + ", ".join(f"{k} {v:.3f}" for k, v in found.items()), flush=True)


if __name__ == "__main__":
    main()
