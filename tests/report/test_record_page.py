"""The calibration record: all that it must hold, empty fields said, page and files sealed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.record.budget import Budget, LengthErrors, budgets
from loopcal.companions.record.content import (
    FIELDS,
    OPTIONAL,
    OTHERS,
    PEOPLE,
    RULE,
    UNSTATED,
    record_content,
)
from loopcal.companions.record.page import record_page
from loopcal.companions.record.record_file import OPEN, RecordFile, check_record
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer
from loopcal.files.project.project_schema import RecordTable
from loopcal.files.result.result_file import read_result
from loopcal.keys import arguments
from loopcal.measurements.days import Days
from loopcal.small_samples import t_quantile
from tests.browser import chromium
from tests.refusals import refused

KEYS = (*(key for fields in FIELDS.values() for key in fields), *PEOPLE, *OTHERS)
STATED = {key: f"the {key} <b>&amp;" for key in KEYS}
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def folder(planar: Path, tmp_path: Path) -> Path:
    """A copy of a result with its project and readings where a user has them."""
    shutil.copytree(EXAMPLES / "planar", tmp_path / "planar")
    shutil.copytree(planar, tmp_path / "planar" / "result")
    return tmp_path / "planar" / "result"


def page_of(document: ResultDocument, stated: Mapping[str, str], *files: RecordFile) -> str:
    return record_page(record_content(document, stated, files))


def text_of(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page.split("<body")[1]))


def test_every_key_of_the_project_is_printed(planar: Path) -> None:
    assert set(KEYS) == {argument.name for argument in arguments(RecordTable)}
    made = record_content(read_result(planar / "result.json"), STATED, ())
    page = record_page(made)
    for key in KEYS:
        assert f"the {key} &lt;b&gt;&amp;amp;" in page
    assert made.missing == ()
    assert made.number == STATED["number"]


def test_what_is_empty_is_not_stated(planar: Path) -> None:
    made = record_content(read_result(planar / "result.json"), {"customer": "  "}, ())
    assert set(made.missing) == set(KEYS) - set(OPTIONAL)
    assert record_page(made).count(f">{UNSTATED}<") == len(made.missing)


def test_it_is_a_certificate_only_with_an_accreditation(planar: Path) -> None:
    document = read_result(planar / "result.json")
    plain, accredited = (
        record_content(document, stated, ()) for stated in ({}, {"accreditation": "K-12345"})
    )
    assert plain.title == "Calibration record"
    assert "ertificate" not in text_of(record_page(plain))
    assert accredited.title == "Calibration certificate"


def test_results_before_and_after_have_expanded_uncertainties(planar: Path) -> None:
    document = read_result(planar / "result.json")
    text = text_of(page_of(document, {}))
    for words in ("before: nominal", "after: calibrated", "on poses not used", "its 95 % interval"):
        assert words in text
    entry = next(p for p in document.parameters if p.sd is not None and p.unit == "m")
    freedom = entry.degrees_of_freedom
    k = t_quantile(0.954499736, float("inf") if freedom is None else freedom)
    assert re.search(rf"{entry.name} mm \S+ \S+ {1e3 * k * (entry.sd or 0.0):.2g}\S* {k:.2f}", text)
    few = replace(entry, degrees_of_freedom=4.0)
    learnt = replace(document, parameters=(few,), terms=())
    assert f"{t_quantile(0.9545, 4.0):.2f}" in text_of(page_of(learnt, {}))


def test_conformity_is_stated_with_its_rule_or_not_at_all(planar: Path) -> None:
    document = read_result(planar / "result.json")
    assert document.verdict is not None
    assert RULE not in page_of(document, {})
    for passed, word in ((True, "Pass."), (False, "Fail."), (None, "No decision.")):
        answer = Answer(passed, "near-tolerance", 1.0, "The guard band.", None)
        judged = replace(document, verdict=replace(document.verdict, tolerance=answer))
        page = page_of(judged, {})
        assert f"<strong>{word}</strong> The guard band." in page
        assert RULE in page
    assert "relate only to the item calibrated" in page


def test_an_unaltered_record_is_recognised(folder: Path) -> None:
    made = lc.record(folder, project=folder.parent / "project.toml")
    roles = [file.role for file in made.files]
    assert roles[:4] == ["result", "calibrated machine", "residuals of every pose", "project"]
    assert "readings" in roles
    found = lc.verify_record(made.path)
    assert found.unaltered
    assert set(found.files.values()) == {"unaltered"}
    assert isinstance(made, lc.Record)
    assert isinstance(found, lc.RecordCheck)


@pytest.mark.parametrize("name", ["result.json", "residuals.csv", "mechanism.toml"])
def test_an_altered_or_lost_file_is_named(folder: Path, name: str) -> None:
    made = lc.record(folder)
    with (folder / name).open("a", encoding="utf-8") as file:
        file.write(" ")
    found = lc.verify_record(made.path)
    assert found.page
    assert [n for n, state in found.files.items() if state == "altered"] == [name]
    (folder / name).unlink()
    assert lc.verify_record(made.path).files[name] == "not found"


def test_every_altered_character_of_the_page_is_noticed(folder: Path) -> None:
    made = lc.record(folder)
    page = made.path.read_bytes()
    for at in range(600, len(page), len(page) // 40):
        if chr(page[at]).isalnum() and not page[at - 70 : at + 70].count(b"loopcal-record"):
            made.path.write_bytes(page[:at] + b"~" + page[at + 1 :])
            with suppress(lc.InputError):  # the list of files is damaged
                assert not check_record(made.path).page
    made.path.write_bytes(page)
    assert check_record(made.path).page


def test_changed_readings_are_refused(folder: Path) -> None:
    files = [f.name for f in lc.record(folder).files if f.role == "readings"]
    with (folder.parent / files[0]).open("a", encoding="utf-8") as file:
        file.write("\n")
    with refused("version-mismatch", files[0]):
        lc.record(folder)


def test_readings_elsewhere_are_recorded_by_their_hash(planar: Path, tmp_path: Path) -> None:
    shutil.copytree(planar, tmp_path / "alone" / "result")
    made = lc.record(tmp_path / "alone" / "result")
    assert [f.path for f in made.files if f.role == "readings"] == [None]
    found = lc.verify_record(made.path)
    assert found.unaltered
    assert "not recorded" in found.files.values()


def test_the_number_follows_from_the_content(planar: Path) -> None:
    document = read_result(planar / "result.json")
    one, same, other = (
        record_content(document, {"customer": name}, ()).number for name in ("A", "A", "B")
    )
    assert one == same != other


def test_markup_in_names_is_shown_as_text(hostile: Path) -> None:
    from tests.report.conftest import MARKUP, SCRIPT

    file = RecordFile(MARKUP, SCRIPT, SCRIPT, OPEN)
    page = page_of(read_result(hostile / "result.json"), {"note": SCRIPT}, file)
    assert "<img/src" not in page
    assert page.count("</script>") == 1


@pytest.mark.parametrize(
    "without", [{"accuracy": None, "validation": None}, {"verdict": None}, {"parameters": ()}]
)
def test_what_a_result_does_not_have_is_left_out(planar: Path, without: dict[str, None]) -> None:
    document = replace(read_result(planar / "result.json"), **without)  # type: ignore[arg-type]
    assert "relate only to the item" in page_of(document, {})


def test_another_page_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("<html></html>", "utf-8")
    with refused("wrong-file-type", "page.html"):
        lc.verify_record(tmp_path / "page.html")


def test_it_prints_on_paper_without_any_network(planar: Path, tmp_path: Path) -> None:
    made = page_of(read_result(planar / "result.json"), STATED)
    (tmp_path / "record.html").write_text(made, "utf-8")
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 672, "height": 950})
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.emulate_media(media="print")
        page.goto((tmp_path / "record.html").as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 672
        assert len(page.pdf(prefer_css_page_size=True)) > 10_000
    assert len(asked) == 1


def test_dates_that_do_not_agree_are_cautions(planar: Path) -> None:
    document = read_result(planar / "result.json")

    def cautions(**stated: str) -> tuple[str, ...]:
        return record_content(document, stated, ()).cautions

    assert cautions(date="2026-11-02", instrument_calibrated="2026-03-01") == ()
    (after,) = cautions(date="2026-11-02", traceability="certificate 4711 of 2026-12-01")
    assert "2026-12-01, after the measurement of 2026-11-02" in after
    due = {"date": "2026-11-02 to 2026-11-04", "instrument_due": "2026-11-03"}
    (expired,) = cautions(**due)
    assert "expired on 2026-11-03, before the measurement of 2026-11-02 to 2026-11-04" in expired
    # of two days in a text it is not known which is that of the certificate
    assert cautions(date="2026-11-02", traceability="2026-12-01, see 2026-12-02") == ()
    (unknown,) = cautions(instrument_due="2026-11-03")
    assert "not stated" in unknown
    (written,) = cautions(date="2 Nov 2026")
    assert "which is no day" in written
    assert len(cautions(date="2026-11-02", issued="2026-11-01", received="2026-11-03")) == 2
    read = replace(document, data=replace(document.data, measured=Days("2026-11-05", "2026-11-05")))
    (other,) = record_content(read, {"date": "2026-11-02"}, ()).cautions
    assert "dated 2026-11-05" in other
    assert "Caution." in record_page(record_content(read, {"date": "2026-11-02"}, ()))


def _budget(folder: Path, lengths: LengthErrors) -> Budget:
    (made,) = budgets(lc.read_result(folder), lengths)
    return made


def test_the_budget_adds_up_to_what_predict_and_the_verdict_state(planar: Path) -> None:
    saved = lc.read_result(planar)
    assert saved.poses is not None
    made = _budget(planar, LengthErrors(2e-6, 11.5e-6, 0.5))
    predicted = lc.predict(saved.predictor, saved.poses)
    stated = np.sqrt(np.einsum("noo->n", predicted.covariance).mean())
    at_poses, region = made.places
    inside = [one.sd for one in made.contributions if one.inside]
    assert np.sqrt(sum((sd or 0.0) ** 2 for sd in inside)) == pytest.approx(stated, rel=1e-9)
    assert at_poses.stated == pytest.approx(stated, rel=1e-9)
    assert saved.document.prediction is not None
    assert saved.document.prediction.region is not None
    assert region.stated == saved.document.prediction.region.worst.sd
    shares = [made.share(one) or 0.0 for one in made.contributions]
    assert sum(shares) == pytest.approx(1.0, rel=1e-9)
    points = np.array([predicted.outputs[q] for q in ("xP", "yP")])
    spread = np.sqrt(points.var(axis=1).sum())
    scale, thermal = (one.sd for one in made.contributions if not one.inside)
    assert scale == pytest.approx(2e-6 * spread)
    assert thermal == pytest.approx(11.5e-6 * 0.5 * spread)
    assert pytest.approx(made.k * at_poses.combined) == at_poses.U
    each = [t_quantile(0.9544997, f) for f in predicted.freedom.ravel().tolist()]
    assert min(each) - 1e-6 <= made.k <= np.mean(each) + 1e-6


def test_what_is_not_stated_counts_nothing_in_the_budget(planar: Path) -> None:
    made = _budget(planar, LengthErrors(expansion=11.5e-6))
    assert made.places[0].combined == made.places[0].stated
    assert [one.sd for one in made.contributions if not one.inside] == [None, None]


@pytest.mark.parametrize("scale", [1e-3, -1e-3])
def test_an_instrument_of_a_wrong_scale_errs_as_the_budget_says(scale: float) -> None:
    rng, arm = np.random.default_rng(1), lc.planar_two_link({"l2": 0.8, "l3": 0.6})
    noise = lc.Noise({"xP": 1e-6, "yP": 1e-6, "phi2": 1e-7, "phi3": 1e-7})
    angles = {q: rng.uniform(-2.0, 2.0, 40) for q in ("phi2", "phi3")}
    data = lc.simulate(arm, angles, noise=noise, seed=1).dataset
    place = np.array([data["xP"], data["yP"]])
    middle = place.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.square(place - middle).sum(axis=0).mean())
    wrong = dict(zip(("xP", "yP"), (1.0 + scale) * place, strict=True))
    found = lc.calibrate(arm, data.with_readings(wrong), noise=noise, method="implicit-loop")
    at = found.predict(data).outputs
    off = np.array([at["xP"], at["yP"]]) - place
    off -= off.mean(axis=1, keepdims=True)  # a shift, which the placement takes up
    rms = np.sqrt(np.square(off).sum(axis=0).mean())
    assert rms == pytest.approx(abs(scale) * spread, rel=0.01)


def test_the_page_states_budget_and_what_is_held(folder: Path) -> None:
    made = lc.record(folder)
    text = text_of(made.path.read_text("utf-8"))
    assert "Uncertainty budget of predicted positions" in text
    assert "not stated: instrument_scale of [record]" in text
    assert "is held" in text or "Held at their nominal values" in text
