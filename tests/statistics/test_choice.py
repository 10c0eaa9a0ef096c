"""The method "auto": candidates on the same poses not used, and the rule that takes one of them."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.fit import Fit
from loopcal.execution.executor import InProcess
from loopcal.statistics.case import Case, Entrant, entrants, without_terms
from loopcal.statistics.choice import _taken, choose
from loopcal.statistics.folds import Scheme
from loopcal.statistics.gain import Gain
from loopcal.statistics.judged import Judged
from loopcal.statistics.noise_floor import _followed, noise_floor
from loopcal.statistics.risks import beats
from tests.estimation.cameras.test_image_errors import MACHINE, NAMES, POINTS, images, poses
from tests.estimation.cameras.test_image_errors import stated as seen_at
from tests.reference.simulated import Simulated, planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
ARM = planar_arm(40)


def noisy(poor: float = 1.0, seed: int = 1) -> lc.Dataset:
    """Readings of the planar arm; poor: factor on the sd of the second encoder."""
    return ARM.read(SDS | {"phi3": poor * 1e-3}, seed=seed)


def test_without_noise_it_chooses_among_methods_that_need_none() -> None:
    result = lc.calibrate(ARM.truth, noisy(), method="auto")
    assert result.chosen is not None
    assert {c.name for c in result.chosen.over} <= {
        *("least-squares", "nominal", "least-squares with model error")
    }
    assert result.status.converged
    assert result.document.method == "auto"


def test_it_tells_what_was_chosen_over_what_and_by_how_much() -> None:
    result = lc.calibrate(ARM.truth, noisy(), noise=SDS, method="auto")
    document, chosen = result.document, result.chosen
    assert chosen is not None
    first, *others = chosen.over
    assert first.name == chosen.method
    assert first.difference == 0.0
    assert first.out_of_sample is not None
    assert document.validation is not None
    assert first.out_of_sample == document.validation.accuracy
    assert document.validation.blocked is not None
    assert first.blocked == document.validation.blocked.accuracy
    for other in others:
        assert other.out_of_sample is not None
        assert other.difference == pytest.approx(
            other.out_of_sample.rms - first.out_of_sample.rms, abs=1e-12
        )
        assert other.sd is not None
    assert chosen.words in " ".join(str(result).split())
    nominal = next(other for other in others if other.name == "nominal")
    assert nominal.sd is not None
    told = re.search(r"nominal \+(\S+) ± (\S+) mm", chosen.words)
    assert told is not None
    for shown, size in zip(told.groups(), (nominal.difference or 0.0, nominal.sd), strict=True):
        digits = len(shown.partition(".")[2])
        assert float(shown) == pytest.approx(1e3 * size, abs=0.51 * 10.0**-digits)
    assert document.accuracy is not None
    assert document.accuracy.nominal is not None
    assert document.accuracy.noise_floor is not None


def test_a_choice_is_the_calibration_by_the_chosen_method() -> None:
    result = lc.calibrate(ARM.truth, noisy(), noise=SDS, method="auto")
    assert result.chosen is not None
    case = Case(ARM.truth, noisy(), lc.Noise(SDS), lc.Fit(method="auto"))
    entrant = next(e for e in entrants(case) if e.name == result.chosen.method)
    idle = {term.name for term in entrant.case.mechanism.terms} - set(result.chosen.terms)
    again = (without_terms(case, entrant, idle) or entrant).case.calibrated()
    sds = np.sqrt(np.diag(result.covariance))
    off = [again.value[n] - result.value[n] for n in result.document.covariance.names]
    assert np.abs(off / sds).max() < 1e-3
    np.testing.assert_allclose(again.covariance, result.covariance, rtol=1e-3)
    assert np.isfinite(lc.predict(result, noisy(seed=2)).covariance).all()


def test_validate_with_auto_is_the_validation_of_the_chosen() -> None:
    result = lc.calibrate(ARM.truth, noisy(), noise=SDS, method="auto")
    found = lc.validate(ARM.truth, noisy(), noise=SDS, method="auto", folds=10)
    assert result.document.validation == found.entry


def test_stated_sds_that_are_wrong_by_far_are_not_followed() -> None:
    """The encoder said to be the best is by far the worst: least squares predicts better."""
    claimed = {"xP": 1e-2, "yP": 1e-6, "phi2": 1e-2, "phi3": 1e-7}
    data = ARM.read({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-5, "phi3": 3e-3}, seed=3)
    by_noise = lc.calibrate(ARM.truth, data, noise=claimed, method="implicit-loop")
    chosen = lc.calibrate(ARM.truth, data, noise=claimed, method="auto")
    truth = ARM.values
    off = [abs(r.value["l2"] - truth["l2"]) for r in (chosen, by_noise)]
    assert off[0] <= off[1]


def test_the_choice_is_no_worse_than_least_squares() -> None:
    """Machines off by 2 mm and 2 mrad: in the geometric mean auto is better at fresh poses."""
    ratios = []
    fresh = planar_arm(300, seed=99)
    for seed in range(8):
        drawing = ARM.off(2e-3, 2e-3, seed=seed)
        data = ARM.read(SDS, seed=seed)
        least = lc.calibrate(drawing, data, method="least-squares")
        auto = lc.calibrate(drawing, data, noise=SDS, method="auto")
        ratios.append(_error(auto, fresh) / _error(least, fresh))
    assert float(np.exp(np.mean(np.log(ratios)))) <= 1.0


def _error(result: lc.Result, fresh: Simulated) -> float:
    """Root mean square error [m] at poses without noise."""
    data = fresh.read()
    found = lc.predict(result, data)
    gaps = [found.outputs[q] - data[q] for q in ("xP", "yP")]
    return float(np.sqrt(np.square(gaps).sum(axis=0).mean()))


@pytest.mark.parametrize(("elsewhere", "taken"), [(1.0, "plain"), (1.3, "with model error")])
def test_what_another_beats_by_the_rule_of_the_verdict_is_never_taken(
    elsewhere: float, taken: str
) -> None:
    """A plain method that is clearly better at random poses; elsewhere: its rms in regions."""
    rng, case = np.random.default_rng(1), Case(ARM.truth, noisy(), None, lc.Fit(method="auto"))
    errors = np.abs(rng.standard_normal((2, 200)))
    parts = [np.flatnonzero(np.arange(200) % 5 == i) for i in range(5)]
    plan: Any = SimpleNamespace(groups=np.arange(200), blocked=SimpleNamespace(indices=parts))
    judged = [
        Judged(Entrant("with model error", case, structured=True), None),
        Judged(Entrant("plain", case), None),
    ]
    uneven = np.where(np.arange(200) % 5 == 0, 2.0, 0.5)  # regions alone do not decide
    own = np.square(np.array([[0.8], [elsewhere]]) * errors * np.array([np.ones(200), uneven]))
    risks = {"with model error": np.square(errors), "plain": own}
    found = _taken(judged, risks, plan)
    assert found.name == taken
    for one in judged:
        assert not beats(risks[one.name], risks[found.name], plan)


@pytest.mark.parametrize(("exact", "taken"), [(0.99, "uncertain"), (0.7, "exact")])
def test_exact_readings_are_taken_only_where_they_predict_much_better(
    exact: float, taken: str
) -> None:
    """exact: rms of exact readings beside that of uncertain ones, the same at every pose."""
    rng, data = np.random.default_rng(1), noisy()
    squares = lc.Fit(method="least-squares", model_error="structured")
    loops = lc.Fit(method="implicit-loop", model_error="structured")
    errors = np.abs(rng.standard_normal((2, 200)))
    parts = [np.flatnonzero(np.arange(200) % 5 == i) for i in range(5)]
    plan: Any = SimpleNamespace(groups=np.arange(200), blocked=SimpleNamespace(indices=parts))
    judged = [
        Judged(Entrant(name, Case(ARM.truth, data, None, fit), structured=True), None)
        for name, fit in (("exact", squares), ("uncertain", loops))
    ]
    uneven = 1.0 + 0.05 * rng.standard_normal((2, 200))
    risks = {"exact": np.square(exact * uneven * errors), "uncertain": np.square(errors)}
    assert _taken(judged, risks, plan).name == taken


@pytest.mark.parametrize(("scatter", "taken"), [(0.7, "implicit-loop"), (0.3, "least-squares")])
def test_of_few_poses_a_small_gain_does_not_make_readings_exact(scatter: float, taken: str) -> None:
    """scatter: of the gain of exact readings over poses; the mean gain is the same."""
    rng, data = np.random.default_rng(3), noisy()
    names = "implicit-loop", "least-squares"
    cases = [Case(ARM.truth, data, None, lc.Fit(method=name)) for name in names]
    judged = [Judged(Entrant(n, case), None) for n, case in zip(names, cases, strict=True)]
    plan: Any = SimpleNamespace(groups=np.arange(15), blocked=None)
    gain = rng.standard_normal(15)
    gain = 0.45 + scatter * (gain - gain.mean()) / gain.std()
    risks = {"implicit-loop": np.array([np.full(15, 4.0), np.full(15, np.nan)])}
    risks["least-squares"] = risks["implicit-loop"] - gain
    found = Gain.in_rms(risks["implicit-loop"][0], risks["least-squares"][0], plan.groups)
    assert found is not None
    assert found.difference < -2.2 * found.sd
    assert _taken(judged, risks, plan).name == taken


def test_a_gain_counts_clusters_not_poses() -> None:
    """Errors shared by a cluster: its standard error is that of as many values as clusters."""
    rng = np.random.default_rng(0)
    cluster = np.repeat(np.arange(50), 20)
    squares = []
    for _ in range(200):
        others = rng.normal(size=50)[cluster] + 0.1 * rng.normal(size=1000)
        gain = Gain.of(np.zeros(1000), others, cluster)
        squares.append((gain.difference / gain.sd) ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)
    alone = Gain.of(np.array([1.0, np.nan]), np.zeros(2), np.array([0, 1]))
    assert math.isinf(alone.sd)
    assert alone.better is None


def test_a_gain_of_root_mean_squares_is_their_difference() -> None:
    rng = np.random.default_rng(0)
    own, others = rng.exponential(1.0, 300), rng.exponential(4.0, 300)
    gain = Gain.in_rms(own, others)
    assert gain is not None
    assert gain.difference == pytest.approx(math.sqrt(others.mean()) - math.sqrt(own.mean()))
    assert gain.better
    total = math.sqrt(others.mean()) + math.sqrt(own.mean())
    assert gain.sd == pytest.approx(np.std(others - own, ddof=1) / math.sqrt(300) / total)
    assert Gain.in_rms(own[:1], others[:1]) is None


def test_the_noise_floor_is_what_the_truth_leaves() -> None:
    many = planar_arm(2000)
    data = many.read(SDS, seed=5)
    fixed = many.truth.with_parameters(many.truth.parameters.with_fixed(["xA", "yA", "l2", "l3"]))
    result = lc.calibrate(fixed, data, noise=SDS, method="implicit-loop")
    floor = noise_floor(result)
    assert floor == pytest.approx(result.accuracy_after.rms, rel=0.05)  # type: ignore[union-attr]


def test_the_noise_floor_is_less_where_poses_follow_the_corners() -> None:
    """Six numbers of each pose take up a quarter of the noise of twelve corners: the floor stood
    above what poses that were not used left."""
    random = np.random.default_rng(3)
    look = lc.instruments.camera("eye", points=POINTS, lens="pinhole")
    held = {p.name: p.nominal for p in MACHINE.parameters}
    loose = lc.assemble(lc.machines.free_body(read=False), [look], held)
    fixed = [n for n in held if n != "eye_f"]
    loose = loose.with_parameters(loose.parameters.with_fixed(fixed))
    T = poses(random, 200)
    uv, begun = images(T), {f"{k}0" if k in "xyz" else k: v for k, v in seen_at(T).items()}
    data = begun | dict(zip(NAMES, uv + random.normal(0.0, 0.2, uv.shape), strict=True))
    sds = {"eye:*": 0.2, "[xyz]": np.inf, "w[xyz]": np.inf}
    result = lc.calibrate(loose, data, noise=sds, method="implicit-loop")
    assert result.accuracy_after is not None
    floor = noise_floor(result)
    assert floor == pytest.approx(0.2 * np.sqrt(2.0 * (1.0 - 6.0 / 24.0)), rel=0.02)
    assert floor == pytest.approx(result.accuracy_after.rms, rel=0.03)


def test_poses_that_are_lost_are_not_taken_for_poses_without_noise() -> None:
    spread, U = np.ones((3, 4, 4)), np.ones((3, 4, 1))
    spread[1, 2], spread[2, 3] = np.nan, np.nan
    sd = np.ones((3, 4))
    sd[2, 3] = np.inf  # unread, so that nothing is lost
    left = _followed(spread, U, sd)
    assert np.isnan(left[1]).all()
    assert np.isfinite(left[[0, 2]]).all()


def test_a_case_without_any_fit_raises_what_the_first_candidate_raised() -> None:
    data = lc.Dataset.from_arrays({q: noisy()[q][:1] for q in noisy().quantities})
    with refused("too-few-poses"):
        choose(Case(ARM.truth, data, lc.Noise(SDS), lc.Fit(method="auto")))


def test_progress_is_told_at_every_iteration_of_each_candidate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A busy machine may give a fit to a helping process, which tells nothing.
    monkeypatch.setattr("loopcal.statistics.choice.process_cores", InProcess)
    begun = 0

    def told(iteration: int, chi_squared: float, decrease: float) -> None:
        nonlocal begun
        begun += iteration == 1

    result = lc.calibrate(ARM.truth, noisy(), noise=SDS, progress=told)
    assert result.chosen is not None
    assert begun >= len(result.chosen.over)


def test_one_fit_has_nothing_to_leave_out_or_to_share() -> None:
    with refused("unsupported", "scheme and executor would have no effect"):
        lc.calibrate(
            ARM.truth,
            noisy(),
            noise=SDS,
            method="implicit-loop",
            scheme=Scheme(folds=5),
            executor=InProcess(),
        )


def test_a_calibration_that_does_not_converge_is_not_hidden_by_the_nominal_machine() -> None:
    result = lc.calibrate(
        ARM.off(5e-3, 5e-3, seed=1), noisy(), noise=SDS, loss="huber", max_iterations=1
    )
    assert result.chosen is not None
    assert result.chosen.method == "implicit-loop"
    assert not result.status.converged


@pytest.mark.parametrize("stated", [False, True])
def test_images_have_a_nominal_machine_only_where_their_lens_is_stated(stated: bool) -> None:
    """Else it would be the same fit at one sd for all cameras, its poses exact."""
    T = poses(np.random.default_rng(0), 30)
    data = lc.Dataset.from_arrays(seen_at(T) | dict(zip(NAMES, images(T), strict=True)))
    sds = {"[xyz]": 1e-4, "w[xyz]": 1e-4, "eye": 0.2}
    parameters = MACHINE.parameters.with_prior({"eye_f": 9.0} if stated else {})
    case = Case(MACHINE.with_parameters(parameters), data, lc.Noise(sds), Fit(method="auto"))
    drawn = [one.case.fit.method for one in entrants(case) if one.drawn]
    assert [method.name for method in drawn] == ["least-squares"] * stated
