"""The sds of terms are learnt: the likelihood is the dense one, and what is learnt is right."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.estimation.noise.term_scales import (
    Sums,
    TermSystem,
    _root,
    evaluate,
    learn_scales,
    term_system,
)
from loopcal.estimation.noise.variances import Variances, by_common_factor, scales_of
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import End
from loopcal.mechanisms.terms import Term
from tests.refusals import refused

Array = NDArray[np.float64]
TERMS = (Term("a", ("a",), 0.5), Term("b", ("b",), 2.0, spread=0.7))
OWNER = np.array([-1, 0, 0, -1, 1, 1, 1, -1, -1])
PRIOR = np.array([math.inf, 0.5, 0.5, 0.3, 2.0, 2.0, 2.0, math.inf, math.inf])


def equations(*, redundant: bool = False) -> tuple[Array, Array, Array]:
    """D (60, 9), E (60,) and offsets (9,); redundant: two flat columns say the same."""
    rng = np.random.default_rng(5)
    D, E = rng.normal(size=(60, 9)), rng.normal(size=60)
    if redundant:
        D[:, 8] = 2.0 * D[:, 7]
    return D, E, np.where(np.isinf(PRIOR), 0.0, rng.normal(size=9))


def system(D: Array, E: Array, offset: Array, *, triangular: bool) -> TermSystem:
    rows = np.column_stack([D, E])
    total = np.asarray(np.linalg.qr(rows, mode="r")) if triangular else rows.T @ rows
    return term_system(Sums(total, triangular, len(E)), PRIOR, offset, OWNER, TERMS)


def dense(D: Array, E: Array, offset: Array, x: Array) -> float:
    """-2 log of the restricted likelihood of E ~ N(F b + D m, V) and the prior of the scales."""
    sd = np.where(OWNER >= 0, np.exp(0.5 * x[1:])[OWNER], PRIOR)
    known = np.isfinite(PRIOR)
    V = math.exp(x[0]) * np.eye(len(E)) + (D[:, known] * np.square(sd[known])) @ D[:, known].T
    F, e = D[:, ~known], E - D[:, known] @ offset[known]
    H = F.T @ np.linalg.solve(V, F)
    P_e = np.linalg.solve(V, e - F @ np.linalg.solve(H, F.T @ np.linalg.solve(V, e)))
    away = [(0.5 * x[1 + i] - math.log(t.sd)) / t.spread for i, t in enumerate(TERMS)]
    logs = np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1]
    return float(logs + e @ P_e + np.square(away).sum())


@pytest.mark.parametrize("triangular", [True, False])
@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (1.3, -2.0, 0.7), (-2.0, 3.0, -4.0)])
def test_the_criterion_is_the_dense_restricted_likelihood(
    x: tuple[float, ...], triangular: bool
) -> None:
    D, E, offset = equations()
    found = evaluate(system(D, E, offset, triangular=triangular), np.array(x))
    assert found.criterion == pytest.approx(dense(D, E, offset, np.array(x)), abs=1e-9)


@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (1.3, -2.0, 0.7)])
def test_gradient_and_hessian_are_those_of_the_dense_formula(x: tuple[float, ...]) -> None:
    D, E, offset = equations()
    reduced, h = system(D, E, offset, triangular=True), 1e-4
    found = evaluate(reduced, np.array(x))
    for i, e in enumerate(h * np.eye(3)):
        up, down = np.array(x) + e, np.array(x) - e
        far, near = dense(D, E, offset, up + e), dense(D, E, offset, down - e)
        wide = (far - near) / (4 * h)
        slope = (dense(D, E, offset, up) - dense(D, E, offset, down)) / (2 * h)
        assert -2 * found.score[i] == pytest.approx((4 * slope - wide) / 3, abs=1e-9)
        bend = evaluate(reduced, down).score - evaluate(reduced, up).score
        assert found.information[i] == pytest.approx(bend / (2 * h), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("triangular", [True, False])
def test_flat_columns_that_say_the_same_count_once(triangular: bool) -> None:
    D, E, offset = equations(redundant=True)
    found = system(D, E, offset, triangular=triangular)
    assert found.count == 60 - 2
    without = np.delete(np.arange(9), 8)
    rows = np.column_stack([D[:, without], E])
    alone = term_system(
        Sums(rows.T @ rows, False, 60), PRIOR[without], offset[without], OWNER[without], TERMS
    )
    x = np.array([0.2, 0.5, -0.5])
    here, there = evaluate(found, x), evaluate(alone, x)
    assert 2 * here.score == pytest.approx(2 * there.score, abs=1e-8)


def test_the_search_ends_where_the_gradient_is_zero_however_far_it_begins() -> None:
    reduced = system(*equations(), triangular=True)
    ends = []
    for scales in ([0.5, 2.0], [1e-4, 1e3], [1e3, 1e-4]):
        found = learn_scales(reduced, np.array(scales), common=True).at
        assert -2 * found.score == pytest.approx(np.zeros(3), abs=1e-4)
        ends.append(found.x)
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)
    assert ends[2] == pytest.approx(ends[0], abs=1e-4)


def waves(tau: float, *, columns: int = 12) -> tuple[lc.Mechanism, Any]:
    """y = a + b q + sum c_k sin(k q), and a function that draws its readings and truth."""

    def loop(x: Any, p: Any) -> list[Any]:
        value = p.a + p.b * x.q - x.y
        for k in range(columns):
            value = value + p[f"c_{k}"] * (np.sin((k + 1) * x.q))
        return [value]

    names = {"a": (0.0, "m"), "b": (0.0, "m")} | {f"c_{k}": (0.0, "m") for k in range(columns)}
    machine = lc.Mechanism.from_function(loop, {"q": "rad", "y": "m"}, names, outputs=("y",))

    def drawn(seed: int, poses: int = 60) -> tuple[dict[str, Array], dict[str, Array], Array]:
        rng = np.random.default_rng([7, seed])
        c = rng.normal(scale=tau, size=columns)
        q = rng.uniform(-3.0, 3.0, poses)
        fresh = rng.uniform(-3.0, 3.0, 20)

        def exact(q: Array) -> Array:
            features = np.sin(np.outer(np.arange(1, columns + 1), q))
            return np.asarray(0.3 + 0.1 * q + c @ features)

        noisy = exact(q) + rng.normal(scale=1e-3, size=poses)
        return {"q": q, "y": noisy}, {"q": fresh, "y": exact(fresh)}, c

    return machine, drawn


PRIORS = lc.Prior({"*": math.inf, "c_*": (1.0, "mm")}, estimate={"c_*": "group"})


def structured(machine: lc.Mechanism, data: dict[str, Array]) -> lc.Result:
    return lc.calibrate(
        machine, data, prior=PRIORS, method="least-squares", model_error="structured"
    )


def test_scales_are_recovered_and_intervals_hold() -> None:
    """Truth drawn from the prior: 95 % of parameters, of fresh points and of scales are inside."""
    tau = 2e-3
    machine, drawn = waves(tau)
    inside, points, scales, sigmas, bounded = [], [], [], [], []
    for seed in range(60):
        data, fresh, c = drawn(seed)
        result = structured(machine, data)
        assert result.status.converged
        names = [f"c_{k}" for k in range(12)]
        off = [(result.value[n] - t) / (result.sd[n] or 0.0) for n, t in zip(names, c, strict=True)]
        inside += [abs(z) < 1.96 for z in off]
        (term,) = result.terms
        assert term.interval is not None
        assert term.interval[1] is not None
        scales.append(math.log(term.scale))
        bounded.append(term.interval[0] < tau < term.interval[1])
        sigmas.append(next(n.sd for n in result.noise if n.quantities == ("y",)))
        said = lc.predict(result, {"q": fresh["q"]})
        # the machine itself is here without error, so parameters alone cause one
        z = (said.outputs["y"] - fresh["y"]) / np.sqrt(said.from_parameters[:, 0, 0])
        points += (np.abs(z) < 1.96).tolist()
    assert np.mean(scales) == pytest.approx(math.log(tau), abs=0.1)
    assert np.mean(sigmas) == pytest.approx(1e-3, rel=0.03)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert np.mean(points) == pytest.approx(0.95, abs=0.03)
    assert np.mean(bounded) >= 0.9


@pytest.mark.parametrize("back", [1.0, 2.5])
def test_scales_that_swing_about_their_end_settle_there(
    back: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fits that lead as far past the end as the scales were before it, or farther."""
    machine, drawn = waves(2e-3)
    data = drawn(3)[0]
    (calm,) = structured(machine, data).terms

    def past(problem: Problem, end: End[Any], ratio: float | None) -> Variances:
        stated = by_common_factor(problem, end, ratio)
        assert stated.terms is not None
        off = 2.0 * (np.log(scales_of(problem)) - math.log(calm.scale))
        at = replace(stated.terms.at, x=stated.terms.at.x - back * np.append(0.0, off))
        criterion = stated.criterion + float(off @ off)
        return replace(stated, criterion=criterion, terms=replace(stated.terms, at=at))

    monkeypatch.setattr("loopcal.estimation.noise.estimation.by_common_factor", past)
    result = structured(machine, data)
    assert result.status.converged
    assert result.terms[0].scale == pytest.approx(calm.scale, rel=1e-3)
    assert result.document.sds_settled


def test_a_term_without_effect_costs_nothing() -> None:
    machine, drawn = waves(0.0)
    data, fresh, _ = drawn(1)
    plain = lc.calibrate(machine, data, prior={"*": math.inf, "c_*": 0.0}, method="least-squares")
    result = structured(machine, data)
    (term,) = result.terms
    assert term.effective < 0.4 * term.columns
    assert term.gain is not None
    assert term.gain < 2.0
    with_term, without = (
        np.sqrt(np.mean(np.square(lc.predict(r, {"q": fresh["q"]}).outputs["y"] - fresh["y"])))
        for r in (result, plain)
    )
    assert with_term < without + 1e-4


def test_least_squares_ignores_terms_without_model_error() -> None:
    machine, drawn = waves(2e-3)
    data = drawn(1)[0]
    flat = lc.calibrate(machine, data, prior={"*": math.inf}, method="least-squares")
    grouped = lc.calibrate(machine, data, prior=PRIORS, method="least-squares")
    assert dict(grouped.value) == dict(flat.value)
    assert grouped.terms == ()
    assert not grouped.learns_terms


def test_stated_sds_stay_and_the_scale_is_learnt_beside_them() -> None:
    machine, drawn = waves(2e-3)
    data = drawn(2)[0]
    noise = {"q": 0.0, "y": 1e-3}
    result = lc.calibrate(machine, data, noise=noise, prior=PRIORS, method="implicit-loop")
    assert [n.source for n in result.noise if n.quantities == ("y",)] == ["given"]
    assert result.learns_terms
    assert "terms" not in vars(result)
    assert result.terms[0].scale == pytest.approx(2e-3, rel=0.6)
    assert result.mechanism.parameters["c_3"].prior_sd == result.terms[0].scale
    both = lc.calibrate(
        machine,
        data,
        noise=lc.Noise(noise, estimate={"y": "each"}),
        prior=PRIORS,
        method="implicit-loop",
    )
    free = structured(machine, data)
    assert both.terms[0].scale == pytest.approx(free.terms[0].scale, rel=1e-4)
    assert dict(both.value) == pytest.approx(dict(free.value), abs=1e-7)


def test_a_model_error_beside_stated_sds_is_learnt_with_the_terms() -> None:
    machine, drawn = waves(2e-3)
    data = drawn(2)[0]
    noise = {"q": 0.0, "y": 1e-5}
    result = lc.calibrate(
        machine, data, noise=noise, prior=PRIORS, model_error="structured", method="implicit-loop"
    )
    sds = {n.quantities: n.sd for n in result.noise}
    free = structured(machine, data)
    learnt = next(n.sd for n in free.noise if n.quantities == ("y",))
    assert sds["model_y",] == pytest.approx(math.sqrt(learnt**2 - 1e-10), rel=1e-4)
    assert result.terms[0].scale == pytest.approx(free.terms[0].scale, rel=1e-3)


def test_a_robust_loss_learns_no_terms() -> None:
    machine, drawn = waves(2e-3)
    with refused("unsupported", "huber"):
        lc.calibrate(
            machine,
            drawn(1)[0],
            noise={"q": 0.0, "y": 1e-3},
            prior=PRIORS,
            loss="huber",
            method="implicit-loop",
        )


def test_a_system_whose_scales_span_sixteen_decades_has_a_root() -> None:
    vectors = np.linalg.qr(np.random.default_rng(1).standard_normal((30, 30)))[0]
    K = (vectors * np.logspace(0.0, 17.0, 30)) @ vectors.T
    L = np.tril(_root(K))
    assert np.allclose(L @ L.T, K, rtol=0.0, atol=1e-14 * np.abs(K).max())
    plain = np.eye(3) + 0.5
    assert np.allclose(np.tril(_root(plain)) @ np.tril(_root(plain)).T, plain)


def test_a_term_whose_parameters_are_all_fixed_says_nothing() -> None:
    machine, drawn = waves(2e-3, columns=3)
    fixed = machine.with_parameters(machine.parameters.with_fixed(["c_*"]))
    data, _, _ = drawn(1)
    result = lc.calibrate(
        fixed, data, noise={"q": 0.0, "y": 1e-3}, prior=PRIORS, method="implicit-loop"
    )
    assert result.status.converged
    assert (result.terms, result.estimate) == ((), None)
    assert np.isfinite(result.covariance).all()
    under_a_loss = lc.calibrate(
        fixed, data, noise={"q": 0.0, "y": 1e-3}, prior=PRIORS, method="implicit-loop", loss="huber"
    )
    assert under_a_loss.status.converged
