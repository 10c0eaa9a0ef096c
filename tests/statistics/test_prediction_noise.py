"""What a prediction knows of the noise of the calibration, from the result and from its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.document_parts import covariance_entry
from loopcal.files.result.result_file import read_result, write_result
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.calibrated import stored_covariance
from loopcal.statistics.predictor import Predictor, predictor, predictor_of
from tests.refusals import refused

ARM = lc.planar_two_link()
BOX = {"phi2": (0.0, 1.6), "phi3": (0.0, 1.6)}
NEW = {"phi2": [0.3, 0.9], "phi3": [1.1, 0.4]}


def calibrated(noise: lc.Noise, poses: int = 12) -> lc.Result:
    at = lc.random_poses(BOX, poses, seed=3)
    really = lc.Noise(noise.entries)
    readings = lc.simulate(ARM, at, noise=really, seed=4).dataset
    return lc.calibrate(ARM, readings, noise=noise, start="nominal", method="implicit-loop")


def from_files(result: lc.Result, folder: Path) -> Predictor:
    known = predictor(result)
    assert known is not None
    document = replace(result.document, prediction=known.entry)
    write_result(result, document, folder)
    return predictor_of(read_result(folder / "result.json"), result.mechanism)


def by_readings(result: lc.Result, noise: Any = None) -> np.ndarray:
    part = lc.predict(result, NEW, noise=noise).from_readings
    assert part is not None
    return part


@pytest.mark.parametrize(
    "noise",
    [
        lc.Noise({"?P": 1e-4, "phi2": 1e-4, "phi3": 1e-3}, estimate={"phi?": "group"}),
        lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"?P": "group", "phi?": "each"}),
        lc.Noise({"?P": 1e-4, ("phi2", "phi3"): [[1e-6, -9e-7], [-9e-7, 1e-6]]}),
    ],
    ids=["unlike sds", "each", "joint"],
)
def test_files_predict_as_the_result_does(noise: lc.Noise, tmp_path: Path) -> None:
    result = calibrated(noise)
    a, b = lc.predict(result, NEW), lc.predict(from_files(result, tmp_path), NEW)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-12)
    np.testing.assert_allclose(a.freedom, b.freedom, rtol=1e-4)
    np.testing.assert_allclose(a.region(), b.region(), rtol=1e-4)


def test_files_are_as_sure_where_parameters_make_up_for_each_other() -> None:
    """Two unsure by 0.2 m, as tool and place along the slide of a SCARA, their sum by 10 um."""
    common, single = np.array([[1.0, -1.0], [-1.0, 1.0]]) / 3.0, np.eye(2)
    plain = 0.2**2 * common + 1e-5**2 * single
    slopes = np.array([0.7 * 0.2**2 * common + 0.5 * 1e-5**2 * single])
    learnt = LearntCovariance(plain, plain, slopes)
    entry = covariance_entry(("place", "tool"), learnt, plain, frozenset())
    stored = stored_covariance(entry, None)
    together = np.array([[1.0, 1.0]])
    # 2 / 0.5^2 by Satterthwaite
    assert learnt.through(together).freedom == pytest.approx([8.0], rel=1e-6)
    assert stored.through(together).freedom == pytest.approx([8.0], rel=1e-6)


def test_a_group_with_unlike_sds_keeps_the_noise_of_each() -> None:
    noise = lc.Noise({"?P": 1e-4, "phi2": 1e-4, "phi3": 1e-3}, estimate={"phi?": "group"})
    result = calibrated(noise)
    entries = {q: entry.sd for entry in result.noise for q in entry.quantities}
    assert entries["phi3"] == pytest.approx(10 * entries["phi2"])
    given = {q: entries[q] for q in NEW}
    np.testing.assert_allclose(by_readings(result), by_readings(result, given))


def test_a_stated_joint_covariance_is_that_of_new_readings() -> None:
    joint = {("phi2", "phi3"): np.array([[1e-6, -9e-7], [-9e-7, 1e-6]])}
    result = calibrated(lc.Noise({"?P": 1e-4, **joint}))
    np.testing.assert_allclose(by_readings(result), by_readings(result, lc.Noise(joint)))


def test_intervals_of_predictions_have_few_degrees_after_few_poses() -> None:
    noise = lc.Noise({"?P": 5e-4, "phi?": 1e-3}, estimate={"*": "group"})
    few = lc.predict(calibrated(noise, 6), NEW)
    half = few.half_width()["xP"] / few.sd["xP"]
    assert (half > 2.3).all()  # 6 degrees of freedom: 2.45
    known = lc.predict(calibrated(lc.Noise(noise.entries), 6), NEW)
    np.testing.assert_allclose(known.half_width()["xP"] / known.sd["xP"], 1.959964, rtol=1e-6)
    assert few.region().min() > known.region().max()


def passive() -> tuple[lc.Mechanism, lc.Result]:
    """x = 2 s and s = 3 t: no sensor reads s, whose column holds guesses."""
    line = lc.Mechanism.from_function(
        lambda x, p: (x.x - p.a * x.s, x.s - 3.0 * x.t),
        quantities={"x": "1", "s": "1", "t": "1"},
        parameters={"a": (2.0, "1")},
        outputs=("x",),
    )
    t = np.linspace(0.5, 1.5, 8)
    data = {"x": 6.0 * t, "s": 3.0 * t + 0.3, "t": t}
    noise = lc.Noise({"x": 1e-3, "s": np.inf, "t": 1e-3})
    return line, lc.calibrate(line, data, noise=noise, method="implicit-loop")


def test_the_column_of_a_quantity_that_no_sensor_reads_is_a_guess(tmp_path: Path) -> None:
    _, result = passive()
    for known in (result, from_files(result, tmp_path)):
        found = lc.predict(known, {"t": [1.0, 2.0], "s": [3.4, 5.0]})
        np.testing.assert_allclose(found.outputs["x"], [6.0, 12.0], rtol=1e-3)
        blind = lc.predict(known, {"t": [1.0, 2.0]})
        np.testing.assert_allclose(found.covariance, blind.covariance, rtol=1e-9)


def test_a_stated_sd_makes_it_a_reading() -> None:
    _, result = passive()
    sds = {"t": 1e-3, "s": 1e-9}
    found = lc.predict(result, {"t": [1.0], "s": [3.0]}, noise=sds)
    assert found.outputs["x"][0] == pytest.approx(6.0, rel=1e-3)
    assert found.sd["x"][0] < lc.predict(result, {"t": [1.0]}).sd["x"][0]


def test_an_unmeasured_joint_without_loops_to_find_it_is_refused() -> None:
    result = calibrated(lc.Noise({"?P": 1e-4, "phi?": 1e-3}))
    with refused("missing-reading", "phi3"):
        lc.predict(result, NEW, noise={"phi2": 1e-3, "phi3": np.inf})


def test_the_units_of_the_hundreds_of_outputs_of_an_image_are_listed_once() -> None:
    known = predictor(calibrated(lc.Noise({"?P": 1e-4, "phi?": 1e-3})))
    assert known is not None
    assert known.units is known.units
