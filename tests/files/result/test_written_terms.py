"""A result with a structured model error: written, read again, shown, compared."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

import loopcal as lc
from loopcal.document.plain import symmetric
from loopcal.files.result.result_file import result_json, write_result
from loopcal.report.page import parameter_groups
from loopcal.report.source import source_of
from loopcal.report.tables import term_table
from loopcal.statistics.predictor import predictor_of

NOISE = lc.Noise({"theta_*": 0.0, "xyz": 2e-5})
ANGLES = {f"theta_{i}": (-1.2, 1.2) for i in range(1, 7)}
TRUTH = {"x1": 0.1512, "z2": 0.6135, "phix1": 5e-4}


@cache
def arm(seed: int) -> lc.Result:
    machine = lc.motoman_ma1400()
    machine = machine.with_parameters(machine.parameters.with_prior({"?6B": 5e-3}))
    at = lc.random_poses(ANGLES, 50, seed=seed)
    data = lc.simulate(machine, at, noise=NOISE, seed=seed, truth=TRUTH).dataset
    return lc.calibrate(machine, data, method="least-squares", model_error="structured")


def test_a_written_result_predicts_what_the_one_in_memory_does(tmp_path: Path) -> None:
    result, new = arm(3), lc.random_poses(ANGLES, 5, seed=9)
    write_result(result, lc.Result.of(result).document, tmp_path)
    read = lc.read_result(tmp_path)
    found = lc.predict(predictor_of(read.document, read.mechanism), new)
    now = lc.predict(result, new)
    for name in now.outputs:
        np.testing.assert_allclose(found.outputs[name], now.outputs[name], atol=1e-12)
        np.testing.assert_allclose(found.sd[name], now.sd[name], rtol=1e-9)
    np.testing.assert_allclose(found.denominator, now.denominator, rtol=0.02)
    assert read.document.terms == lc.Result.of(result).document.terms


def test_symmetric_matrices_are_triangles_and_whole_rows_are_read_alike(tmp_path: Path) -> None:
    result, new = arm(3), lc.random_poses(ANGLES, 5, seed=9)
    write_result(result, lc.Result.of(result).document, tmp_path)
    file = tmp_path / "result.json"
    content = json.loads(file.read_text("utf-8"))
    covariance, n = content["covariance"], len(result.estimated)
    assert [len(row) for row in covariance["matrix"]] == [n] * n
    assert [len(row) for row in covariance["plain"]] == [*range(1, n + 1)]
    assert max(map(len, file.read_text("utf-8").splitlines())) > 20 * n
    short = lc.read_result(tmp_path)
    for rows in (covariance["plain"], *covariance["slopes"]):
        rows[:] = symmetric(rows).tolist()
    file.write_text(json.dumps(content, indent=1), "utf-8")
    whole = lc.read_result(tmp_path)
    assert file.stat().st_size > 1.8 * len(result_json(short.document))
    found = [lc.predict(predictor_of(r.document, r.mechanism), new) for r in (short, whole)]
    np.testing.assert_array_equal(found[0].covariance, found[1].covariance)
    np.testing.assert_array_equal(found[0].denominator, found[1].denominator)


def test_summary_and_report_show_each_term_and_not_its_columns() -> None:
    result = arm(3)
    text = str(result)
    lengths = next(term for term in result.terms if term.name == "lengths")
    assert lengths.words in text
    assert not lengths.effects
    hidden = [name for term in result.terms for name in term.effects]
    assert "base_sag_x_wrist" in hidden
    lines = {line.split(" ")[0] for line in text.splitlines()}
    assert lines.isdisjoint(hidden)
    assert lines > {"x1", "z2", "lengths", "sag"}
    table = term_table(result.document)
    assert table is not None
    assert [row[0] for row in table.rows] == [term.name for term in result.terms]
    groups = parameter_groups(source_of(result, result.document, "arm")).groups
    assert {line.cells[0] for group in groups for line in group.lines}.isdisjoint(hidden)
    assert f"{len(hidden)} parameters of the model error" in text


def test_profiles_and_comparisons_take_terms() -> None:
    """Two calibrations of one machine agree; the profile of a length is its interval by t."""
    comparison = lc.compare(arm(3), arm(4))
    assert comparison.p_value is not None
    assert comparison.p_value > 0.01
    interval = lc.intervals(arm(3), ["z2"])["z2"]
    assert interval is not None
    assert interval.low < TRUTH["z2"] < interval.high
    assert interval.profile_low is not None
    assert interval.profile_high is not None
    width = interval.high - interval.low
    assert abs(interval.profile_high - interval.profile_low - width) < 0.1 * width
