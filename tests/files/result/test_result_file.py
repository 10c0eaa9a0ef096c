"""result.json says what the result is, is valid JSON of its schema, and reads back as it was."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from loopcal.document.accuracy import Coverage, ValidationEntry
from loopcal.document.choice import Candidate, Chosen, TermEntry
from loopcal.document.plain import finite_only, plain
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer, Verdict, answered
from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.result import FitResult
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.result.pose_table import residuals_csv
from loopcal.files.result.result_file import (
    read_result,
    result_json,
    result_schema,
)
from loopcal.files.result.truth_file import read_truth, truth_json
from loopcal.files.tables.writer import LARGE, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import planar_two_link
from loopcal.mechanisms.prior import Prior
from loopcal.simulation.poses import grid_poses
from loopcal.simulation.simulate import simulate
from loopcal.statistics.prediction import predict
from loopcal.statistics.predictor import predictor_of
from loopcal.workflow.result import Result, write_result
from tests.refusals import refused

NOISE = Noise({"?P": 1e-4, "phi?": 1e-3})
POSES = grid_poses({"phi2": np.arange(0, 6, 0.75), "phi3": np.arange(0.3, 6, 0.75)})
MADE = simulate(planar_two_link(), POSES, noise=NOISE, seed=4, truth={"l2": 0.803})


def loose() -> FitResult:
    """One parameter has no effect at all, one is fixed, one has a prior."""
    mechanism = Mechanism.from_function(
        lambda x, p: p.a * x.u + p.b + p.c * 0.0 + p.d - x.v,
        {"u": "m", "v": "m"},
        {"a": (1.0, "1"), "b": (0.0, "m"), "c": (5.0, "m"), "d": (0.5, "m")},
    )
    u = np.linspace(0, 1, 20)
    data = Dataset.from_arrays({"u": u, "v": 1.1 * u + 0.3 + 1e-3 * np.cos(40 * u)})
    fixed = mechanism.with_parameters(mechanism.parameters.with_fixed(["d"]))
    prior = Prior({"*": math.inf, "a": 0.5})
    return calibrate(fixed, data, noise=Noise({"*": 1e-3}), prior=prior)


def with_gaps() -> FitResult:
    readings = {q: MADE.dataset[q].copy() for q in MADE.dataset.quantities}
    readings["xP"][3] = np.nan
    noise = Noise({"xP": 1e-4, "yP": 0.0, "phi?": 1e-3})
    return calibrate(planar_two_link(), Dataset.from_arrays(readings), noise=noise)


RESULTS = {
    "implicit loop": lambda: calibrate(planar_two_link(), MADE.dataset, noise=NOISE),
    "least squares": lambda: calibrate(planar_two_link(), MADE.dataset, method="least-squares"),
    "undamped": lambda: calibrate(
        planar_two_link(), MADE.dataset, noise=NOISE, method="implicit-loop-undamped"
    ),
    "not converged": lambda: calibrate(
        planar_two_link({"phi30": 0.5}), MADE.dataset, noise=NOISE, max_iterations=1
    ),
    "not identifiable": loose,
    "with gaps": with_gaps,
}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_keeps_to_the_published_schema_and_reads_back(
    name: str, tmp_path: Path
) -> None:
    result = RESULTS[name]()
    inputs = {"prior": {"*": {"sd": math.inf}}, "data": {"exclude": ["1"], "every": 1}}
    written = write_result(result, tmp_path, title="µ", inputs=inputs, warnings=("odd",))
    text = (tmp_path / "result.json").read_text("utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    document = json.loads(text)
    jsonschema.Draft202012Validator(result_schema()).validate(document)
    assert document == plain(written.document)
    assert read_result(tmp_path / "result.json") == written.document
    assert document["inputs"]["prior"]["*"]["sd"] == "inf"
    assert document["warnings"][0] == "odd"
    assert result_json(written.document) == text


def judged() -> ResultDocument:
    """A document with all that schema 2 added."""
    document = fit_document(RESULTS["implicit loop"]())
    assert document.accuracy is not None
    far = document.accuracy.before
    answer = Answer(None, "undecided", 1.0, "Nobody asked.", None)
    held = ValidationEntry({"blocks": 5}, "5 regions", 64, far, None)
    held = replace(held, coverage=Coverage(0.95, 0.94, 64))
    over = (
        Candidate("implicit-loop", far, far, 0.0, 0.0),
        Candidate("x", None, None, None, None, "hopeless"),
    )
    return replace(
        document,
        chosen=Chosen("implicit-loop", ("sag",), "implicit-loop, over x", over),
        terms=(TermEntry("sag", "rad/m", 5e-4, (2e-4, None), 4e-4, 3, 2.5, 11.0, "it gives way"),),
        verdict=Verdict(answer, answer, answer, answer, "Undecided."),
        accuracy=replace(document.accuracy, nominal=far, noise_floor=1e-4),
        validation=replace(held, scheme={"folds": 10}, blocked=held),
    )


def test_a_document_with_all_of_schema_2_keeps_to_it_and_reads_back(tmp_path: Path) -> None:
    document, path = judged(), tmp_path / "result.json"
    path.write_text(result_json(document), encoding="utf-8")
    jsonschema.Draft202012Validator(result_schema()).validate(json.loads(path.read_text("utf-8")))
    read = read_result(path)
    assert document.verdict is not None
    assert read.verdict == document.verdict
    assert plain(replace(read, findings=())) == plain(document)
    # its verdict had no findings yet: each answer is one, as it was
    for question, answer in document.verdict.answers.items():
        of_question = [one for one in read.findings if one.question == question]
        assert [one.words for one in of_question] == [answer.words] * answer.asked
        assert not answer.asked or answered(of_question) is answer.passed


def test_a_file_of_schema_1_is_read(tmp_path: Path) -> None:
    document, path = fit_document(RESULTS["implicit loop"]()), tmp_path / "result.json"
    old = plain(document) | {"schema": 1}
    for added in ("chosen", "terms", "verdict"):
        del old[added]
    del old["accuracy"]["nominal"], old["accuracy"]["noise_floor"]
    path.write_text(json.dumps(old), encoding="utf-8")
    assert plain(read_result(path)) == plain(document)


def test_floats_are_the_same_bits() -> None:
    result = RESULTS["implicit loop"]()
    document = json.loads(result_json(fit_document(result)))
    assert [p["value"] for p in document["parameters"]] == list(result.value.values())
    assert [p["sd"] for p in document["parameters"]] == list(result.sd.values())
    np.testing.assert_array_equal(document["covariance"]["matrix"], result.covariance)


def test_what_is_unknown_is_null() -> None:
    result = loose()
    document = plain(fit_document(result))
    by_name = {p["name"]: p for p in document["parameters"]}
    assert by_name["c"]["sd"] is None
    assert by_name["c"]["identifiable"] is False
    assert by_name["d"]["fixed"] is True
    assert by_name["d"]["sd"] is None
    assert by_name["d"]["identifiable"] is None
    assert by_name["a"]["prior_sd"] == 0.5
    assert by_name["b"]["prior_sd"] is None
    names = document["covariance"]["names"]
    assert names == ["a", "b", "c"]
    unknown = [[value is None for value in row] for row in document["covariance"]["matrix"]]
    assert unknown == [[False, False, True], [False, False, True], [True, True, True]]
    assert document["identifiability"]["rank"] == 2
    assert document["identifiability"]["condition_number"] is None
    assert document["identifiability"]["not_identifiable"][0]["combination"] == {"c": 1.0}
    for key in ("accuracy", "validation", "observability", "outliers"):
        assert document[key] is None


def test_the_basic_method_knows_neither_noise_nor_chi_squared() -> None:
    document = plain(fit_document(RESULTS["least squares"]()))
    assert document["noise"] == []
    assert document["chi_squared"] is None


def test_the_poses_left_out_are_listed() -> None:
    data = MADE.dataset.thin(2).exclude(["1", "5"])
    document = plain(fit_document(calibrate(planar_two_link(), data, noise=NOISE)))
    told = document["data"]
    assert told["used"] == len(data) == 30
    assert told["poses"] == 64
    assert told["excluded"] == ["1", "5"]
    assert told["every"] == 2


def rows_of(result: FitResult) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(residuals_csv(result).decode())))


def test_residuals_hold_readings_corrections_and_loops() -> None:
    result = RESULTS["implicit loop"]()
    rows = rows_of(result)
    assert [row["pose"] for row in rows] == list(MADE.dataset.poses)
    for i, row in enumerate(rows):
        assert float(row["phi2 [rad]"]) == MADE.dataset["phi2"][i]
        correction = float(row["phi2 correction [rad]"])
        assert correction == result.corrections["phi2"][i]
        assert float(row["phi2 correction/sd"]) == pytest.approx(correction / 1e-3, rel=1e-12)
        assert float(row["residual xP before [m]"]) == result.residuals_before["xP"][i]
        assert abs(float(row["residual xP after [m]"])) < 1e-14


def test_what_was_not_measured_or_is_exact_is_empty() -> None:
    rows = rows_of(with_gaps())
    assert rows[3]["xP [m]"] == rows[3]["xP correction [m]"] == rows[3]["xP correction/sd"] == ""
    assert rows[4]["xP [m]"] != ""
    assert rows[4]["yP correction [m]"] == "0.0"
    assert rows[4]["yP correction/sd"] == ""


def test_the_three_files_are_written_and_the_mechanism_reads_back(tmp_path: Path) -> None:
    result = RESULTS["implicit loop"]()
    written = write_result(result, tmp_path / "a" / "b")
    assert sorted(written.files) == sorted(path.name for path in written.folder.iterdir())
    again = read_mechanism(written.folder / "mechanism.toml")
    assert {p.name: p.nominal for p in again.parameters} == dict(result.value)


def test_a_file_of_an_earlier_version_is_read_and_predicts(tmp_path: Path) -> None:
    result = RESULTS["implicit loop"]()
    whole = Result.of(result).document
    stored = plain(whole)
    for key in ("mechanism", "method_label"):
        del stored[key]
    for entry in stored["noise"]:
        del entry["share"]
    del stored["accuracy"]["orientation"], stored["accuracy"]["by"], stored["prediction"]["by"]
    for when in ("before", "after"):
        del stored["accuracy"][when]["poses"]
    (tmp_path / "result.json").write_text(json.dumps(stored), "utf-8")
    read = read_result(tmp_path / "result.json")
    found = predict(predictor_of(read, result.calibrated), POSES)
    now = predict(result, POSES)
    assert np.array_equal(found.ratio, now.ratio)
    assert str(read).splitlines()[2:] == str(whole).splitlines()[2:]


def document_with(**changes: Any) -> dict[str, Any]:
    return {**plain(fit_document(RESULTS["implicit loop"]())), **changes}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "empty"),
        ("{", "line 1"),
        ("[]", "schema"),
        ('{"schema": 4}', "schema is 4"),
        ('{"schema": true}', "schema is True"),
        ('{"schema": 1}', "is missing"),
        ('{"schema": 1, "closure": NaN}', "NaN"),
        (json.dumps(document_with(methd="x")), "did you mean 'method'"),
        (json.dumps(document_with(method=3)), "method"),
        (json.dumps(document_with(status={"converged": "yes"})), "status"),
        (json.dumps(document_with(title="\\ud800")).replace("\\\\", "\\"), "not valid JSON"),
        (json.dumps(document_with(model_discrepancy="0.1")), "model_discrepancy: '0.1' is given"),
        (json.dumps(document_with(model_discrepancy=-1.0)), "model_discrepancy: -1.0 is given"),
        (json.dumps(document_with(closure=[])), "closure: [] is given, where a table is needed"),
        (json.dumps(document_with(parameters=[{}])), "parameters[1]: 'name' is missing"),
        ("[" * 100_000, "JSON"),
        (b"\xff\xfe\x00", "JSON"),
    ],
)
def test_what_is_no_result_is_told(content: str | bytes, told: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as caught:
        read_result(path)
    assert told in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("path", "kept"),
    [
        (("covariance", "matrix"), 1),
        (("covariance", "matrix", 0), 1),
        (("covariance", "scatter"), 1),
        (("prediction", "covariance", 0), 1),
        (("prediction", "undetermined", 0), 1),
    ],
    ids=lambda value: ".".join(map(str, value)) if isinstance(value, tuple) else str(value),
)
def test_a_matrix_that_does_not_fit_its_names_is_told(
    path: tuple[str | int, ...], kept: int, tmp_path: Path
) -> None:
    names = ("a", "b", "c")
    square, steps = ((1.0, 0.0, 0.0),) * 3, ((1.0, 1.0, 1.0),)
    result = RESULTS["implicit loop"]()
    document = Result.of(result).document
    assert document.prediction is not None
    covariance = replace(document.covariance, names=names, matrix=square, scatter=square)
    ahead = replace(document.prediction, covariance=square, undetermined=steps)
    content = plain(replace(document, covariance=covariance, prediction=ahead))
    file = tmp_path / "result.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    assert read_result(file).covariance.names == names
    *outer, last = path
    holder: Any = content
    for key in outer:
        holder = holder[key]
    holder[last] = holder[last][:kept]
    file.write_text(json.dumps(content), encoding="utf-8")
    with refused("wrong-shape", ".".join(map(str, path[:2]))):
        read_result(file)


def test_a_missing_result_is_told(tmp_path: Path) -> None:
    with refused("missing-file"):
        read_result(tmp_path / "result.json")


def test_the_truth_reads_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text(truth_json(MADE, planar_two_link(), {}))
    assert dict(read_truth(path, planar_two_link())) == dict(MADE.parameters)
    stated = json.loads(path.read_text())
    assert stated["seed"] == 4
    np.testing.assert_array_equal(stated["quantities"]["xP"]["values"], MADE.quantities["xP"])


def test_infinite_inputs_become_text() -> None:
    assert finite_only({"a": [math.inf, -math.inf, 1.0]}) == {"a": ["inf", "-inf", 1.0]}


@pytest.mark.parametrize("rows", [50, LARGE])
@pytest.mark.parametrize("ending", [".csv", ".tsv"])
def test_tables_hold_the_same_bits(rows: int, ending: str) -> None:
    values = np.random.default_rng(1).standard_normal(rows) * 10.0 ** np.arange(rows).clip(0, 300)
    values[7] = np.nan
    values[8] = -0.0
    names = tuple(f"p,{i}" for i in range(rows))
    text = table_bytes({"pose": names, "x [m]": values}, ending).decode()
    read = list(csv.reader(io.StringIO(text), delimiter="," if ending == ".csv" else "\t"))
    assert read[0] == ["pose", "x [m]"]
    assert [row[0] for row in read[1:]] == list(names)
    assert read[8][1] == ""
    back = np.array([float(row[1] or "nan") for row in read[1:]])
    np.testing.assert_array_equal(back, values)


def test_errors_of_the_parameters_are_kept() -> None:
    result = Result.of(RESULTS["implicit loop"](), errors={"l2": 1e-5})
    by_name = {p["name"]: p["error"] for p in plain(result.document)["parameters"]}
    assert by_name["l2"] == 1e-5
    assert by_name["l3"] is None
    lines = str(result).splitlines()
    assert "error" in next(line for line in lines if line.startswith("parameter"))
    assert "(error: true minus estimate)" in lines
