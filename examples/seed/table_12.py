"""The seed's table 12 on measured data, with what the seed could not give.

Each of two measured sets of a Motoman MA1400 is cut in halves, every other pose to either; both
halves are calibrated by least squares and by the implicit loop. Beside the parameters and their
differences, which the seed has, stand the sds of the differences, whether the halves agree within
them, the difference at common poses, and how well each fit predicts the half it has not seen.

    LOOPCAL_DATA=/folder/of/the/data python examples/seed/table_12.py
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import loopcal as lc
from loopcal.presentation.shown import SHOWN, columns, rounded_by_sd, significant
from loopcal.units import from_si

PROJECTS = Path(__file__).resolve().parents[1] / "motoman"
SETS = {
    "left arm, grid": "left_arm_grid.toml",
    "right arm, workspace": "right_arm_model_error.toml",
}
METHODS = ("least-squares", "implicit-loop")
HALVES = ("odd", "even")


@dataclass(frozen=True, eq=False)
class Halves:
    """One method on both halves: the fits, their comparison, and rms on the other half [m]."""

    method: str
    fits: tuple[lc.Result, lc.Result]
    compared: lc.Compared
    elsewhere: tuple[float, float]


def halves(name: str, method: str) -> Halves:
    """Both halves of a project's readings, calibrated by one method and compared."""
    project = lc.read_project(PROJECTS / name)
    loaded = lc.load_dataset(project)
    data = loaded.dataset
    parts = [data.take(slice(first, None, 2)) for first in (0, 1)]
    exact = method == "least-squares"
    noise = None if exact else loaded.noise
    # half of a grid whose poses are alike takes least squares more than the usual 100 steps
    how = {"noise": noise, "method": method, "max_iterations": 400}
    fits = [lc.calibrate(project.mechanism, part, **how) for part in parts]
    # as the seed does: residuals of this grid depend on the pose order, which it does not test
    fits = [fit.as_if_independent() for fit in fits]
    # one sees the other's poses without having used them
    away = [_rms(fit, part) for fit, part in zip(fits, reversed(parts), strict=True)]
    return Halves(method, (fits[0], fits[1]), lc.compare(*fits, align=False), (away[0], away[1]))


def _rms(fit: lc.Result, data: lc.Dataset) -> float:
    found = lc.predict(fit, data)
    measured = np.array([data.readings[q] for q in fit.mechanism.outputs])
    computed = np.array([found.outputs[q] for q in fit.mechanism.outputs])
    return math.sqrt(float(np.square(computed - measured).sum(axis=0).mean()))


def report(title: str, found: list[Halves]) -> list[str]:
    """Table 12 of one data set, and what it means; z beyond 1.96 is marked."""
    lines = [title, "=" * len(title), ""]
    for one in found:
        lines += [one.method, "", *_table(one), "", _words(one), ""]
    basic, new = (one.compared.parameters for one in found)
    rows = [["parameter", "basic difference", "new difference", "difference of these", "unit"]]
    for b, n in zip(basic, new, strict=True):
        unit = SHOWN.get(b.unit, b.unit)
        values = (b.difference, n.difference, b.difference - n.difference)
        rows.append([b.name, *(f"{float(from_si(v, unit)):+.4f}" for v in values), unit])
    return [*lines, *columns(rows), ""]


def _table(one: Halves) -> list[str]:
    rows = [["parameter", *HALVES, "difference", "sd", "z", "unit"]]
    for p in one.compared.parameters:
        unit = SHOWN.get(p.unit, p.unit)
        row = [p.name]
        for value, fit in zip((p.a, p.b), one.fits, strict=True):
            row.append(_with_sd(float(from_si(value, unit)), fit.sd[p.name], unit))
        change = float(from_si(p.difference, unit))
        if p.sd is None or p.z is None:
            rows.append([*row, f"{change:+.4f}", "unknown", "", unit])
            continue
        sd, mark = float(from_si(p.sd, unit)), " *" if abs(p.z) > 1.96 else ""
        changed = rounded_by_sd(change, sd, sign=True)
        rows.append([*row, changed, significant(sd, 2), f"{p.z:+.1f}{mark}", unit])
    return columns(rows)


def _with_sd(value: float, sd: float | None, unit: str) -> str:
    if sd is None:
        return significant(value, 6)
    shown = float(from_si(sd, unit))
    return f"{rounded_by_sd(value, shown)} ± {significant(shown, 2)}"


def _words(one: Halves) -> str:
    tested = [p for p in one.compared.parameters if p.z is not None]
    within = sum(abs(p.z or 0.0) <= 1.96 for p in tested)
    states = [fit.status.reason for fit in one.fits]
    rms = [significant(1e3 * v, 3) for v in one.elsewhere]
    own = [f.accuracy_after.rms for f in one.fits if f.accuracy_after is not None]
    used = [significant(1e3 * v, 3) for v in own]
    return (
        f"{one.method} ({', '.join(states)}): {within} of {len(tested)} differences lie within "
        f"their 95 % interval. {one.compared.verdict()}\n"
        f"  Rms on the poses used {used[0]} and {used[1]} mm, on the other half's poses "
        f"{rms[0]} and {rms[1]} mm."
    )


def main() -> None:
    """Prints both data sets."""
    for title, name in SETS.items():
        print("\n".join(report(title, [halves(name, method) for method in METHODS])))


if __name__ == "__main__":
    main()
