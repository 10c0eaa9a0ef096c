"""Random tapes, readings and noise through both engines, for so many minutes.

    python -m analyses.fuzz_engine --minutes 10

Each round draws loops (some of them absent), a number of poses, how the noise is told and what is
unmeasured, and compares values, derivatives, whitened equations, their sums and corrections of the
compiled engine with those of NumPy: relative to the largest value of each kind in a pose, and
beside what readings and sds changed by a unit or two in the last place do to NumPy's own. Every
tenth round is wild: values leave their domains, readings are no numbers, and the engine must only
survive; in all others the engines give no number in the same places, and the poses of numbers are
compared. In every round vectors of another width and other threads must give the same bits, those
of the search for unmeasured quantities among them. Ends with 1 at the first difference, telling
its seed; else it tells how much of what is allowed was used, and how often the first part alone,
1e-11 beside the size of the values, was not enough.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.block_kernel import BlockKernel, CompiledKernel, NumpyKernel
from loopcal.estimation.solve.kernel import unweighted, whiten
from loopcal.expressions import _compiled
from loopcal.expressions.choice import in_words
from loopcal.expressions.compiled_engine import CompiledEngine
from loopcal.expressions.derivative import linearise
from loopcal.expressions.engine import NumpyEngine, Stage
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty
from tests.reference.random_loops import BINARY, UNARY

Array = NDArray[np.float64]
TOLERANCE, MOVED = 1e-11, 30.0
"""Allowed: TOLERANCE (1 + the largest value) + MOVED times what nudged inputs do to NumPy's values.

Eliminating and whitening are as ill-conditioned as the loops drawn: where no digits are left,
engines that round in another order cannot agree, and what nudges do tells where. They round the
inputs otherwise once; a pose goes through hundreds of operations that do so, which add up as the
root of their number, 10 to 30. One nudge may leave the pose as it is, or along a direction that
does not matter: the larger of two draws seldom does.
"""
WILD: tuple[Callable[..., Any], ...] = (
    np.sqrt, np.log, np.arcsin, np.arccos, np.tan, np.exp, abs, lambda a: 1.0 / a,
    lambda a: a**-3.5, lambda a: 1e200 * a, lambda a: np.exp(a * a), lambda a: np.sin(1e30 * a),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One round: a tape, and a block of poses at some parameters."""

    tape: Tape
    block: Block


def draw(rng: np.random.Generator, wild: bool) -> Case:
    """A case of moderate values, or a wild one."""
    m, k = int(rng.integers(1, 6)), int(rng.integers(2, 9))
    n, c = int(rng.integers(1, 9)), int(rng.integers(0, 3))
    steps, functions = int(rng.integers(3, 30)), UNARY + BINARY
    if wild:
        functions += WILD

    def loops(x: Any, p: Any) -> list[Any]:
        values = [x[i] for i in range(k + c)] + [p[i] for i in range(n)]
        for _ in range(steps):
            function = functions[int(rng.integers(len(functions)))]
            arguments = [values[int(rng.integers(len(values)))] for _ in range(2)]
            values.append(function(*arguments[: 2 if function in BINARY else 1]))
        weights = rng.normal(size=(m, k + 1))
        # the sum of all quantities keeps loops apart and every quantity in them
        return [
            np.sin(values[-1 - r % steps]) + sum(w * x[i] for i, w in enumerate(row[:k]))
            + row[k] * p[r % n] * x[r % k]
            for r, row in enumerate(weights)
        ]  # fmt: skip

    tape = trace(
        loops,
        quantities=[f"x{i}" for i in range(k)],
        pose_constants=[f"c{i}" for i in range(c)],
        parameters=[f"p{i}" for i in range(n)],
    )
    held = [i for i in range(m) if rng.random() < 0.8] or [0]
    poses = int(rng.choice([1, 2, 31, 32, 33, 100, 128, 129, 300, int(rng.integers(1, 1500))]))
    readings = rng.uniform(-2, 2, (k, poses))
    if wild:
        spoilt = rng.random(readings.shape) < 0.02
        readings[spoilt] = rng.choice([np.nan, np.inf, -np.inf, 1e308, 0.0], int(spoilt.sum()))
    parameters = rng.uniform(-2, 2, n) * (rng.random(n) < 0.9)
    return Case(
        tape.only(held),
        Block(
            slice(0, poses),
            parameters,
            readings,
            1e-2 * rng.normal(size=(k, poses)),
            rng.uniform(-1, 1, (c, poses)),
            _noise(rng, k, len(held), poses),
        ),
    )


def _noise(rng: np.random.Generator, k: int, m: int, poses: int) -> BlockNoise:
    most = min(m - 1, k - 1, 3)
    unmeasured = tuple(rng.permutation(k)[: int(rng.integers(0, most + 1))].tolist())
    measured = tuple(i for i in range(k) if i not in unmeasured)
    sd = rng.uniform(0.5, 2.0, (k, poses if rng.random() < 0.5 else 1)) * 1e-3
    sd[list(unmeasured)] = np.inf
    blocks: tuple[CovarianceBlock, ...] = ()
    if rng.random() < 0.5:
        among = tuple(rng.permutation(measured)[: int(rng.integers(1, 4))].tolist())
        size = (len(among), len(among))
        shape = (poses, *size) if rng.random() < 0.5 else size
        blocks = (
            CovarianceBlock(among, 1e-3 * (np.eye(len(among)) + 0.3 * rng.normal(size=shape))),
        )
    return BlockNoise(ReadingUncertainty(sd, blocks), unmeasured, measured)


def nudged(case: Case, rng: np.random.Generator) -> Case:
    """The case with last places of readings and of their uncertainty as if rounded otherwise."""

    def last_places(a: Array) -> Array:
        moved: Array = a * (1.0 + 4e-16 * rng.integers(-2, 3, a.shape))
        return moved

    noise = case.block.noise
    blocks = tuple(CovarianceBlock(b.indices, last_places(b.factor)) for b in noise.blocks)
    noise = replace(noise, uncertainty=ReadingUncertainty(last_places(noise.sd), blocks))
    block = replace(case.block, readings=last_places(case.block.readings), noise=noise)
    return replace(case, block=block)


def numbers(case: Case, compiled: bool, *, exact: bool) -> list[Array]:
    """What one engine makes of the case, as arrays (..., poses)."""
    tape, block, b = case.tape, case.block, case.block.count
    linearisation = linearise(tape, tape.quantities, tape.parameters)
    kernel: BlockKernel
    if compiled:
        ours = CompiledEngine(linearisation, b)
        engine: Any = ours
        kernel = CompiledKernel(ours, exact)
    else:
        engine = NumpyEngine(linearisation, b)
        kernel = NumpyKernel(engine, unweighted if exact else whiten)
    values = engine.evaluate(
        block.parameters, block.corrected, block.pose_constants, Stage.BY_PARAMETER
    )
    found = [a.copy() for a in (values.f, values.by_quantity, values.by_parameter)]
    rows = kernel.equations(block, summed=False)
    assert rows.rows is not None
    found += [rows.rows[:-1].copy(), rows.rows[-1].copy(), rows.correction.copy(), rows.step.copy()]
    total = kernel.equations(block, summed=True).total
    assert total is not None
    return [*found, total[:, :, None], kernel.corrected(block).correction.copy()]


def everything(case: Case, *, exact: bool) -> list[Array]:
    """What the compiled engine makes of the case, the search for unmeasured quantities too."""
    found = numbers(case, True, exact=exact)
    if case.block.noise.unmeasured:
        tape = case.tape
        engine = CompiledEngine(linearise(tape, tape.quantities, tape.parameters), 1)
        found.append(CompiledKernel(engine, exact).search(case.block))
    return found


def same_bits(case: Case, rng: np.random.Generator, *, exact: bool) -> bool:
    """Whether two widths and numbers of threads agree; every NaN counts as the same."""
    found = []
    for _ in range(2):
        _compiled.use_width(str(rng.choice(_compiled.widths())))
        _compiled.use_threads(int(rng.integers(1, 5)))
        found.append(everything(case, exact=exact))
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(*found, strict=True))


@dataclass(frozen=True)
class Apart:
    """How far the engines are apart in so many comparisons, each of one array in one pose.

    worst: the largest difference beside what is allowed, above 1 is too much; above: how many are
    beyond TOLERANCE alone; most: the largest beside that.
    """

    worst: float = 0.0
    comparisons: int = 0
    above: int = 0
    most: float = 0.0

    def __add__(self, other: Apart) -> Apart:
        return Apart(
            max(self.worst, other.worst),
            self.comparisons + other.comparisons,
            self.above + other.above,
            max(self.most, other.most),
        )


def difference(case: Case, rng: np.random.Generator, *, exact: bool) -> Apart:
    """The engines beside each other; of each array the poses in which all values are numbers."""
    ours, theirs = (numbers(case, compiled, exact=exact) for compiled in (True, False))
    moved = [numbers(nudged(case, rng), False, exact=exact) for _ in range(2)]
    found = Apart()
    for arrays in zip(ours, theirs, *moved, strict=True):
        if not np.array_equal(np.isfinite(arrays[0]), np.isfinite(arrays[1])):
            return Apart(np.inf)
        axes = tuple(range(arrays[0].ndim - 1))
        usable = np.all([np.isfinite(array).all(axis=axes) for array in arrays], axis=0)
        a, b, *others = (array[..., usable] for array in arrays)
        if a.size:
            plain = TOLERANCE * (1.0 + np.abs(b).max(axis=axes))
            spread = np.max([np.abs(b - c).max(axis=axes) for c in others], axis=0)
            apart = np.abs(a - b).max(axis=axes)
            found += Apart(
                float((apart / (plain + MOVED * spread)).max()),
                apart.size,
                int((apart > plain).sum()),
                float((apart / plain).max()),
            )
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Rounds until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0, help="of the first round")
    wanted = parser.parse_args(arguments)
    end, seed, total = time.monotonic() + 60.0 * wanted.minutes, wanted.seed, Apart()
    print(f"engine: {in_words()}", flush=True)
    while time.monotonic() < end:
        rng = np.random.default_rng(seed)
        wild, exact = seed % 10 == 9, bool(rng.random() < 0.2)
        with np.errstate(all="ignore"):
            case = draw(rng, wild)
            found = Apart(0.0 if same_bits(case, rng, exact=exact) else np.inf)
            if not wild:
                found += difference(case, rng, exact=exact)
        if not found.worst <= 1.0:
            print(f"seed {seed}: {found.worst:.3g} times the difference allowed\n{case.tape}")
            return 1
        total, seed = total + found, seed + 1
    print(f"{seed - wanted.seed} rounds, at most {total.worst:.2g} of the difference allowed")
    print(
        f"{total.above} of {total.comparisons} comparisons beyond {TOLERANCE:g} alone, "
        f"at most {total.most:.2g} times"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
