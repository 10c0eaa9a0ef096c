"""The compiled engine's kernel gives the equations that NumPy's gives, and leads to the fits."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve import block_kernel as searching
from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.block_kernel import BlockKernel, kernel_for
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.kernel import unweighted, whiten
from loopcal.estimation.solve.loss import Huber, Loss
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import solve, solve_with
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.choice import AVAILABLE, ENGINES
from loopcal.expressions.derivative import linearise
from loopcal.expressions.engine import NumpyEngine, Stage, engine_for
from loopcal.expressions.multiples import multiples
from loopcal.expressions.trace import trace
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import CovarianceBlock, Noise, ReadingUncertainty
from loopcal.mechanisms.mechanism import Mechanism
from tests.estimation import test_families
from tests.reference import four_bars
from tests.reference.simulated import ma1400, planar_arm

if AVAILABLE:
    from loopcal.expressions import _compiled

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="the compiled engine was not built")
Array = NDArray[np.float64]
K, M, N = 7, 4, 5
"""Quantities, loops, parameters."""
_A = np.random.default_rng(1).normal(size=(M, K + N))
TAPE = trace(
    lambda x, p: [
        sum(a * np.sin(x[i] + 0.1 * r) for i, a in enumerate(row[:K]))
        + sum(a * p[j] * x[(j + r) % K] for j, a in enumerate(row[K:]))
        + 0.01 * x.c * p[0] ** 2
        for r, row in enumerate(_A)
    ],
    quantities=[f"x{i}" for i in range(K)],
    pose_constants="c",
    parameters=[f"p{i}" for i in range(N)],
)
P = np.linspace(0.5, 1.5, N)


def random_block(kind: str, unmeasured: tuple[int, ...], poses: int) -> Block:
    """kind: how the noise is told: "sd", "sds by pose", "covariance", "covariances by pose"."""
    rng = np.random.default_rng(poses)
    by_pose = "by pose" in kind
    sd = rng.uniform(0.5, 2.0, (K, poses if by_pose else 1)) * 1e-3
    sd[2] = 0.0
    blocks: tuple[CovarianceBlock, ...] = ()
    measured = tuple(i for i in range(K) if i not in unmeasured)
    if kind.startswith("covariance"):
        among = tuple(i for i in (6, 0, 4) if i in measured)
        shape = (poses, len(among), len(among)) if by_pose else (len(among), len(among))
        blocks = (CovarianceBlock(among, 1e-3 * rng.normal(size=shape)),)
    sd[list(unmeasured)] = np.inf
    return Block(
        slice(0, poses),
        P,
        rng.uniform(-1, 1, (K, poses)),
        1e-3 * rng.normal(size=(K, poses)),
        rng.uniform(-1, 1, (1, poses)),
        BlockNoise(ReadingUncertainty(sd, blocks), unmeasured, measured),
    )


def kernel_on(name: str, monkeypatch: pytest.MonkeyPatch, *, exact: bool = False) -> BlockKernel:
    monkeypatch.setenv("LOOPCAL_ENGINE", name)
    engine = engine_for(TAPE, TAPE.parameters, 5000)
    return kernel_for(engine, unweighted if exact else whiten, alike=exact)


def misfits(block: Block, change: Array) -> Array:
    """What the search makes small, of each pose: squared loops over their sds, by NumPy."""
    engine = NumpyEngine(linearise(TAPE, TAPE.quantities, ()), change.shape[1])
    x = block.readings + block.corrections
    sure = np.where(np.isinf(block.noise.sd), 0.0, block.noise.sd)
    slopes = engine.evaluate(P, x, block.pose_constants, Stage.BY_QUANTITY).by_quantity
    spread = np.sqrt(np.square(slopes * sure[:, None]).sum(axis=0))
    x[list(block.noise.unmeasured)] += change
    f = engine.evaluate(P, x, block.pose_constants, Stage.VALUES).f
    found: Array = np.square(f / spread).sum(axis=0)
    return found


def alike(a: Any, b: Any, tolerance: float = 1e-11) -> None:
    assert a.shape == b.shape
    if a.size:
        assert np.abs(a - b).max() <= tolerance * np.abs(b).max()


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("unmeasured", [(), (1,), (0, 5), (5, 3, 1), (0, 1, 3, 5)])
@pytest.mark.parametrize("kind", ["sd", "sds by pose", "covariance", "covariances by pose"])
def test_equations_and_corrections_are_those_of_numpy(
    kind: str, unmeasured: tuple[int, ...], exact: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = (kernel_on(e, monkeypatch, exact=exact) for e in ("compiled", "numpy"))
    for poses in (1, 31, 32, 33, 200):
        block = random_block(kind, unmeasured, poses)
        a, b = ours.equations(block, summed=False), theirs.equations(block, summed=False)
        assert a.rows is not None
        assert b.rows is not None
        alike(a.rows, b.rows)
        alike(a.correction, b.correction)
        alike(a.step, b.step)
        assert a.singular.tolist() == b.singular.tolist()
        a, b = (kernel.equations(block, summed=True) for kernel in (ours, theirs))
        alike(a.total, b.total)
        a, b = ours.corrected(block), theirs.corrected(block)
        alike(a.E, b.E)
        alike(a.correction, b.correction)
        alike(ours.rounding(block), theirs.rounding(block))


@pytest.mark.parametrize("unmeasured", [(1,), (0, 5), (5, 3, 1), (0, 1, 3, 5)])
@pytest.mark.parametrize("kind", ["sd", "sds by pose"])
def test_unmeasured_quantities_are_found_where_numpy_finds_them(
    kind: str, unmeasured: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = (kernel_on(e, monkeypatch) for e in ("compiled", "numpy"))
    for poses in (1, 31, 33, 200):
        block = random_block(kind, unmeasured, poses)
        a, b = ours.search(block), theirs.search(block)
        apart = np.abs(a - b).max(axis=0)
        with monkeypatch.context() as longer:
            longer.setattr(searching, "_MOST", 80)
            settled = (theirs.search(block) == b).all(axis=0)
        # ended on its way by the number of steps, along which rounding grows
        assert apart.max(where=~settled, initial=0.0) <= 1e-9
        # the last step, below 1e-6, may be better by rounding alone, and then one engine takes it
        assert apart.max(where=settled, initial=0.0) <= 1e-6
        other = settled & (apart > 1e-11)
        costs = [misfits(block, change)[other] for change in (a, b)]
        assert costs[0] == pytest.approx(costs[1], rel=1e-11, abs=0.0)
    alone = block.of(slice(150, 151))
    together = ours.search(block)
    assert np.array_equal(ours.search(alone)[:, 0], together[:, 150])


@pytest.mark.usefixtures("restored")
def test_a_search_gives_the_same_bits_whatever_the_width_and_the_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    block, kernel = random_block("sd", (5, 3), 1000), kernel_on("compiled", monkeypatch)
    found = set()
    for width in _compiled.widths():
        for threads in (1, 3):
            _compiled.use_width(width)
            _compiled.use_threads(threads)
            found.add(kernel.search(block).tobytes())
    assert len(found) == 1


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("unmeasured", [(), (1,), (0, 5)])
@pytest.mark.parametrize("kind", ["sd", "sds by pose", "covariance", "covariances by pose"])
def test_loops_are_closed_as_by_numpy(
    kind: str, unmeasured: tuple[int, ...], exact: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = (kernel_on(e, monkeypatch, exact=exact) for e in ("compiled", "numpy"))
    for poses in (1, 33, 200):
        block = random_block(kind, unmeasured, poses)
        for tolerance in (np.inf, 0.1, 1e-3):
            a, b = (kernel.close(block, tolerance, 1.0) for kernel in (ours, theirs))
            assert a.open.tolist() == b.open.tolist()
            settled = ~a.open
            alike(a.corrections[:, settled], b.corrections[:, settled], 1e-8)
            assert a.evaluations == b.evaluations
            assert a.step == pytest.approx(b.step, rel=1e-6, abs=1e-9)
            if settled.all():
                assert a.contraction == pytest.approx(b.contraction, rel=1e-6, abs=1e-9)


def test_a_loop_that_leaves_its_domain_is_closed_with_shorter_steps_as_by_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tape = trace(lambda x, p: [np.sqrt(x.a) - p.k * x.b + x.c], quantities="abc", parameters="k")
    noise = BlockNoise(ReadingUncertainty(np.full((3, 1), 0.1)), (), (0, 1, 2))
    rng = np.random.default_rng(5)
    x = np.array([[0.25], [1.0], [0.0]]) + rng.normal(0.0, 0.01, (3, 60))
    start = np.zeros_like(x)
    start[0] = -x[0] * rng.uniform(0.5, 3.0, 60)
    block = Block(slice(0, 60), np.array([0.5]), x, start, np.zeros((0, 60)), noise)
    found = []
    for name in ENGINES:
        monkeypatch.setenv("LOOPCAL_ENGINE", name)
        engine = engine_for(tape, tape.parameters, 64)
        found.append(kernel_for(engine, whiten, alike=False).close(block, 1e-6, 1.0))
    a, b = found
    assert a.open.tolist() == b.open.tolist()
    assert not a.open.all()
    alike(a.corrections[:, ~a.open], b.corrections[:, ~a.open], 1e-8)
    assert a.evaluations == b.evaluations
    assert a.evaluations > 120


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize("unmeasured", [(), (0, 5)])
def test_closing_gives_the_same_bits_whatever_the_width_the_threads_and_the_neighbours(
    unmeasured: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    block = random_block("covariances by pose", unmeasured, 1000)
    kernel = kernel_on("compiled", monkeypatch)
    found = set()
    for width in _compiled.widths():
        for threads in (1, 3):
            _compiled.use_width(width)
            _compiled.use_threads(threads)
            found.add(kernel.close(block, 1e-3, 1.0).corrections.tobytes())
    assert len(found) == 1
    together = kernel.close(block, 1e-3, 1.0).corrections
    for pose in (0, 31, 500, 999):
        alone = kernel.close(block.of(slice(pose, pose + 1)), 1e-3, 1.0).corrections
        assert np.array_equal(alone[:, 0], together[:, pose])


def test_no_pose_adds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = kernel_on("compiled", monkeypatch).equations(random_block("sd", (1,), 0), summed=True)
    assert found.total is not None
    assert not found.total.any()
    assert found.correction.shape == (K, 0)


@pytest.mark.parametrize("unmeasured", [(), (0, 5)])
def test_a_pose_gets_the_same_bits_alone_and_among_others(
    unmeasured: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    block, kernel = random_block("covariances by pose", unmeasured, 300), None
    kernel = kernel_on("compiled", monkeypatch)
    together = kernel.equations(block, summed=False)
    assert together.rows is not None
    rows = together.rows.copy()
    for pose in (0, 1, 31, 32, 129, 299):
        alone = kernel.equations(block.of(slice(pose, pose + 1)), summed=False)
        assert alone.rows is not None
        assert np.array_equal(alone.rows[..., 0], rows[..., pose])
        assert np.array_equal(alone.correction[:, 0], together.correction[:, pose])


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize("unmeasured", [(), (0, 5)])
@pytest.mark.parametrize("poses", [100, 5000])
def test_sums_have_the_same_bits_whatever_the_width_and_the_threads(
    unmeasured: tuple[int, ...], poses: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    block, kernel = random_block("sd", unmeasured, poses), kernel_on("compiled", monkeypatch)
    found = set()
    for width in _compiled.widths():
        for threads in (1, 2, 3, 7):
            _compiled.use_width(width)
            _compiled.use_threads(threads)
            total = kernel.equations(block, summed=True).total
            assert total is not None
            assert np.array_equal(total, total.T)
            rows = kernel.equations(block, summed=False).rows
            assert rows is not None
            found.add((total.tobytes(), rows.tobytes()))
    assert len(found) == 1


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize("loops", [3, 70])
def test_rows_of_zeros_that_are_left_out_of_the_sums_add_nothing(loops: int) -> None:
    """Four parameters of each loop that are in no other, and one that is in all."""
    tape = trace(
        lambda x, p: [
            sum(p[4 * r + i] * np.cos(i * x[0] + r) for i in range(4)) + p[4 * loops] * x[0]
            for r in range(loops)
        ],
        quantities=["x"],
        parameters=[f"p{i}" for i in range(4 * loops + 1)],
    )
    engine = engine_for(tape, tape.parameters, 300)
    p = np.ones(4 * loops + 1)
    noise = BlockNoise(ReadingUncertainty(np.ones((1, 1)), ()), (), (0,))
    x = np.random.default_rng(3).uniform(-1, 1, (1, 300))
    block = Block(slice(0, 300), p, x, np.zeros((1, 300)), np.zeros((0, 300)), noise)
    kernel = kernel_for(engine, unweighted, alike=True)
    rows = kernel.equations(block, summed=False).rows
    assert rows is not None
    assert np.mean((rows == 0.0).all(axis=2)) > 0.5
    flat = rows.reshape(len(rows), -1).copy()
    for width in _compiled.widths():
        _compiled.use_width(width)
        total = kernel.equations(block, summed=True).total
        assert total is not None
        alike(total, flat @ flat.T, 1e-14)


def features(x: Any, count: int) -> list[Any]:
    return [np.cos((i + 1) * x[0] + i * x[2]) for i in range(count)]


def moved(x: Any, p: Any) -> list[Any]:
    """Two motions of which features are multiples, the same ones, some not; others of one loop."""
    along = sum(c * f for c, f in zip(p[:12], features(x, 12), strict=True))
    turn = sum(c * f for c, f in zip(p[12:24], features(x, 12), strict=True))
    other = sum(c * f for c, f in zip(p[24:33], features(x, 9), strict=True))
    a, b = p[33], p[34]
    return [
        x[1] * np.cos(turn + a) - along * x[3] + other * x[2],
        x[1] * np.sin(turn + a) * b - along * x[1],
        x[3] + x[1] * turn + along * a + x[2] * b**2,
    ]


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize("unmeasured", [(), (3,)])
@pytest.mark.parametrize("exact", [False, True])
def test_sums_of_multiples_of_common_columns_are_those_of_their_rows(
    unmeasured: tuple[int, ...], exact: bool
) -> None:
    tape = trace(moved, quantities="abcd", parameters=[f"p{i}" for i in range(35)])
    shared = multiples(linearise(tape, tape.quantities, tape.parameters))
    assert sorted(map(len, shared.members)) == [9, 12, 12]
    engine, rng = engine_for(tape, tape.parameters, 300), np.random.default_rng(4)
    sd = np.full((4, 1), 0.1)
    sd[list(unmeasured)] = np.inf
    measured = tuple(i for i in range(4) if i not in unmeasured)
    noise = BlockNoise(ReadingUncertainty(sd), unmeasured, measured)
    x = rng.uniform(-1, 1, (4, 300))
    block = Block(slice(0, 300), 0.1 * rng.normal(size=35), x, 0.01 * x, x[:0], noise)
    kernel = kernel_for(engine, unweighted if exact else whiten, alike=exact)
    rows = kernel.equations(block, summed=False).rows
    assert rows is not None
    flat, found = rows.reshape(len(rows), -1).copy(), set()
    for width in _compiled.widths():
        for threads in (1, 3):
            _compiled.use_width(width)
            _compiled.use_threads(threads)
            total = kernel.equations(block, summed=True).total
            assert total is not None
            assert np.array_equal(total, total.T)
            found.add(total.tobytes())
            lengths = np.linalg.norm(flat, axis=1)
            alike(
                total / np.outer(lengths, lengths),
                (flat @ flat.T) / np.outer(lengths, lengths),
                1e-14,
            )
    assert len(found) == 1


def test_poses_that_cannot_close_are_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    block = random_block("sds by pose", (), 50)
    sd = block.noise.sd.copy()
    sd[:, 7] = 0.0
    sd[3:, 40] = 0.0  # two uncertain quantities and four loops
    uncertainty = replace(block.noise.uncertainty, sd=sd)
    block = replace(block, noise=replace(block.noise, uncertainty=uncertainty))
    for name in ENGINES:
        found = kernel_on(name, monkeypatch).equations(block, summed=True)
        assert np.flatnonzero(found.singular).tolist() == [7, 40]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("unmeasured", [(), (0, 5)])
def test_a_pose_without_a_number_is_seen_in_the_sum_and_spoils_no_other(
    unmeasured: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel, clean = kernel_on("compiled", monkeypatch), random_block("sd", unmeasured, 50)
    readings = clean.readings.copy()
    readings[3, 20] = np.nan
    spoilt = replace(clean, readings=readings)
    found, expected = (kernel.equations(block, summed=False) for block in (spoilt, clean))
    others = np.arange(50) != 20
    assert np.array_equal(found.correction[:, others], expected.correction[:, others])
    assert np.isnan(found.step).tolist() == (~others).tolist()
    total = kernel.equations(spoilt, summed=True).total
    assert total is not None
    assert np.isnan(total).any()


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-6, 1e-9])
def test_rows_that_are_nearly_parallel_are_whitened_as_by_numpy(
    angle: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def loops(x: Any, p: Any) -> list[Any]:
        one = x[0] + 2.0 * x[1] - x[2] + p[0]
        return [one, one + angle * (x[1] + x[3] * p[1])]

    tape = trace(loops, quantities="abcd", parameters="kl")
    noise = BlockNoise(ReadingUncertainty(np.full((4, 1), 0.1)), (), (0, 1, 2, 3))
    x = np.random.default_rng(3).uniform(-1, 1, (4, 40))
    block = Block(slice(0, 40), np.array([0.3, 0.7]), x, np.zeros_like(x), np.zeros((0, 40)), noise)
    found = []
    for name in ENGINES:
        monkeypatch.setenv("LOOPCAL_ENGINE", name)
        engine = engine_for(tape, tape.parameters, 64)
        kernel = kernel_for(engine, whiten, alike=False)
        reduced = kernel.equations(block, summed=False)
        assert not reduced.singular.any()
        assert reduced.rows is not None
        found.append(reduced.rows.copy())
    alike(found[0], found[1], 1e-14 / angle)


def fits() -> dict[str, tuple[Mechanism, Dataset, Noise]]:
    """Machines, readings and noise of every kind."""
    arm, planar, bars = ma1400(), planar_arm(), four_bars.passive()
    sds = dict.fromkeys(arm.truth.quantities, 0.0001)
    stations = test_families.arm()
    seen = test_families.simulated(stations, 1)
    rng = np.random.default_rng(5)
    factors = 1e-4 * (np.eye(2) + 0.3 * rng.normal(size=(60, 2, 2)))
    gaps = planar.read(dict.fromkeys(planar.exact, 0.0001), 3)
    x = gaps.readings["xP"].copy()
    x[::4] = np.nan
    return {
        "arm": (arm.off(2e-3, 2e-3), arm.read(sds, 1), Noise(sds)),
        "covariances by pose": (
            planar.off(2e-3, 2e-3),
            planar.read(dict.fromkeys(planar.exact, 0.0001), 2),
            Noise({"phi*": 1e-4, ("xP", "yP"): factors @ np.swapaxes(factors, 1, 2)}),
        ),
        "missing readings": (
            planar.off(2e-3, 2e-3),
            gaps.with_readings({"xP": x}),
            Noise(dict.fromkeys(planar.exact, 1e-4)),
        ),
        "passive joint": (
            bars.off(1e-3, 1e-3),
            bars.read({"crank": 1e-5, "rocker": 1e-5}, 4),
            Noise({"crank": 1e-5, "rocker": 1e-5, "coupler": np.inf}),
        ),
        "families": (
            stations,
            test_families.seen_in_part(seen.dataset),
            Noise(test_families.NOISE),
        ),
    }


@pytest.mark.parametrize("loss", [None, Huber()])
@pytest.mark.parametrize("name", list(fits()))
def test_a_fit_ends_at_the_same_parameters(
    name: str, loss: Loss | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    mechanism, data, noise = fits()[name]
    problem = build_problem(mechanism, data, noise)
    found: dict[str, Solution] = {}
    for engine in ENGINES:
        monkeypatch.setenv("LOOPCAL_ENGINE", engine)
        found[engine] = solve_with(InMemory(Sweeper(problem, loss=loss)))
    ours, theirs = found["compiled"], found["numpy"]
    assert ours.status.reason == theirs.status.reason == "converged"
    sds = np.sqrt(np.diag(theirs.spectrum.covariance()))
    free = problem.free
    assert np.all(abs(ours.parameters[free] - theirs.parameters[free]) <= 1e-7 * sds)
    assert ours.chi_squared == pytest.approx(theirs.chi_squared, rel=1e-9)
    assert ours.corrections == pytest.approx(theirs.corrections, rel=1e-6, abs=1e-10)


def test_the_basic_method_ends_at_the_same_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = ma1400()
    problem = build_problem(arm.off(2e-3, 2e-3), arm.read(dict.fromkeys(arm.exact, 1e-4)), None)
    found = []
    for engine in ENGINES:
        monkeypatch.setenv("LOOPCAL_ENGINE", engine)
        found.append(solve(problem).parameters)
    assert found[0] == pytest.approx(found[1], rel=1e-10, abs=1e-11)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOOPCAL_THREADS", "2")
    block, kernel = random_block("sd", (), 5000), kernel_on("compiled", monkeypatch)
    expected = kernel.equations(block, summed=True).total
    child = os.fork() if hasattr(os, "fork") else None
    if child is None:
        pytest.skip("this system does not fork")
    if child == 0:
        same = np.array_equal(kernel.equations(block, summed=True).total, expected)  # type: ignore[arg-type]
        os._exit(0 if same else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
