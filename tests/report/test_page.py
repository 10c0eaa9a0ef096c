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
from loopcal.mechanisms.parameters import Role
from loopcal.report.page import MOST, parameter_groups, report_html
from loopcal.report.source import read_source
from loopcal.report.tables import (
    accuracy_tables,
    comparison_table,
    facts_table,
    outlier_table,
    reliability_table,
    sensor_table,
    worst_table,
)
from loopcal.report.top import accuracy_bars, region_bars
from loopcal.statistics.verdict import judged
from tests.golden_files import page_text
from tests.refusals import refused


def document_of(folder: Path) -> ResultDocument:
    return read_result(folder / "result.json")


def changed(value: Any, path: str, new: Any) -> Any:
    """The same document with something else at a path of fields."""
    name, _, rest = path.partition(".")
    return replace(value, **{name: changed(getattr(value, name), rest, new) if rest else new})


def outlier(pose: str) -> Outlier:
    return Outlier(pose, None, 60.0, 1e-12, 60.0, None, None)


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
    assert f'<strong title="{verdict.headline}">{verdict.headline}</strong>' in page
    findings = document_of(planar).findings
    assert {one.question for one in findings} == {q for q, a in verdict.answers.items() if a.asked}
    for one in findings:
        assert one.words in page
        assert f"<code>{one.code}</code>" in page
    assert verdict.tolerance.words in page


def test_parameters_stand_with_change_and_share_of_the_prior(planar: Path) -> None:
    source = read_source(planar)
    document = source.document
    entry = document.parameters[2]
    assert entry.sd is not None
    other = replace(document.parameters[3], fixed=True, sd=None)
    known = replace(entry, prior_sd=2.0 * entry.sd)
    parameters = (*document.parameters[:2], known, other, *document.parameters[4:])
    given = replace(source, document=replace(document, parameters=parameters))
    groups = parameter_groups(given).groups
    rows = {line.cells[0]: line.cells for group in groups for line in group.lines}
    row = rows[entry.name]
    assert row[-1] == "25 %"
    assert float(row[-2]) == pytest.approx((entry.value - entry.nominal) / entry.sd, abs=0.05)
    assert "fixed" in rows[other.name]


def test_parameters_of_cameras_and_boards_are_named_so(planar: Path) -> None:
    source = read_source(planar)
    roles: list[tuple[str, Role]] = [
        ("eye", "placement"),
        ("eye", "lens"),
        ("board", "mounting"),
        ("board", "print"),
    ]
    first = source.document.parameters[: len(roles) + 1]
    parameters = [replace(p, role=r, owner=o) for p, (o, r) in zip(first, roles, strict=False)]
    document = replace(source.document, parameters=(*parameters, replace(first[4], owner="q1")))
    made = parameter_groups(replace(source, document=document))
    assert [(g.name, len(g.lines)) for g in made.groups] == [
        ("camera eye", 2),
        ("board", 2),
        ("q1", 1),
    ]
    assert "cameras" in made.by
    assert parameter_groups(source).by == "joint"


def test_findings_stand_apart_each_with_its_code_and_remedy(planar: Path) -> None:
    source = read_source(planar)
    document = changed(source.document, "status.converged", False)
    document = judged(replace(document, outliers=(outlier("7"),)))
    page = report_html([replace(source, document=document)])
    for code in ("not-converged", "outliers"):
        assert re.search(rf"<li class=.*<code>{code}</code>", page), code


def test_record_and_tolerance_of_the_project_stand_at_the_top(planar: Path) -> None:
    source = read_source(planar)
    stated = {
        "record": {"date": "2026-11-02", "operator": "A. Smith", "serial": "MA-7"},
        "verdict": {"tolerance": {"value": 0.3, "unit": "mm"}},
    }
    document = replace(source.document, inputs={**source.document.inputs, **stated})
    assert document.accuracy is not None
    text = page_text(report_html([replace(source, document=document)])).split("How good")
    assert "A. Smith" in text[0]
    assert "MA-7" in text[0]
    bars = {bar.label: bar for bar in accuracy_bars(document)}
    assert bars["tolerance"].words == "0.300 mm"
    assert bars["calibrated"].share / bars["tolerance"].share == pytest.approx(
        document.accuracy.after.rms / 0.3e-3
    )
    assert max(bar.share for bar in bars.values()) == pytest.approx(100.0)


def test_the_region_is_drawn_beside_what_was_measured(planar: Path) -> None:
    for bar in region_bars(read_source(planar)):
        assert 0.0 <= bar.begin < bar.begin + bar.share <= 100.0
        assert "measured" in bar.words


def test_the_worst_poses_come_first_with_their_causes(planar: Path) -> None:
    source = read_source(planar)
    after = np.linalg.norm(list(source.table.differences_after.values()), axis=0)
    worst = source.table.poses[int(np.argmax(after))]
    document = replace(source.document, outliers=(outlier(worst),))
    table = worst_table(replace(source, document=document), after, after)
    assert table is not None
    assert table.rows[0][0] == worst
    assert table.rows[0][-1] == "does not fit the others"
    errors = [float(row[2]) for row in table.rows]
    assert errors == sorted(errors, reverse=True)


def test_parameters_are_grouped_by_joint_and_say_what_they_mean(six_axis: Path) -> None:
    groups = {g.name: g.lines for g in parameter_groups(read_source(six_axis)).groups}
    assert list(groups)[:2] == ["base", "theta_1"]
    assert [line.cells[0] for line in groups["tool"]] == ["tool_x", "tool_y", "tool_z"]
    meanings = {line.cells[0]: line.meaning for lines in groups.values() for line in lines}
    assert meanings["offset_2"] == "zero of theta_2: added to its reading"
    assert meanings["alpha_4"] == "turn about the x axis after theta_4"
    assert all(meanings.values())
    for lines in groups.values():
        for line in lines:
            assert 0.0 <= line.left <= line.left + line.width <= 100.0
            assert 0.0 <= line.low <= line.high <= 100.0


def test_no_number_is_a_negative_zero(planar: Path, six_axis: Path) -> None:
    for folder in (planar, six_axis):
        page = (folder / "report.html").read_text("utf-8")
        text = page_text(re.sub(r"pytest-\d+", "", page))  # commands name the result's folder
        assert not re.search(r"-0(?:\.0+)?(?![\d.])", text)


def test_the_page_is_hardly_larger_than_the_program_that_draws(six_axis: Path) -> None:
    from loopcal.figures.figure import plotly_javascript

    page = (six_axis / "report.html").read_text("utf-8")
    assert len(page) - len(plotly_javascript()) < 250_000


def test_every_row_of_every_table_has_a_cell_for_each_heading(planar: Path) -> None:
    source = read_source(planar)
    d = source.document
    made = [*accuracy_tables(d), sensor_table(source), outlier_table(d), reliability_table(d)]
    found = [table for table in (*made, facts_table(d)) if table is not None]
    assert len(found) >= 4
    for table in found:
        assert {len(row) for row in table.rows} == {len(table.head)}, table.caption
