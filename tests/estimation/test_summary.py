"""The summary of a small fit, word for word, and what it says when something is wrong."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.document.result_document import Parts
from loopcal.document.tables import parameter_table
from loopcal.estimation.accuracy import Accuracy
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.result import FitResult
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.prior import Prior
from loopcal.presentation.shown import columns
from loopcal.statistics.calibration_document import calibration_document
from tests.reference.four_bars import passive
from tests.reference.simulated import planar_arm

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
# what of a machine's rounding could show is two digits of an sd, so the golden text is exact
PARAMETERS = """\
parameter    value   change      sd  unit
xA          19.946   -0.054   0.055  mm
yA         -30.009   -0.009   0.047  mm
l2             810            fixed  mm
l3         589.963   -0.037   0.038  mm
phi20       0.6841  -0.0034  0.0095  deg
phi30      -1.2149  -0.0117  0.0098  deg"""


@pytest.fixture(scope="module")
def result() -> FitResult:
    simulated = planar_arm(40)
    data = simulated.read(SDS, seed=1)
    return calibrate(
        simulated.truth, data, noise=Noise(SDS), prior=Prior({"l2": 0.0, "phi30": 0.01})
    )


def test_every_parameter_has_value_change_and_sd_rounded_by_the_sd(result: FitResult) -> None:
    assert "\n".join(parameter_table(fit_document(result).parameters)) == PARAMETERS


def test_the_whole_says_method_state_fit_accuracy_and_parameters(result: FitResult) -> None:
    text = str(fit_document(result))
    lines = text.splitlines()
    assert lines[0] == "planar two-link arm: implicit loop (all sensors uncertain)"
    assert lines[2] == f"converged in {result.status.iterations} iterations on 40 poses"
    start = lines.index("accuracy    mean [mm]    rms   95 %    max")
    assert start == 4
    state = lines[start + 5 :]
    assert state[0] == "chi-squared 65.039 at 76 degrees of freedom (per degree 0.856, p = 0.81)"
    assert state[1] == "5 of 5 parameters determined, condition number 1.20"
    assert state[2].startswith("loop equations: rms 0.000776 before, ")
    assert state[2].endswith("after (closed by correcting the readings)")
    assert lines[start + 1 : start + 4] == [
        "nominal        0.8577  1.097  1.831  3.637",
        "calibrated     0.8537  1.081  1.960  3.383",
        "(computed from the other readings minus measured, on the poses used for the fit)",
    ]
    assert PARAMETERS in text
    assert "WARNING" not in text


def test_it_stays_within_a_terminal(result: FitResult) -> None:
    assert max(len(line) for line in str(fit_document(result)).splitlines()) <= 100


def test_known_errors_stand_beside_the_sds(result: FitResult) -> None:
    errors = dict.fromkeys(result.value, 0.0) | {"xA": 1.23e-4, "phi20": -1e-4}
    known = calibration_document(fit_document(result), Parts(errors=errors))
    table = parameter_table(known.parameters)
    assert table[0].split() == ["parameter", "value", "change", "sd", "error", "unit"]
    assert table[1].split() == ["xA", "19.946", "-0.054", "0.055", "+0.123", "mm"]
    assert table[5].split()[-2:] == ["-0.0057", "deg"]


def test_a_fit_that_did_not_converge_says_so_first() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SDS, seed=1)
    start = simulated.off(0.05, 0.1)
    stopped = calibrate(start, data, noise=Noise(SDS), max_iterations=1)
    lines = str(fit_document(stopped)).splitlines()
    assert lines[2] == "NOT CONVERGED (max_iterations) in 1 iteration on 40 poses"
    assert lines[3].strip() == stopped.status.message


def test_least_squares_has_no_chi_squared() -> None:
    simulated = planar_arm(40)
    basic = calibrate(simulated.truth, simulated.read(SDS, seed=1), method="least-squares")
    text = str(fit_document(basic))
    assert text.startswith("planar two-link arm: least squares (sensors taken as exact)")
    assert "chi-squared" not in text
    assert "closed by correcting" not in text


def test_an_undetermined_parameter_has_an_unknown_sd_and_a_warning() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SDS, seed=1)
    still = data.with_readings({"phi2": np.zeros(40)})
    fitted = calibrate(simulated.truth, still, method="least-squares")
    assert fitted.status.converged
    loose = planar_arm(40)
    poses = loose.read(SDS, seed=1).take([0] * 6)
    one = calibrate(loose.truth, poses, noise=Noise(SDS))
    text = str(fit_document(one))
    assert "unknown" in text
    assert "WARNING  Not identifiable:" in text
    assert "of 6 parameters determined" in text


def test_wrong_sds_are_called_wrong_in_either_direction() -> None:
    simulated = planar_arm(200)
    data = simulated.read(SDS, seed=1)
    for factor, words in ((0.1, "these sds are too small"), (10.0, "which are too large")):
        noise = Noise({q: factor * sd for q, sd in SDS.items()})
        fitted = calibrate(simulated.truth, data, noise=noise)
        assert words in str(fit_document(fitted))
    right = calibrate(simulated.truth, data, noise=Noise(SDS))
    assert "WARNING" not in str(fit_document(right))


def test_a_loop_without_outputs_has_no_accuracy_to_speak_of() -> None:
    simulated = passive()
    noise = Noise({"crank": 1e-3, "rocker": 1e-3, "coupler": np.inf})
    fitted = calibrate(simulated.truth, simulated.read(), noise=noise)
    assert fitted.accuracy_after is None
    assert "accuracy unknown: the mechanism has no outputs to predict" in str(fit_document(fitted))


def test_poses_left_out_are_counted() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SDS, seed=1).exclude(["3", "7"])
    fitted = calibrate(simulated.truth, data, noise=Noise(SDS))
    assert "on 38 of 40 poses" in str(fit_document(fitted))


def test_accuracy_is_of_distances_where_both_points_are_there() -> None:
    accuracy = Accuracy.of(np.array([5.0, 1.0, np.nan, 0.0]), "m")
    assert accuracy is not None
    assert accuracy.poses == 3
    assert (accuracy.mean, accuracy.max) == (2.0, 5.0)
    assert accuracy.rms == pytest.approx((26 / 3) ** 0.5)
    assert accuracy.p95 == pytest.approx(np.percentile([5.0, 1.0, 0.0], 95))
    assert Accuracy.of(np.full(3, np.nan), "m") is None


def test_columns_line_up() -> None:
    rows = [["name", "value", "unit"], ["a", "1.25", "mm"], ["longer", "-30", "deg"]]
    assert columns(rows) == ["name    value  unit", "a        1.25  mm", "longer    -30  deg"]


def test_a_notebook_shows_a_table_and_a_terminal_one_line(result: FitResult) -> None:
    assert lc.Result.of(result)._repr_html_().startswith("<div><p><b>planar two-link arm</b>")
    assert repr(result) == "<Result: implicit-loop, converged, 5 parameters>"


def test_the_calibrated_machine_is_the_next_nominal(result: FitResult) -> None:
    again = result.calibrated
    assert {p.name: p.nominal for p in again.parameters} == dict(result.value)
    assert again.tape is result.mechanism.tape


def test_a_result_cannot_be_changed(result: FitResult) -> None:
    with pytest.raises(TypeError):
        result.value["l3"] = 1.0  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        result.corrections["phi3"][0] = 1.0
