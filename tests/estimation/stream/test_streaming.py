"""Poses that come in chunks give what the same poses in memory give."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from loopcal import Dataset, Noise, calibrate, predict
from loopcal.errors import Code
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.estimation.stream import calibrate as learning
from loopcal.estimation.stream.calibrate import Parts, calibrate_stream
from loopcal.estimation.stream.merit import Chunk
from loopcal.execution.executor import AHEAD, Executor
from loopcal.execution.local import Processes, Threads
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.prior import Prior
from loopcal.mechanisms.structure.structured import structured
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from loopcal.statistics.outliers import find_outliers
from tests.execution.pieces import Backwards
from tests.reference.simulated import planar_arm
from tests.refusals import refused


@dataclass
class Pieces:
    """A data set in pieces of a size that does not divide it."""

    data: Dataset
    noise: Noise
    size: int = 170
    served: int = 0

    @property
    def poses(self) -> int:
        return len(self.data)

    @property
    def count(self) -> int:
        return -(-len(self.data) // self.size)

    def chunk(self, number: int) -> Chunk:
        part = slice(number * self.size, (number + 1) * self.size)
        entries = {
            key: value[part] if getattr(value, "ndim", 0) == 3 else value
            for key, value in self.noise.entries.items()
        }
        self.served += 1
        return Chunk(self.data.take(part), Noise(entries, estimate=self.noise.estimate))


def whole_result(chunk: FitResult) -> FitResult:
    return chunk


def arm_and_data(poses: int = 900, seed: int = 3) -> tuple[Mechanism, Dataset]:
    arm = motoman_ma1400()
    driven = random_poses({f"theta_{i}": (-1.5, 1.5) for i in range(1, 7)}, poses, seed=seed)
    truth = {"x1": 0.153, "z2": 0.612, "phix1": 0.003, "x0": 1.0, "phix0": 0.1}
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    return arm, simulate(arm, driven, noise=noise, seed=seed, truth=truth).dataset


def alike(streamed: FitResult, whole: FitResult) -> None:
    assert streamed.status.converged
    assert whole.status.converged
    for name in whole.estimated:
        sd = whole.sd[name]
        assert sd is not None
        assert streamed.value[name] == pytest.approx(whole.value[name], abs=1e-7 * sd)
        assert streamed.sd[name] == pytest.approx(sd, rel=1e-9)
    if whole.chi_squared is not None:
        assert streamed.chi_squared is not None
        assert streamed.chi_squared.value == pytest.approx(whole.chi_squared.value, rel=1e-9)
        assert streamed.chi_squared.degrees_of_freedom == whole.chi_squared.degrees_of_freedom
    assert streamed.accuracy_after is not None
    assert whole.accuracy_after is not None
    for key in ("mean", "rms", "max", "poses"):
        expected = getattr(whole.accuracy_after, key)
        assert getattr(streamed.accuracy_after, key) == pytest.approx(expected, rel=1e-9)
    assert streamed.accuracy_after.p95 == pytest.approx(whole.accuracy_after.p95, rel=5e-3)


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_a_stream_gives_what_memory_gives(method: str) -> None:
    arm, data = arm_and_data()
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    streamed = calibrate_stream(arm, Pieces(data, noise), fit=Fit(method=method))
    alike(streamed, calibrate(arm, data, noise=noise, method=method))


def test_covariances_of_each_reading_and_gaps_come_along() -> None:
    arm, data = arm_and_data(400)
    z = np.where(np.arange(400) % 7 == 0, np.nan, data["z"])
    data = data.with_readings({"z": z})
    spread = np.linspace(1.0, 3.0, 400)[:, None, None]
    noise = Noise({"theta_*": 5e-5, ("x", "y", "z"): 1e-10 * np.eye(3) * spread})
    alike(
        calibrate_stream(arm, Pieces(data, noise)),
        calibrate(arm, data, noise=noise, method="implicit-loop"),
    )


def test_an_angle_that_nobody_reads_is_found_in_every_chunk() -> None:
    arm = planar_two_link()
    driven = random_poses({"phi2": (0.0, 3.0), "phi3": (0.3, 2.5)}, 500, seed=1)
    exact = Noise({"phi?": 1e-3, "*": 1e-5})
    data = simulate(arm, driven, noise=exact, seed=1, truth={"l2": 0.803}).dataset
    noise = Noise({"phi2": 1e-3, "phi3": np.inf, "*": 1e-5})
    arm = arm.with_parameters(arm.parameters.with_fixed(["phi30", "l3"]))
    alike(
        calibrate_stream(arm, Pieces(data, noise)),
        calibrate(arm, data, noise=noise, method="implicit-loop"),
    )


def test_every_chunk_is_handed_out_with_its_corrections() -> None:
    arm, data = arm_and_data(500)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    seen: list[FitResult] = []
    calibrate_stream(arm, Pieces(data, noise), parts=Parts(whole_result, seen.append))
    whole = calibrate(arm, data, noise=noise, method="implicit-loop")
    assert [pose for part in seen for pose in part.dataset.poses] == list(data.poses)
    streamed = np.concatenate([part.corrections["theta_2"] for part in seen])
    assert streamed == pytest.approx(whole.corrections["theta_2"], abs=1e-5 * 5e-5)


def test_a_chunk_may_hold_no_pose_to_be_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every 50 poses the first is shown, and the last chunk has the last 41."""
    monkeypatch.setattr("loopcal.estimation.stream.calibrate.SHOWN", 10)
    arm = planar_two_link()
    driven = random_poses({"phi2": (0.0, 3.0), "phi3": (0.3, 2.5)}, 500, seed=1)
    noise = Noise({"phi?": 1e-4, "*": 2e-5})
    data = simulate(arm, driven, noise=noise, seed=1, truth={"l2": 0.803}).dataset
    found = calibrate_stream(arm, Pieces(data, noise, 51))
    alike(found, calibrate(arm, data, noise=noise, method="implicit-loop"))
    assert found.dataset.poses == data.poses[::50]


def with_y(data: Dataset, pose: str, y: float) -> Dataset:
    """The data with another y in one pose."""
    return data.with_readings({"y": np.where(np.array(data.poses) == pose, y, data["y"])})


def test_a_pose_that_fits_badly_is_shown_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 900 poses 90 are shown, and one that none of them tells of."""
    monkeypatch.setattr("loopcal.estimation.stream.calibrate.SHOWN", 90)
    arm, data = arm_and_data()
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    good = calibrate_stream(arm, Pieces(data, noise))
    assert len(good.dataset) <= 91
    assert find_outliers(good).found == ()
    wrong = with_y(data, "424", float(data["y"][423]) + 5e-4)
    found = calibrate_stream(arm, Pieces(wrong, noise))
    assert "424" in found.dataset.poses
    assert list(map(int, found.dataset.poses)) == sorted(map(int, found.dataset.poses))
    outliers = find_outliers(found)
    assert (outliers.found[0].pose, outliers.found[0].quantity) == ("424", "y")
    assert outliers.tested == 900
    whole = find_outliers(calibrate(arm, wrong, noise=noise, method="implicit-loop"))
    assert [outlier.pose for outlier in whole.found] == ["424"]


def test_those_shown_besides_say_nothing_of_all_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("loopcal.estimation.stream.calibrate.SHOWN", 90)
    arm, data = arm_and_data()
    wrong = with_y(data, "424", float(data["y"][423]) + 0.1)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    found = calibrate_stream(arm, Pieces(wrong, noise))
    assert "424" in found.dataset.poses
    words = " ".join(found.warnings)
    assert "stated sds allow" in words
    assert "would explain it" not in words
    assert "more that fit badly" in words


@pytest.mark.parametrize("size", [1e3, 1e9])
def test_a_point_out_of_reach_is_refused_wherever_it_is_read(size: float) -> None:
    """As a stand-in for what is missing would be: a fit would be about this pose alone."""
    arm, data = arm_and_data()
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    wrong = with_y(data, "424", size)
    with refused("implausible-readings", "pose '424'") as of_stream:
        calibrate_stream(arm, Pieces(wrong, noise))
    with refused("implausible-readings", "pose '424'") as of_memory:
        calibrate(arm, wrong, noise=noise, method="implicit-loop")
    assert "x, y, z" in str(of_stream.value)
    assert "data.exclude" in str(of_memory.value)


def test_poses_that_cannot_be_closed_are_named() -> None:
    """Far off, but not out of all reach: by its id, not by where it is in a chunk."""
    arm, data = arm_and_data()
    ids = tuple(f"p{pose}" for pose in data.poses)
    data = Dataset(data.readings, data.units, ids, data.sds, data.source)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    wrong = with_y(data, "p424", 30.0)
    found = calibrate_stream(
        arm, Pieces(wrong, noise), fit=Fit(max_iterations=20, method="implicit-loop")
    )
    assert found.status.reason == "cannot_close"
    assert "p424" in found.status.message


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_a_parameter_whose_terms_cancel_has_no_effect_here_either(method: str) -> None:
    """What rounding leaves of its column shows beside the other length."""
    machine = Mechanism.from_function(
        lambda x, p: (x.b - p.k * np.sin(x.a) - p.c * (np.sin(x.a) ** 2 + np.cos(x.a) ** 2 - 1.0),),
        {"a": "rad", "b": "m"},
        {"k": (1.0, "m"), "c": (1.0, "m")},
    )
    a = np.linspace(0.2, 2.0, 400)
    b = 1.1 * np.sin(a) + 1e-3 * np.random.default_rng(1).normal(size=400)
    data, noise = Dataset.from_arrays({"a": a, "b": b}), Noise({"a": 1e-4, "b": 1e-3})
    whole = calibrate(machine, data, noise=noise, method=method)
    found = calibrate_stream(machine, Pieces(data, noise), fit=Fit(method=method))
    assert [list(u.combination) for u in whole.identifiability.not_identifiable] == [["c"]]
    assert found.identifiability.not_identifiable == whole.identifiability.not_identifiable
    assert found.value["k"] == pytest.approx(whole.value["k"], rel=1e-9)


def theta_1(chunk: FitResult) -> list[float]:
    return [float(value) for value in chunk.corrections["theta_1"]]


def told(result: FitResult) -> list[object]:
    """All that must be the same to the last bit."""
    assert result.chi_squared is not None
    own = [dict(result.value), dict(result.sd), result.accuracy_before, result.accuracy_after]
    arrays = [result.covariance.tolist(), result.information.total.tolist()]
    shown = [result.dataset.poses, theta_1(result)]
    return [*own, *arrays, *shown, result.chi_squared, result.status, result.warnings]


@pytest.mark.parametrize("executor", [Threads(2), Threads(5), Processes(2), Backwards()], ids=str)
def test_whoever_does_the_chunks_the_result_is_the_same_to_the_bit(executor: Executor) -> None:
    arm, data = arm_and_data(600)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    here: list[list[float]] = []
    alone = calibrate_stream(arm, Pieces(data, noise), parts=Parts(theta_1, here.append))
    there: list[list[float]] = []
    shared = calibrate_stream(
        arm, Pieces(data, noise), executor=executor, parts=Parts(theta_1, there.append)
    )
    assert told(shared) == told(alone)
    assert there == here
    assert [len(part) for part in there] == [170, 170, 170, 90]


def test_angles_that_nobody_reads_are_found_alike_by_all() -> None:
    arm = planar_two_link()
    driven = random_poses({"phi2": (0.0, 3.0), "phi3": (0.3, 2.5)}, 300, seed=1)
    exact = Noise({"phi?": 1e-3, "*": 1e-5})
    data = simulate(arm, driven, noise=exact, seed=1, truth={"l2": 0.803}).dataset
    noise = Noise({"phi2": 1e-3, "phi3": np.inf, "*": 1e-5})
    arm = arm.with_parameters(arm.parameters.with_fixed(["phi30", "l3"]))
    alone, shared = (
        calibrate_stream(arm, Pieces(data, noise, 40), executor=executor)
        for executor in (None, Threads(3))
    )
    assert dict(shared.value) == dict(alone.value)
    assert shared.chi_squared == alone.chi_squared


def test_chunks_are_not_worked_on_far_ahead_of_what_is_written() -> None:
    arm, data = arm_and_data(900)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    begun, most = threading.Semaphore(0), []
    written: list[int] = []

    def part_of(chunk: FitResult) -> int:
        begun.release()
        return len(chunk.dataset)

    def write(part: int) -> None:
        written.append(part)
        most.append(begun._value - len(written) + 1)

    stream = Pieces(data, noise, size=15)
    calibrate_stream(arm, stream, executor=Threads(2), parts=Parts(part_of, write))
    assert written == [15] * 60
    assert max(most) <= 2 * AHEAD


def test_the_first_chunk_at_fault_is_told_whichever_was_met_first() -> None:
    machine = Mechanism.from_function(
        lambda x, p: (x.b - p.k * np.sqrt(x.a + p.c),),
        {"a": "m", "b": "m"},
        {"k": (1.0, "1"), "c": (0.0, "m")},
        loops=("reach",),
    )
    a = np.linspace(1.0, 2.0, 900)
    b = np.sqrt(a)
    a[[400, 800]] = -1.0, -2.0
    data = Dataset.from_arrays({"a": a, "b": b})
    noise = Noise({"a": 0.1, "b": 0.1})
    for executor in (None, Threads(2), Backwards()):
        with refused("outside-domain", "-1") as fault:
            calibrate_stream(machine, Pieces(data, noise, 100), executor=executor)
        assert "loop equation 'reach' at pose '401'" in str(fault.value)


def test_too_few_equations_are_refused() -> None:
    arm, data = arm_and_data(8)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    with refused("too-few-poses", "24 loop", "8 poses"):
        calibrate_stream(
            arm, Pieces(data, noise, 3), fit=Fit(start="nominal", method="implicit-loop")
        )


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_a_run_resumed_at_any_iteration_ends_as_the_uninterrupted_one(method: str) -> None:
    arm, data = arm_and_data(300)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    resumed_alike(arm, data, noise, Fit(method=method, max_iterations=30), 170)


def test_so_does_a_search_from_afar_whatever_it_has_in_mind() -> None:
    """Every parameter off by up to 0.3 m or 1 rad: damped, or faster."""
    kept: list[Checkpoint[Any]] = []
    for seed in (0, 3):
        rng = np.random.default_rng(seed)
        sds = {name: 0.1 * float(10 ** rng.uniform(-3, 0)) for name in ("xP", "yP", "phi2", "phi3")}
        drawn = planar_arm(20, seed=seed)
        start, data = drawn.off(0.3, 1.0, seed=seed), drawn.read(sds, seed=seed)
        fit = Fit(method="implicit-loop", start="nominal")
        kept += resumed_alike(start, data, Noise(sds), fit, 7)
    assert sum(one.course.damping > 0.0 for one in kept) >= 3
    assert sum(one.course.recent is not None for one in kept) >= 3


def resumed_alike(
    arm: Mechanism, data: Dataset, noise: Noise, fit: Fit, size: int
) -> list[Checkpoint[Any]]:
    """Resumes at every iteration, compares to the last bit, and returns what was kept."""
    checkpoints: list[str] = []
    fresh = Pieces(data, noise, size)
    whole = calibrate_stream(
        arm,
        fresh,
        fit=fit,
        reached=lambda checkpoint: checkpoints.append(json.dumps(checkpoint.document())),
    )
    assert len(checkpoints) == whole.status.iterations >= 3
    found = [Checkpoint.read(json.loads(text)) for text in checkpoints]
    for number, resume in enumerate(found):
        resumed = Pieces(data, noise, size)
        assert resume.iterations == number
        again = calibrate_stream(arm, resumed, fit=fit, resume=resume)
        assert resumed.served < fresh.served or number == 0
        assert again.status == whole.status
        assert again.value == whole.value
        assert again.sd == whole.sd
        assert again.chi_squared == whole.chi_squared
        assert np.array_equal(again.covariance, whole.covariance)
    return found


@pytest.mark.parametrize("loss", ["huber", "student-t"])
def test_a_robust_stream_gives_what_memory_gives_and_resumes_exactly(loss: str) -> None:
    arm, data = arm_and_data(400)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    spoilt = data["y"] + np.where(np.arange(400) % 40 == 7, 2e-3, 0.0)
    data, fit = data.with_readings({"y": spoilt}), Fit(loss=loss, method="implicit-loop")
    checkpoints: list[str] = []
    streamed = calibrate_stream(
        arm,
        Pieces(data, noise),
        fit=fit,
        reached=lambda checkpoint: checkpoints.append(json.dumps(checkpoint.document())),
    )
    whole = calibrate(arm, data, noise=noise, loss=loss, method="implicit-loop")
    alike(streamed, whole)
    assert len(checkpoints) == streamed.status.iterations
    for checkpoint in checkpoints[2::5]:
        resume = Checkpoint.read(json.loads(checkpoint))
        again = calibrate_stream(arm, Pieces(data, noise), fit=fit, resume=resume)
        assert again.value == streamed.value
        assert again.sd == streamed.sd
        assert again.status.iterations == streamed.status.iterations


def test_what_needs_all_poses_at_once_is_refused() -> None:
    arm, data = arm_and_data(200)
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    with refused("unsupported", "'reweighted'"):
        calibrate_stream(arm, Pieces(data, noise), fit=Fit(method="reweighted"))


@pytest.mark.parametrize(
    ("noise", "loss", "code"),
    [
        (Noise({"*": 0.0}), "gaussian", "exact-readings"),
        (Noise({"*": 1e-4}, estimate={"xyz": "group"}), "huber", "unsupported"),
    ],
)
def test_what_memory_refuses_a_stream_refuses_by_the_same_name(
    noise: Noise, loss: str, code: Code
) -> None:
    """Readings stated as exact that contradict each other; a loss that would have to learn sds."""
    arm, data = arm_and_data(200)
    fit = Fit(method="implicit-loop", loss=loss)
    with refused(code):
        calibrate_stream(arm, Pieces(data, noise), fit=fit)
    with refused(code):
        calibrate(arm, data, noise=noise, fit=fit)


def test_sds_of_sensors_are_learnt_from_a_stream_as_from_memory() -> None:
    """All poses are fitted at them; a name that stands for several quantities is each of them."""
    arm, data = arm_and_data(400)
    fit = Fit(method="implicit-loop", start="nominal")
    noise = Noise({"theta_*": 5e-5, "xyz": 3e-5}, estimate={"[xyz]": "each"})
    streamed = calibrate_stream(arm, Pieces(data, noise), fit=fit)
    close(streamed, calibrate(arm, data, noise=noise, fit=fit))
    assert [entry.source for entry in streamed.noise].count("estimated") == 3


def test_sds_learnt_from_some_poses_of_a_stream_weigh_all(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, data = arm_and_data(600)
    monkeypatch.setattr(learning, "ENOUGH", 300)
    noise = Noise({"theta_*": 5e-5, "xyz": 3e-5}, estimate={"xyz": "group"})
    streamed = calibrate_stream(arm, Pieces(data, noise), fit=Fit(method="implicit-loop"))
    assert any("learnt from 300 of these poses, one of every 2" in n for n in streamed.parts.notes)
    (sd,) = {entry.sd for entry in streamed.noise if entry.source == "estimated"}
    stated = Noise({"theta_*": 5e-5, "xyz": sd})
    whole = calibrate(arm, data, noise=stated, method="implicit-loop")
    assert streamed.solution.poses == 600
    for name in whole.estimated:
        near = 1e-3 * (whole.sd[name] or 0.0)
        assert streamed.value[name] == pytest.approx(whole.value[name], abs=near)


def close(streamed: FitResult, whole: FitResult) -> None:
    """To what both leave of learnt sds: fits end at 1e-5 sds, logarithms of variances at 1e-3."""
    assert streamed.status.converged
    assert streamed.estimate is not None
    assert streamed.estimate.settled
    for name in whole.estimated:
        sd = whole.sd[name]
        assert sd is not None
        assert streamed.value[name] == pytest.approx(whole.value[name], abs=0.02 * sd)
    # at the learnt sds: what learning them adds is left out of a stream
    one, other = (np.diag(r.spectrum.covariance()) for r in (streamed, whole))
    assert one == pytest.approx(other, rel=4e-3)
    for term, same in zip(streamed.terms, whole.terms, strict=True):
        assert term.scale == pytest.approx(same.scale, rel=2e-3)
        assert term.gain == pytest.approx(same.gain, abs=0.1)
        assert term.effective == pytest.approx(same.effective, abs=0.02)
    for n, m in zip(streamed.noise, whole.noise, strict=True):
        assert (n.quantities, n.source) == (m.quantities, m.source)
        assert n.sd == pytest.approx(m.sd, rel=2e-3)


def test_terms_are_learnt_from_a_stream_as_from_memory() -> None:
    """One factor of the noise, with least squares; none, with stated sds."""
    arm, data = arm_and_data(400)
    prior = Prior(
        {"*": np.inf, "?6B": 5e-3, "z2": 1e-3, "x[145]": 1e-3}, estimate={"x[145]": "group"}
    )
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    known = prior.apply(arm)
    # aligned by the first chunk or by all poses, the nominal machine is described differently
    learning = Fit(method="least-squares", model_error="structured", start="nominal")
    for machine, fit in (
        (structured(known, harmonics=False), learning),
        (known, Fit(method="implicit-loop")),
    ):
        streamed = calibrate_stream(machine, Pieces(data, noise), fit=fit)
        close(streamed, calibrate(machine, data, noise=noise, fit=fit))


def test_a_stream_with_learnt_terms_is_fitted_to_some_poses_and_judged_by_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm, data = arm_and_data(600)
    prior = Prior({"*": np.inf, "x[145]": 1e-3}, estimate={"x[145]": "group"})
    noise, known = Noise({"theta_*": 5e-5, "xyz": 1e-5}), prior.apply(arm)
    monkeypatch.setattr(learning, "ENOUGH", 200)
    streamed = calibrate_stream(known, Pieces(data, noise), fit=Fit(method="implicit-loop"))
    assert any("used 200 of these poses, one of every 3" in note for note in streamed.parts.notes)
    part = calibrate(known, data.take(np.arange(0, 600, 3)), noise=noise, method="implicit-loop")
    assert [t.scale for t in streamed.terms] == pytest.approx(
        [t.scale for t in part.terms], rel=learning.NEARLY
    )
    for name in part.estimated:
        assert streamed.value[name] == pytest.approx(
            part.value[name], abs=learning.NEARLY * (part.sd[name] or 0.0)
        )
    assert streamed.accuracy_after is not None
    assert streamed.accuracy_after.poses == 600
    whole = predict(part, data)
    away = np.array([whole.outputs[q] - data.readings[q] for q in ("x", "y", "z")])
    rms = np.sqrt(np.square(away).sum(axis=0).mean())
    assert streamed.accuracy_after.rms == pytest.approx(rms, rel=1e-3)


def test_a_stream_learns_the_model_error_beside_stated_sds() -> None:
    """What the fit of some poses in memory can learn, a stream can."""
    arm, data = arm_and_data(100)
    fit = Fit(model_error="structured", prior={"*": np.inf}, method="implicit-loop")
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    streamed = calibrate_stream(arm, Pieces(data, noise), fit=fit)
    whole = calibrate(arm, data, noise=noise, fit=fit)
    close(streamed, whole)
    assert "disturbance" in {entry.role for entry in streamed.noise}


def test_a_file_at_fault_is_named_from_the_first_chunk_and_what_is_not_sought_is_said() -> None:
    arm, data = arm_and_data()
    noise = Noise({"theta_*": 5e-5, "xyz": 1e-5})
    swapped = {"theta_4": data["theta_6"], "theta_6": data["theta_4"]}
    wrong = replace(data, readings={**data.readings, **swapped})
    found = calibrate_stream(arm, Pieces(wrong, noise))
    assert [fault.code for fault in found.faults] == ["exchanged"]
    assert found.status.iterations <= 3
    good = calibrate_stream(arm, Pieces(data, noise))
    assert good.faults == ()
    assert "does not search for copied rows" in " ".join(good.warnings)
