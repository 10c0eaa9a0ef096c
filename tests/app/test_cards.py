"""What a page says first is the one judgement; what stands beside the errors follows by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.app.beside import left_out, without_changes, without_poses
from loopcal.companions.app.cards import begins, cards, lines
from loopcal.companions.app.edits import with_shift, with_value
from loopcal.companions.app.pictures import ABOVE, Errors
from loopcal.companions.app.session import Session
from loopcal.companions.app.view import View
from loopcal.companions.app.views.diagnose import errors_of
from loopcal.document.catalogue import findings
from loopcal.document.change_points import Change, ChangePoint, ChangePoints
from loopcal.document.verdict import Verdict, Where, fact
from loopcal.report.source import Source
from tests.app.plain_command import command

MOVED = 2e-3
FROM = 20


@pytest.fixture(scope="module")
def session(hostile: Path) -> Session:
    return Session(hostile, command)


@pytest.fixture(scope="module")
def source(session: Session) -> Source:
    source = session.source()
    assert source is not None
    return source


def slipped(source: Source, *, modelled: bool) -> Source:
    """The source with a finding on one step."""
    change = {"xA": Change(MOVED, 1e-5, "m")}
    pose, after = source.table.poses[FROM - 1], source.table.poses[FROM - 2]
    point = ChangePoint("step", pose, after, FROM, "target", change, 50.0, 1e-9, modelled=modelled)
    code = "changes-modelled" if modelled else "change-points"
    said = Where(poses=(pose,))
    along = fact(code, said, subject="what changed", what="", details="d.", hold="h.")
    odd = fact("outliers", Where(poses=("7",)), count="1 pose does", named="7")
    found = findings([odd, along])
    document = replace(
        source.document,
        findings=found,
        verdict=Verdict.of(found),
        change_points=ChangePoints((point,), 0.01, 49, "[[mechanism.effect]]"),
    )
    return replace(source, document=document)


@pytest.mark.parametrize("modelled", [False, True])
def test_cards_and_lines_are_the_findings_word_for_word(source: Source, modelled: bool) -> None:
    document = slipped(source, modelled=modelled).document
    made = cards(document)
    assert [card.finding for card in made] == list(document.findings)
    for card in made:
        assert f"{card.title} {card.details}".strip() == card.finding.words
    by_code = {card.finding.code: card for card in made}
    assert by_code["outliers"].poses == ("7",)
    change = by_code["changes-modelled" if modelled else "change-points"]
    assert change.changes is not None
    assert change.absorbed is modelled
    sound, *others = lines(document)
    assert document.verdict is not None
    assert made[0].title.rstrip(".").lower() in document.verdict.headline.lower()
    assert sound.words == made[0].details  # the headline above it says the title
    assert [line.mark for line in others] == [""] * 3  # no finding answers them


def test_a_line_has_the_number_that_decides(source: Source) -> None:
    verdict = source.document.verdict
    assert verdict is not None
    for line in lines(source.document):
        answer = verdict.answers[line.question]
        if answer.asked and answer.number is not None and answer.code != "sound":
            assert any(letter.isdigit() for letter in line.words), line


def test_what_is_taken_up_as_moved_stands_in_the_errors_before_it(
    session: Session, source: Source
) -> None:
    """xP = xA + ...: without the shift of xA from pose 20 on, xP is smaller by it from there on."""
    text = session.folder.text() or ""
    counted = with_value(text, ["data", "columns", "pose"], {"column": 0, "unit": "1"})
    mechanism = session.read(with_shift(counted, ["xA"], [float(FROM)], "pose")).mechanism
    assert source.mechanism is not None
    values = {p.name: p.nominal for p in source.mechanism.parameters}
    numbers = np.arange(1.0, len(source.table.poses) + 1.0)
    table = replace(source.table, pose_constants={"pose": numbers})
    moved = replace(
        source, mechanism=mechanism.with_nominal({**values, f"xA_from{FROM}": MOVED}), table=table
    )
    before = without_changes(moved)
    assert before is not None
    np.testing.assert_allclose(before["xP"], table.differences_after["xP"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(before["yP"], table.differences_after["yP"], rtol=0, atol=1e-12)
    same = replace(moved, mechanism=mechanism.with_nominal(values))
    after = without_changes(same)
    assert after is not None
    np.testing.assert_array_equal(after["xP"], before["xP"])
    assert without_changes(source) is None


def test_a_pose_left_out_has_the_error_that_it_would_have(session: Session, source: Source) -> None:
    data = session.every_pose()
    assert data is not None
    assert left_out(source, data) is None
    table = source.table
    short = without_poses(source, (data.poses[3], data.poses[10]))
    assert len(short.table.poses) == len(table.poses) - 2
    aside = left_out(short, data)
    assert aside is not None
    assert aside.poses == (data.poses[3], data.poses[10])
    assert aside.numbers.tolist() == [3.5, 9.5]  # between the neighbours that are used
    for name, values in table.differences_after.items():
        np.testing.assert_allclose(aside.differences[name], values[[3, 10]], atol=1e-12)
    far = replace(aside, sizes=aside.sizes + 1.0)
    drawn = Errors.of(short, left_out=far)
    assert drawn is not None
    grey = drawn.over_poses()["data"][-1]
    assert len(grey["x"]) == 2
    assert max(grey["y"]) <= ABOVE * drawn.size.max()  # at the edge, beside its arrow
    assert grey["marker"]["symbol"] == ["triangle-up"] * 2
    assert "customdata" not in grey  # no brush selects it


def test_poses_left_out_are_grey_ahead_of_a_fit_without_them(
    session: Session, source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses = source.table.poses
    monkeypatch.setattr(session, "left_out", lambda: poses[3:5])
    view = View(session, selected=[2, 3, 7], poses=poses)
    errors = errors_of(view)
    assert errors is not None
    assert errors.left_out is not None
    assert errors.left_out.poses == poses[3:5]
    assert [errors.source.table.poses[i] for i in view.selected] == [poses[2], poses[7]]
    monkeypatch.setattr(session, "left_out", lambda: poses)
    assert errors_of(view) is not None  # by hand: the project says why it cannot be fitted


def test_a_step_is_drawn_as_the_level_on_either_side(source: Source) -> None:
    marked = slipped(source, modelled=False)
    points = marked.document.change_points
    assert points is not None
    starts = begins(points.found, source.table.poses)
    assert list(starts) == [float(FROM)]  # ids are no numbers: the position counts
    errors = Errors.of(marked, changed=dict.fromkeys(starts, "here"))
    assert errors is not None
    figure = errors.over_poses("xP")
    level = figure["data"][1]
    values = errors.shown["xP"]
    assert level["y"][0] == np.median(values[: FROM - 1])
    assert level["y"][3] == np.median(values[FROM - 1 :])
    assert [shape["x0"] for shape in figure["layout"]["shapes"]] == [FROM - 0.5]
    assert figure["layout"]["annotations"][0]["text"] == "here"
