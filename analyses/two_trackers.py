"""What the noise of two trackers is told as, one of them far away, and what that costs.

A six-axis arm in 60 poses; its reflector is read in every pose by a tracker 2.5 m away and by one
12 m away. Noise in range and angles by the maker's figures of the Leica AT500, 5 urad in the
joints. The same readings are then calibrated

- native: in range, azimuth and elevation, each with its own sd;
- covariance: in x, y, z, every reading with the full covariance of the place where it was taken;
- isotropic: in x, y, z with one sd for each tracker, the rms of its true ones;
- one isotropic: with one sd for both.

For the arm's own parameters: their sd over the draws beside that of `native`, in the median and at
most. For these and for the stations' parameters: the stated sd beside the sd over the draws, the
least and the most of them. And the share of stated 95 % intervals that hold.

    python -m analyses.two_trackers [--draws 2000] [--processes 2] [--write FILE.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses.instruments import ARM_VALUES, FIRST, JOINTS, LAST, six_axis
from analyses.written import write_block
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import assemble

Array = NDArray[np.float64]
SIGMAS = 1.959963984540054
TRACKERS = ("near", "far")
WAYS = ("native", "covariance", "isotropic", "one isotropic")
STATIONS = {
    **{"near_x": 2.4, "near_y": -0.5, "near_z": -0.6, "near_rz": 0.7},
    **{"far_x": 11.6, "far_y": 2.0, "far_z": -2.2, "far_rz": 2.0, "far_ry": 0.1},
}
ENCODER = 5e-6
HELD = (*FIRST, *LAST)


def native_names(tracker: str) -> tuple[str, str, str]:
    return (f"{tracker}_range", f"{tracker}_azimuth", f"{tracker}_elevation")


def cartesian_names(tracker: str) -> tuple[str, str, str]:
    return (f"{tracker}_seen_x", f"{tracker}_seen_y", f"{tracker}_seen_z")


@cache
def machine(native: bool) -> lc.Mechanism:
    """The arm, seen by both trackers in one way or the other; the same parameters."""
    looking = [
        spherical(t) if native else point(t, readings=cartesian_names(t), station=t)
        for t in TRACKERS
    ]
    made = assemble(six_axis(), looking, ARM_VALUES | STATIONS)
    return made.with_parameters(made.parameters.with_fixed(HELD))


NATIVE_NOISE = lc.Noise(
    {"q*": ENCODER} | {native_names(t): lc.Tracker.of("leica-at500", native=True) for t in TRACKERS}
)


def readings(seed: int) -> lc.Simulation:
    poses = lc.random_poses(dict.fromkeys(JOINTS, (-1.6, 1.6)), 60, seed=7)
    return lc.simulate(machine(True), poses, noise=NATIVE_NOISE, seed=seed)


def in_coordinates(data: lc.Dataset) -> dict[str, Array]:
    """The same readings as x, y, z in each tracker's own frame."""
    found = {q: data[q] for q in JOINTS}
    for tracker in TRACKERS:
        r, azimuth, elevation = (data[name] for name in native_names(tracker))
        level = r * np.cos(elevation)
        points = (level * np.cos(azimuth), level * np.sin(azimuth), r * np.sin(elevation))
        found |= dict(zip(cartesian_names(tracker), points, strict=True))
    return found


@cache
def isotropic_sds() -> dict[str, float]:
    """Root mean square of the true sds of a tracker's coordinates [m]."""
    exact = in_coordinates(readings(0).dataset)
    sds = {}
    for tracker in TRACKERS:
        points = np.array([exact[name] for name in cartesian_names(tracker)]).T
        covariances = lc.tracker_covariance(points, "leica-at500")
        sds[tracker] = float(np.sqrt(np.einsum("nii->n", covariances).mean() / 3))
    return sds


def noise(way: str) -> lc.Noise:
    """What the calibration is told."""
    joints: dict[str | tuple[str, ...], object] = {"q*": ENCODER}
    sds = isotropic_sds()
    if way == "native":
        return NATIVE_NOISE
    if way == "covariance":
        tracker = lc.Tracker.of("leica-at500")
        return lc.Noise(joints | {cartesian_names(t): tracker for t in TRACKERS})
    both = float(np.sqrt(np.mean(np.square(list(sds.values())))))
    told = {t: both if way == "one isotropic" else sds[t] for t in TRACKERS}
    return lc.Noise(joints | {f"{t}_seen_?": told[t] for t in TRACKERS})


@dataclass(frozen=True)
class Found:
    """Of some draws: errors, sds, (draws, parameters) [SI], error = truth less estimate."""

    errors: Array
    sds: Array

    @property
    def spread(self) -> Array:
        """The sd of every parameter over the draws, whose mean is known: the truth."""
        root: Array = np.sqrt(np.square(self.errors).mean(axis=0))
        return root


def estimated() -> tuple[str, ...]:
    """Names of the estimated parameters."""
    return machine(True).parameters.free


def run(way: str, seeds: Sequence[int]) -> Found:
    """Calibrations with the noise told in one way, one for each seed."""
    arm, told = machine(way == "native"), noise(way)
    errors, sds = [], []
    for seed in seeds:
        data = readings(seed).dataset
        given = data if way == "native" else lc.Dataset.from_arrays(in_coordinates(data))
        found = lc.calibrate(arm, given, noise=told, start="nominal", method="implicit-loop")
        assert found.status.converged
        errors.append([arm.parameters[n].nominal - found.value[n] for n in estimated()])
        sds.append([found.sd[n] or 0.0 for n in estimated()])
    return Found(np.array(errors), np.array(sds))


@dataclass(frozen=True)
class Row:
    """What one way of telling the noise costs.

    worse: (arm parameters,) sd over the draws beside that of native; stated: (parameters,) stated
    sd beside the sd over the draws; held: share of the 95 % intervals that hold.
    """

    worse: Array
    stated: Array
    held: float


def compared(found: Mapping[str, Found]) -> dict[str, Row]:
    """Every way beside native."""
    own = np.array([not name.startswith(TRACKERS) for name in estimated()])
    return {
        way: Row(
            (its.spread / found["native"].spread)[own],
            its.sds.mean(axis=0) / its.spread,
            float((np.abs(its.errors) <= SIGMAS * its.sds).mean()),
        )
        for way, its in found.items()
    }


def gathered(draws: int, processes: int) -> dict[str, Found]:
    """All ways, the draws shared among processes."""
    parts = [range(i, draws, processes) for i in range(processes)]
    found = {}
    with ProcessPoolExecutor(processes) as pool:
        for way in WAYS:
            some = list(pool.map(run, [way] * processes, parts))
            found[way] = Found(
                np.concatenate([f.errors for f in some]), np.concatenate([f.sds for f in some])
            )
    return found


def table(found: Mapping[str, Found]) -> str:
    """The comparison in words and numbers."""
    draws = len(found["native"].errors)
    lines = [
        f"{draws} draws; the sd of an sd over so many draws is {50 * np.sqrt(2 / draws):.1f} %",
        "",
        "                sd of the arm's parameters      stated sd beside       95 % intervals",
        "                beside native                   sd over the draws      that hold",
        "noise told as   median        most              least      most",
    ]
    for way, row in compared(found).items():
        lines.append(
            f"{way:13} {np.median(row.worse):8.2f} {row.worse.max():11.2f}"
            f" {row.stated.min():18.2f} {row.stated.max():9.2f} {100 * row.held:16.1f} %"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    text = table(gathered(given.draws, given.processes))
    print(text)
    if given.write:
        write_block(given.write, "two_trackers", text)


if __name__ == "__main__":
    main()
