"""From one region of the workspace to others: what each part of the model error is worth.

Of the measured MA1400 workspace set (poses from 170 on) a region of 120 poses, nearest to one pose
by the cosine and sine of the joints, calibrates the machine in five ways: the nominal machine,
placed and mounted; least squares; shrinkage of lengths and angles to the drawing; compliance and
gears besides; the smooth discrepancy besides. The other poses are three regions by their distance:
near, farther and far. Drawn is the rms distance there over several such regions.

    LOOPCAL_DATA=/path/to/data python -m analyses.transfer [--regions 6] [--svg FILE] [--write]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.corners import PAGE, by_distance, measured
from analyses.written import write_block
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.structure.smooth import vectors_for
from loopcal.statistics.case import Case, nominal_case

Array = NDArray[np.float64]
POSES = 120
REGIONS = ("near", "farther", "far")
LEVELS = ("nominal", "least squares", "shrinkage", "compliance", "discrepancy")
INKS = ("#9e9e9e", "#d55e00", "#e69f00", "#56b4e9", "#0072b2")
"""Distinguishable under deuteranopia (Okabe and Ito)."""
SVG = Path(__file__).parents[1] / "docs" / "explanation" / "transfer.svg"


def fitted(level: str, case: Case) -> FitResult:
    """The calibration of one level."""
    if level == "nominal":
        return nominal_case(case).calibrated()
    if level == "least squares":
        return lc.calibrate(case.mechanism, case.data, method="least-squares")
    bent = level != "shrinkage"
    waves = vectors_for(len(case.data)) if level == "discrepancy" else False
    machine = lc.structured(case.mechanism, sag=bent, harmonics=bent, discrepancy=waves)
    fit = lc.Fit(method="least-squares", model_error="structured")
    return lc.calibrate(machine, case.data, fit=fit)


def transferred(project: lc.Project, data: lc.Dataset, centre: int) -> Array:
    """(levels, regions) rms distances [m] of one region's calibrations."""
    order = by_distance(data, centre)
    case = Case(project.mechanism, data.take(np.sort(order[:POSES])), None, lc.Fit())
    others = [data.take(np.sort(part)) for part in np.array_split(order[POSES:], len(REGIONS))]
    found = np.empty((len(LEVELS), len(REGIONS)))
    for i, level in enumerate(LEVELS):
        result = fitted(level, case)
        for j, other in enumerate(others):
            predicted = lc.predict(result, other)
            off = np.array([predicted.outputs[axis] - other[axis] for axis in "xyz"])
            found[i, j] = math.sqrt(float(np.square(off).sum(axis=0).mean()))
    return found


def drawing(rms: Array) -> str:
    """Bars of rms distances (levels, regions) [mm] over a logarithmic axis, as SVG."""
    wide, high, left, top, bottom = 720, 360, 64, 54, 44
    low, most = 0.1, 10.0

    def up(value: float) -> float:
        share = math.log(min(max(value, low), most) / low) / math.log(most / low)
        return high - bottom - share * (high - bottom - top)

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" '
        'font-family="sans-serif" font-size="13">',
        "<title>Errors in regions that the calibration has not seen</title>",
        f'<rect width="{wide}" height="{high}" fill="white"/>',
    ]
    for tick in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0):
        y = up(tick)
        lines.append(f'<path d="M{left},{y:.1f}H{wide - 16}" stroke="#ddd"/>')
        lines.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    group = (wide - 16 - left) / len(REGIONS)
    bar = 0.8 * group / len(LEVELS)
    for j, region in enumerate(REGIONS):
        begin = left + j * group + 0.1 * group
        for i, ink in enumerate(INKS):
            x, y, value = begin + i * bar, up(rms[i, j]), rms[i, j]
            lines.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{bar - 3:.1f}" '
                f'height="{high - bottom - y:.1f}" fill="{ink}"/>'
            )
            lines.append(
                f'<text x="{x + 0.5 * (bar - 3):.1f}" y="{y - 4:.1f}" text-anchor="middle" '
                f'font-size="11">{value:.2f}</text>'
            )
        middle = begin + 0.4 * group
        lines.append(
            f'<text x="{middle:.1f}" y="{high - bottom + 18}" text-anchor="middle">{region}</text>'
        )
    for i, (level, ink) in enumerate(zip(LEVELS, INKS, strict=True)):
        x = left + i * 128
        lines.append(f'<rect x="{x}" y="14" width="12" height="12" fill="{ink}"/>')
        lines.append(f'<text x="{x + 17}" y="25">{level}</text>')
    y = 0.5 * (high - bottom + top)
    lines.append(
        f'<text x="16" y="{y}" transform="rotate(-90 16 {y})" text-anchor="middle">'
        "rms distance [mm]</text>"
    )
    lines.append(
        f'<text x="{0.5 * (wide + left)}" y="{high - 6}" text-anchor="middle">'
        "other poses, by their distance from those that were measured</text>"
    )
    return "\n".join([*lines, "</svg>", ""])


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--regions", type=int, default=6)
    parser.add_argument("--svg", type=Path, help=f"the figure, {SVG}")
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    asked = parser.parse_args()
    its = measured()
    project, data = its.project, its.data
    centres = np.random.default_rng(1).choice(len(data), asked.regions, replace=False)
    found = np.array([transferred(project, data, int(centre)) for centre in centres])
    rms = 1e3 * np.exp(np.log(found).mean(axis=0))
    lines = [f"{'rms distance [mm], geometric mean':34}" + "".join(f"{r:>10}" for r in REGIONS)]
    for level, row in zip(LEVELS, rms, strict=True):
        lines.append(f"{level:34}" + "".join(f"{v:10.3f}" for v in row))
    print("\n".join(lines))
    if asked.write:
        write_block(PAGE, "transfer", "\n".join(lines))
    if asked.svg:
        asked.svg.write_text(drawing(rms), "utf-8")


if __name__ == "__main__":
    main()
