"""The default call, and a stream with a structured model error, beside plain least squares.

The default call is `lc.calibrate` without a method: candidates with a model error and without,
random and blocked validation, and the verdict. Its machine bends: it is not what was drawn. The
last arm is as real ones are: it sags, its gears and its play leave half a millimetre, and its sds
are stated far too small, so that starts, changes and outliers are searched as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import learning
import numpy as np

import loopcal as lc
from loopcal.estimation.fit import Fit
from loopcal.estimation.stream.calibrate import calibrate_stream
from loopcal.estimation.stream.merit import Chunk

SIZES = (200, 600)
"""Poses of the MA1400 seen by one reflector; those with three reflectors are `learning.POSES`."""
STREAM, CHUNK = 1_000_000, 50_000
DEMANDED_STREAM = 4.0
"""How many times the time of plain least squares a stream with a model error may take."""
SDS = {"theta_*": 5e-5, "xyz": 3e-5}
WRONG = lc.Noise({"q*": 1e-5, **dict.fromkeys(["x?", "y?", "z?"], 1e-5)})
"""As data sheets state them: what the arm below truly errs by is fifty times as much."""
SAG, GEARS, PLAY = 1e-3, 4e-4, 8e-4
"""Of the joints [rad]: of the second and third under weight, of every gear, of every backlash."""


@dataclass(frozen=True)
class Default:
    """Processor time [s] of one case, and how often plain least squares fits into it."""

    case: str
    seconds: float
    ratio: float
    demanded: float | None = None


def measure(stream: int = STREAM) -> list[Default]:
    """Every case once, beside plain least squares of the same readings."""
    arm = lc.motoman_ma1400()
    noise = lc.Noise(SDS)
    cases = [
        _default(f"default call, {poses:,} poses", arm, _readings(arm, poses), noise)
        for poses in SIZES
    ]
    several = learning.arm()
    points = dict.fromkeys(["x?", "y?", "z?"], learning.POINT_SD)
    each = lc.Noise({"q*": learning.JOINT_SD, **points})
    words = f"default call, {learning.POSES:,} poses, {learning.REFLECTORS} reflectors"
    cases.append(_default(words, several, learning.readings(several), each))
    cases.append(_default(f"{words}, sds stated wrong", several, worn(several), WRONG))
    cases.append(_streamed(arm, InMemory(_readings(arm, stream), noise)))
    return cases


def _default(case: str, arm: lc.Mechanism, data: lc.Dataset, noise: lc.Noise) -> Default:
    def plain() -> object:
        return lc.calibrate(arm, data, noise=noise, method="least-squares")

    def default() -> object:
        return lc.calibrate(arm, data, noise=noise).verdict

    return _beside(case, default, plain, rounds=5)


def _streamed(arm: lc.Mechanism, stream: InMemory) -> Default:
    def by(model_error: str) -> Callable[[], object]:
        fit = Fit(method="least-squares", model_error=model_error)
        return lambda: calibrate_stream(arm, stream, fit=fit)

    case = f"stream of {stream.poses:,} poses, structured model error"
    return _beside(case, by("structured"), by("none"), rounds=1, demanded=DEMANDED_STREAM)


def _beside(
    case: str,
    run: Callable[[], object],
    plain: Callable[[], object],
    *,
    rounds: int,
    demanded: float | None = None,
) -> Default:
    if rounds > 1:
        plain()  # traces the loops
    once = min(learning.processor(plain) for _ in range(rounds))
    seconds = learning.processor(run)
    return Default(case, seconds, seconds / once, demanded)


@dataclass(frozen=True)
class InMemory:
    """A stream of readings that are at hand."""

    data: lc.Dataset
    noise: lc.Noise

    @property
    def poses(self) -> int:
        """How many."""
        return len(self.data)

    @property
    def count(self) -> int:
        """Chunks."""
        return -(-self.poses // CHUNK)

    def chunk(self, number: int) -> Chunk:
        """The chunk of this number, from 0."""
        index = np.arange(number * CHUNK, min(self.poses, (number + 1) * CHUNK))
        return Chunk(self.data.take(index), self.noise)


def _readings(arm: lc.Mechanism, poses: int) -> lc.Dataset:
    """Of an arm whose second joint gives way by half a milliradian under its own weight."""
    rng = np.random.default_rng(1)
    free = [p for p in arm.parameters if not p.fixed]
    truth = {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in free}
    driven = lc.random_poses({f"theta_{i}": (-1.5, 1.5) for i in range(1, 7)}, poses, seed=1)
    made = lc.simulate(arm, driven, noise=lc.Noise(SDS), seed=1, truth=truth).dataset
    read = {q: np.array(made[q]) for q in arm.quantities}
    read["theta_2"] += 5e-4 * np.cos(read["theta_2"])
    return lc.Dataset.from_arrays(read)


def worn(arm: lc.Mechanism) -> lc.Dataset:
    """Readings of three reflectors on an arm that sags, with errors of gears and play."""
    made, rng = learning.readings(arm), np.random.default_rng(2)
    read = {q: np.array(made[q]) for q in arm.quantities}
    joints = [f"q{i}" for i in range(1, 7)]
    bent = {q: GEARS * np.sin(read[q] + rng.uniform(-3.0, 3.0)) for q in joints}
    bent["q2"] += SAG * np.cos(read["q2"])
    bent["q3"] += 0.5 * SAG * np.cos(read["q2"] + read["q3"])
    for q in joints:
        bent[q] += 0.5 * PLAY * np.sign(np.diff(read[q], prepend=0.0))
    return lc.Dataset.from_arrays(read | {q: read[q] + bent[q] for q in joints})


if __name__ == "__main__":
    for found in measure():
        print(found)
