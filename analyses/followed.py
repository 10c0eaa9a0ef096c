"""Does an update follow the zero of a joint that moved, whichever parameter the calibration held?

An arm of the gauntlet is calibrated with a tracker at 60 poses. Then the zero of one joint moves by
0.05 degrees, the tracker is set up elsewhere and measures 8 poses. `stated` has no error beyond its
geometry and stated sds; `auto` gives way under its weight and is calibrated by default. "ur urdf"
is the arm "ur" described by joint origins, of which more are redundant; it holds the zero of q3.

Printed, as the rms distance [mm] of 200 fresh poses, each prediction placed rigidly on them: the
calibration as it was, the plain update, the update with `drift={"zero": 0.05 deg}`, and a joint
recalibration of all poses that has the station and that one zero of the second day as unknowns; the
largest ratio over it, of the plain update among the draws in which it says that it follows the
zero; in how many draws it says so. The station takes up the zero of the first joint, which needs no
update.

    python -m analyses.followed [--draws 5] [--only MACHINE ...] [--how HOW ...] [--zero DEGREES]
"""

from __future__ import annotations

import argparse
import math
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import loopcal as lc
from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Array
from analyses.gauntlet_worlds import TOOL, Fresh, Readings, Trial, World, bending
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint, joint_chain

ARMS = ("six", "ur", "ur urdf", "seven")
HOW = ("stated", "auto")
POSES, LATER, ZERO = 60, 8, math.radians(0.05)
ALLOWED = 1.3
"""Most that an update may be worse than the recalibration."""


@dataclass(frozen=True)
class Errors:
    """Rms distance [m] at fresh poses: calibration, plain update, update with drift, oracle."""

    none: float
    plain: float
    drift: float
    oracle: float
    said: bool


@dataclass(frozen=True, eq=False)
class Days:
    """One machine on two days: as the user has it, before any zero moved."""

    first: Trial
    later: Trial
    fresh: Fresh

    @classmethod
    def of(cls, arm: str, how: str, draw: int) -> Days:
        """One draw."""
        seed = [zlib.crc32(f"{arm} {how}".encode()), draw]
        worn: Callable[..., truth.Arm] = bending if how == "auto" else lambda arm, rng: arm
        world = World(arm.split()[0], worn=worn)

        def day(number: int, world: World) -> Trial:
            rngs = np.random.default_rng(seed), np.random.default_rng([*seed, number])
            made = world.made(*rngs)
            return replace(made, mechanism=_by_origins()) if arm == "ur urdf" else made

        # The joints of fresh poses are exact: their noise would hide what the calibrations do.
        exact = replace(world, encoder=0.0)
        measured = day(1, replace(world, poses=POSES)), day(2, replace(world, poses=LATER))
        return cls(*measured, day(3, exact).inside)

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints of the arm."""
        return tuple(q for q in self.first.mechanism.quantities if q[0] == "q")

    def calibrated(self, how: str) -> lc.Result:
        """By the poses of the first day."""
        method = "auto" if how == "auto" else "implicit-loop"
        one = self.first
        return lc.calibrate(one.mechanism, one.readings, noise=one.noise, method=method)

    def errors(self, first: lc.Result, joint: str, zero: float = ZERO) -> Errors:
        """After the zero of a joint moved."""
        day = moved(self.later.readings, joint, zero)
        plain = lc.update(first, day)
        drifted = lc.update(first, day, drift={"zero": abs(zero)})
        every = self.recalibrated(first, drifted, joint, day)
        said = any(f"the zero of {joint} anew" in words for words in plain.warnings)
        return Errors(
            self.error(first, joint, zero),
            self.error(plain, joint, zero),
            self.error(drifted, joint, zero),
            self.error(every, joint, zero),
            said,
        )

    def recalibrated(
        self, first: lc.Result, near: lc.Result, joint: str, day: Readings
    ) -> lc.Result:
        """By the poses of both days, with what changed in between as further unknowns."""
        stands = first.mechanism.parameters.of_role("placement")
        changes = lc.effects.Shift((joint, *stands), at=(POSES,), name="between the days")
        machine = lc.with_effects(first.mechanism, [changes])
        new = {name: f"{name}_from{POSES}" for name in (joint, *stands)}
        free = machine.parameters.with_prior(dict.fromkeys(new.values(), math.inf))
        start = {n: first.value[n] for n in first.estimated}
        start |= {new[n]: near.value[n] - first.value[n] for n in stands}
        both = {q: np.concatenate([v, day[q]]) for q, v in self.first.readings.items()}
        both["pose"] = np.arange(float(POSES + LATER))
        machine = machine.with_parameters(free)
        noise = self._noise(first)
        return lc.calibrate(machine, both, noise=noise, method="implicit-loop", start=start)

    def _noise(self, first: lc.Result) -> lc.Noise:
        """The stated sds; beside them that of the model, learnt again, where it was learnt."""
        stated = self.first.noise
        assert stated is not None
        model = [entry.sd for entry in first.noise if entry.role == "disturbance"]
        if not model:
            return stated
        return lc.Noise(
            {**stated.entries, "model": max(model[0], 1e-6)}, estimate={"model": "group"}
        )

    def error(self, result: Any, joint: str, zero: float) -> float:
        """Rms distance [m] of a result, in memory or saved, at the fresh poses."""
        fresh = self.fresh
        predicted = lc.predict(result, moved(fresh.readings, joint, zero))
        points = np.column_stack([predicted.outputs[q] for q in fresh.outputs])
        off = rigidly(points, fresh.true) - fresh.true
        return math.sqrt(float(np.square(off).sum(axis=1).mean()))


def moved(readings: Readings, joint: str, zero: float) -> Readings:
    """Readings of a joint whose zero moved: what is true exceeds what is read by so much more."""
    return {**readings, joint: readings[joint] - zero}


def rigidly(points: Array, onto: Array) -> Array:
    """Points (N, 3) moved rigidly onto others."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    placed: Array = a @ (U @ Vt).T + onto.mean(axis=0)
    return placed


def _by_origins() -> lc.Mechanism:
    """The arm "ur" as a URDF describes it: each joint by its origin in the frame before it."""
    joints, before = [], truth.Link()
    for i, link in enumerate(truth.UR.links, 1):
        origin = (before.a, 0.0, before.d), (before.alpha, 0.0, 0.0)
        joints.append(LinkJoint(f"q{i}", "revolute", *origin, axis=(0.0, 0.0, 1.0)))
        before = link
    joints.append(LinkJoint("flange", "fixed", (before.a, 0.0, before.d), (before.alpha, 0.0, 0.0)))
    tool = {f"tool_{c}": float(v) for c, v in zip("xyz", TOOL, strict=True)}
    made = assemble(joint_chain(joints), [point(readings=("x", "y", "z"))])
    # A length in its place, so that a zero that moves is one that the calibration held.
    return lc.fix_redundant(made.with_nominal(tool), keep=["q3_y"])


def study(arms: list[str], how: list[str], draws: int, zero: float) -> Iterator[str]:
    """The lines of the table."""
    yield f"{'':18}joint  none  plain  drift  oracle [mm]  plain/oracle  drift/oracle  said"
    for arm in arms:
        for one in how:
            days = [Days.of(arm, one, draw) for draw in range(draws)]
            first = [day.calibrated(one) for day in days]
            for joint in days[0].joints:
                errors = [d.errors(f, joint, zero) for d, f in zip(days, first, strict=True)]
                means = [
                    1e3 * float(np.mean([getattr(e, k) for e in errors]))
                    for k in ("none", "plain", "drift", "oracle")
                ]
                plain = max((e.plain / e.oracle for e in errors if e.said), default=math.nan)
                drift = max(e.drift / e.oracle for e in errors)
                said = sum(e.said for e in errors)
                sizes = "  ".join(f"{m:.4f}" for m in means)
                yield f"{arm:8} {one:8} {joint:4} {sizes}  {plain:.2f}  {drift:.2f}  {said}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--only", nargs="*", default=list(ARMS), choices=ARMS)
    parser.add_argument("--how", nargs="*", default=list(HOW), choices=HOW)
    parser.add_argument("--zero", type=float, default=0.05, help="degrees")
    given = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for line in study(given.only, given.how, given.draws, math.radians(given.zero)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
