"""The page as text: numbers of result.json, verdicts with reasons, everything inside, thinning."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loopcal.document.findings import Outlier
from loopcal.document.result_document import ResultDocument
from loopcal.files.result.pose_table import PoseTable
from loopcal.files.result.result_file import read_result
from loopcal.report.page import MOST, report_html
from loopcal.report.source import read_source
from loopcal.report.tables import accuracy_tables, comparison_table, parameter_table
from tests.golden_files import page_text
from tests.refusals import refused


def document_of(folder: Path) -> ResultDocument:
    return read_result(folder / "result.json")


def changed(value: Any, path: str, new: Any) -> Any:
    """The same document with something else at a path of fields."""
    name, _, rest = path.partition(".")
    return replace(value, **{name: changed(getattr(value, name), rest, new) if rest else new})


def outlier(pose: str) -> Outlier:
    return Outlier(pose, None, 30.0, 1e-6, 30.0, None, None)


def test_a_page_made_again_from_the_files_is_the_same(planar: Path, six_axis: Path) -> None:
    for folder in (planar, six_axis):
        again = report_html([read_source(folder)])
        assert again == (folder / "report.html").read_text("utf-8")
        assert report_html([read_source(folder / "result.json")]) == again


def test_its_accuracy_is_that_of_the_columns_and_of_result_json(planar: Path) -> None:
    source = read_source(planar)
    for when in ("before", "after"):
        differences = getattr(source.table, f"differences_{when}")
        lengths = np.linalg.norm(list(differences.values()), axis=0)
        told = getattr(source.document.accuracy, when)
        assert told.rms == pytest.approx(np.sqrt(np.mean(lengths**2)), rel=1e-12)
        assert told.max == pytest.approx(lengths.max(), rel=1e-12)
    (table,) = accuracy_tables(source.document)
    assert [row[0] for row in table.rows] == [
        "nominal",
        "nominal, best placed",
        "calibrated",
        "on poses not used",
        "in regions not used",
        "noise floor",
    ]
    validated = source.document.validation
    assert validated is not None
    assert validated.accuracy is not None
    assert float(table.rows[3][2]) == pytest.approx(1e3 * validated.accuracy.rms, rel=1e-3)


def test_it_holds_everything_and_is_small(six_axis: Path) -> None:
    page = (six_axis / "report.html").read_bytes()
    assert len(page) < 7_000_000
    head = page.decode().split("<script>")[0] + page.decode().rsplit("</script>", 1)[1]
    assert not re.search(r"(?:src|href)\s*=\s*[\"']?(?:https?:)?//", head)
    assert "default-src 'none'" in head


def test_a_hundred_thousand_poses_are_thinned_in_the_figures_only(planar: Path) -> None:
    source = read_source(planar)
    times = 1000
    parts = {field.name: getattr(source.table, field.name) for field in fields(PoseTable)}
    ids = tuple(str(i) for i in range(times * len(parts.pop("poses"))))
    longer = {
        name: {key: np.tile(values, times) for key, values in part.items()}
        for name, part in parts.items()
    }
    page = report_html([replace(source, table=PoseTable(ids, **longer))])
    assert len(page.encode()) < 7_000_000
    text = page_text(page)
    assert "of 100,000 poses" in text
    # the corrections' rms is that of all poses, which are copies of the first hundred
    assert re.findall(r"xP, yP \|.*", text) == re.findall(
        r"xP, yP \|.*", page_text((planar / "report.html").read_text("utf-8"))
    )


def test_results_of_one_name_are_told_apart(planar: Path) -> None:
    source = read_source(planar)
    text = page_text(report_html([source, source]))
    assert "1: planar" in text
    assert "2: planar" in text
    table = comparison_table([source, source])
    assert all(len(row) == 3 and row[1] == row[2] for row in table.rows)


def test_there_is_an_end_to_side_by_side(planar: Path) -> None:
    with refused("invalid-usage", "9 results"):
        report_html([read_source(planar)] * (MOST + 1))


def test_a_folder_without_a_result_is_told(tmp_path: Path) -> None:
    with refused("missing-file"):
        read_source(tmp_path)


def test_the_page_shows_the_four_answers(planar: Path) -> None:
    page = report_html([read_source(planar)])
    verdict = document_of(planar).verdict
    assert verdict is not None
    assert f"<strong>{verdict.headline}</strong>" in page
    for answer in verdict.answers.values():
        assert answer.words in page
        assert f"<code>{answer.code}</code>" in page


def test_parameters_stand_with_change_and_share_of_the_prior(planar: Path) -> None:
    document = document_of(planar)
    entry = document.parameters[2]
    assert entry.sd is not None
    other = replace(document.parameters[3], fixed=True, sd=None)
    known = replace(entry, prior_sd=2.0 * entry.sd)
    parameters = (*document.parameters[:2], known, other, *document.parameters[4:])
    rows = {row[0]: row for row in parameter_table(replace(document, parameters=parameters)).rows}
    row = rows[entry.name]
    assert row[-1] == "25%"
    assert float(row[-2]) == pytest.approx((entry.value - entry.nominal) / entry.sd, abs=0.05)
    assert "fixed" in rows[other.name]
