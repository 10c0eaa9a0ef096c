"""The record as digital calibration certificate: what the schema demands, in its order and forms.

`LOOPCAL_DCC_SCHEMA` names a folder with the published dcc.xsd 3.3.0 and what it imports; without it
order, mandatory elements and forms are checked as its authors documented them.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from lxml import etree

import loopcal as lc
from loopcal.companions.record.content import (
    FIELDS,
    OTHERS,
    PEOPLE,
    expanded,
    record_content,
)
from loopcal.companions.record.dcc import NEEDED, record_dcc
from loopcal.companions.record.page import record_page
from loopcal.companions.record.record_file import RecordFile, check_record
from loopcal.companions.record.xml_schema import check_against
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer
from loopcal.files.result.result_file import read_result
from tests.refusals import refused

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STATED = {key: f"the {key} \x0b<b>&amp;" for fields in FIELDS.values() for key in fields} | {
    **{key: f"the {key}" for key in (*PEOPLE, *OTHERS)},
    **NEEDED,
    "date": "2026-11-02 to 2026-11-04",
    "received": "2026-10-30",
    "issued": "2026-11-05",
}
FILES = (RecordFile("result", "result.json", "result.json", "0a" * 32),)
NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
NAMED = re.compile(r"(\w+)([?*+]?)")
# Children in the order of dcc.xsd 3.3.0 and D-SI 2: ? may be absent, + at least one, * any number.
ORDER = {
    "digitalCalibrationCertificate": "administrativeData measurementResults comment? document?",
    "administrativeData": "dccSoftware coreData items calibrationLaboratory respPersons customer "
    "statements?",
    "dccSoftware": "software+",
    "software": "name release type?",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ "
    "uniqueIdentifier receiptDate? beginPerformanceDate endPerformanceDate performanceLocation "
    "issueDate?",
    "items": "item+",
    "item": "name identifications",
    "identifications": "identification+",
    "identification": "issuer value name?",
    "calibrationLaboratory": "contact",
    "contact": "name location",
    "customer": "name location",
    "respPersons": "respPerson+",
    "respPerson": "person role? mainSigner?",
    "person": "name",
    "statements": "statement+",
    "statement": "name? declaration? conformity?",
    "measurementResults": "usedMethods? measuringEquipments? influenceConditions? "
    "measurementMetaData? measurementResult+",
    "usedMethods": "usedMethod+",
    "usedMethod": "name description?",
    "measuringEquipments": "measuringEquipment+",
    "measuringEquipment": "name description? identifications?",
    "influenceConditions": "influenceCondition+",
    "influenceCondition": "name status? data",
    "measurementMetaData": "metaData+",
    "metaData": "name? description? reference*",
    "measurementResult": "name influenceConditions? results",
    "results": "result+",
    "result": "name data",
    "document": "description? fileName mimeType dataBase64",
    "real": "value unit measurementUncertaintyUnivariate?",
    "expandedMU": "valueExpandedMU coverageFactor coverageProbability distribution?",
    "coverageIntervalMU": "valueStandardMU intervalMin intervalMax coverageProbability",
}
NUMBER = r"[-+]?((\d*\.\d+)|(\d+\.\d*)|(\d+\.?))([Ee][-+]?\d+)?|NaN"
FORMS = {
    "value": NUMBER,
    "intervalMin": NUMBER,
    "intervalMax": NUMBER,
    "valueExpandedMU": NUMBER.removeprefix("[-+]?"),
    "coverageFactor": r"[1-9]\d*\.\d*",
    "coverageProbability": r"0\.\d+",
    "unit": r"(\\[a-z]+(\{-1\})?)+",
    "status": "beforeAdjustment|afterAdjustment",
    "conformity": "pass|fail",
    "beginPerformanceDate": r"\d{4}-\d{2}-\d{2}",
    "issueDate": r"\d{4}-\d{2}-\d{2}",
}


def made(document: ResultDocument, **stated: str) -> str:
    content = record_content(document, {**STATED, **stated}, FILES)
    return record_dcc(content, record_page(content))


def parsed(xml: str) -> Any:
    return etree.fromstring(xml.encode("utf-8"))


def texts(root: Any, path: str) -> list[str]:
    return [str(text) for text in root.xpath(f"{path}//text()", namespaces=NAMESPACES)]


def schema() -> Path | None:
    folder = os.environ.get("LOOPCAL_DCC_SCHEMA")
    return None if folder is None else Path(folder) / "dcc.xsd"


def in_order(tag: str, children: list[str]) -> bool:
    pattern = "".join(f"(?:{name} ){count}" for name, count in NAMED.findall(ORDER[tag]))
    return re.fullmatch(pattern, "".join(f"{child} " for child in children)) is not None


def valid(xml: str) -> None:
    """By the published schema where it is at hand, and by order and forms always."""
    for node in parsed(xml).iter(etree.Element):
        name = etree.QName(node)
        if name.namespace == NAMESPACES["si"] or name.localname != "value":
            text = (node.text or "").strip()
            assert re.fullmatch(FORMS.get(name.localname, "(?s).*"), text), (name, text)
        if name.localname in ORDER:
            children = [etree.QName(child).localname for child in node]
            assert in_order(name.localname, children), (name.localname, children)
    published = schema()
    if published is not None:
        check_against(xml, published)


def documents(folder: Path) -> dict[str, ResultDocument]:
    """Results of every kind that a record may have to tell of."""
    plain = read_result(folder / "result.json")
    assert plain.verdict is not None
    free, *_ = (p for p in plain.parameters if p.sd is not None)
    odd = (
        replace(free, name="learnt", degrees_of_freedom=4.0),
        replace(free, name="held", fixed=True),
        replace(free, name="lost", sd=None, identifiable=False),
        replace(free, name="per torque", unit="rad/(N m)", sd=1e-9),
        replace(free, name="without end", nominal=math.inf),
    )
    answers = {
        f"tolerance {passed}": replace(
            plain,
            verdict=replace(
                plain.verdict, tolerance=Answer(passed, "near-tolerance", 1.0, "Words.", None)
            ),
        )
        for passed in (True, False, None)
    }
    return {
        "plain": plain,
        "odd parameters": replace(plain, parameters=odd, terms=()),
        "no parameters": replace(plain, parameters=(), terms=()),
        "no accuracy": replace(plain, accuracy=None, validation=None),
        "no verdict": replace(plain, verdict=None),
        **answers,
    }


def test_every_kind_of_result_gives_what_the_schema_demands(planar: Path) -> None:
    for document in documents(planar).values():
        valid(made(document))
    least = record_content(documents(planar)["plain"], NEEDED, ())
    valid(record_dcc(least, "page"))


def test_it_validates_against_the_published_schema(planar: Path) -> None:
    published = schema()
    if published is None:
        pytest.skip("set LOOPCAL_DCC_SCHEMA to the folder of dcc.xsd 3.3.0")
    check_against(made(read_result(planar / "result.json")), published)


def test_before_and_after_are_results_of_their_own(planar: Path) -> None:
    document = read_result(planar / "result.json")
    root = parsed(made(document))
    before, after = root.findall(".//dcc:measurementResult", NAMESPACES)
    for result, status, words in (
        (before, "beforeAdjustment", "before: nominal"),
        (after, "afterAdjustment", "after: calibrated, same poses"),
    ):
        assert texts(result, ".//dcc:status") == [status]
        assert words in texts(result, ".//dcc:list/dcc:name")
        assert "the adjustment" in texts(result, ".//dcc:influenceCondition/dcc:data")
    assert not before.findall(".//si:expandedMU", NAMESPACES)
    units = set(texts(root, ".//si:unit"))
    assert {r"\metre", r"\one"} <= units


def test_uncertainties_are_those_of_the_page_with_k_and_probability(planar: Path) -> None:
    document = documents(planar)["odd parameters"]
    after = parsed(made(document)).findall(".//dcc:measurementResult", NAMESPACES)[1]
    quantities = {
        "".join(texts(q, "dcc:name")).strip(): q
        for q in after.findall(".//dcc:quantity", NAMESPACES)
    }
    for entry in document.parameters:
        wide, quantity = expanded(entry), quantities[entry.name]
        stated = quantity.find(".//si:expandedMU", NAMESPACES)
        assert (wide is None) is (stated is None)
        if wide is not None:
            u, k, p, kind = (child.text for child in stated)
            assert float(u) == pytest.approx(wide.u, rel=1e-12)
            assert float(k) == pytest.approx(wide.k, abs=5e-5)
            known = entry.degrees_of_freedom is None
            assert (p, kind) == ("0.9545", "normal" if known else "Student's t")
    assert "not determined" in texts(quantities["lost"], ".//dcc:noQuantity")
    band = next(stage.band for stage in record_content(document, {}, ()).stages if not stage.before)
    assert band is not None
    low, high = (float(texts(after, f".//si:{end}")[0]) for end in ("intervalMin", "intervalMax"))
    assert (low, high) == pytest.approx((band.low, band.high))


def test_conformity_is_stated_only_where_it_was_decided(planar: Path) -> None:
    found = {
        name: texts(parsed(made(document)), ".//dcc:conformity")
        for name, document in documents(planar).items()
    }
    assert found["tolerance True"] == ["pass"]
    assert found["tolerance False"] == ["fail"]
    assert found["tolerance None"] == found["plain"] == []


def test_every_stated_text_and_the_page_are_in_it(planar: Path) -> None:
    content = record_content(read_result(planar / "result.json"), STATED, FILES)
    page = record_page(content)
    root = parsed(record_dcc(content, page))
    words = "\n".join(root.itertext())
    for key, text in STATED.items():
        days = text.split(" to ") if key == "date" else [text.replace("\x0b", "\ufffd")]
        assert all(day in words for day in days), key
    assert f"SHA-256 {FILES[0].sha256}" in words
    embedded = texts(root, ".//dcc:document/dcc:dataBase64")[0]
    assert b64decode(embedded).decode("utf-8") == page


@pytest.mark.parametrize("key", NEEDED)
def test_a_missing_key_is_named_with_an_example(planar: Path, key: str) -> None:
    content = record_content(
        read_result(planar / "result.json"), {k: t for k, t in STATED.items() if k != key}, ()
    )
    with refused("missing-key", f"needs {key},", f'{key} = "', "[record]", "--project"):
        record_dcc(content, "")


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("date", "2 November 2026"),
        ("date", "2026-02-30"),
        ("date", "2026-11-04 to 2026-11-02"),
        ("issued", "tomorrow"),
        ("received", "2026-11-02 to 2026-11-04"),
        ("country", "Germany"),
    ],
)
def test_a_text_that_the_schema_cannot_hold_is_refused(planar: Path, key: str, text: str) -> None:
    with refused("invalid-value", f"[record].{key}", text):
        made(read_result(planar / "result.json"), **{key: text})


@pytest.fixture
def folder(planar: Path, tmp_path: Path) -> Path:
    """A copy of a result, with a project that states what a certificate needs."""
    shutil.copytree(EXAMPLES / "planar", tmp_path / "planar")
    shutil.copytree(planar, tmp_path / "planar" / "result")
    lines = "\n".join(f'{key} = "{text}"' for key, text in NEEDED.items())
    with (tmp_path / "planar" / "project.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[record]\n{lines}\n")
    return tmp_path / "planar"


def test_every_altered_byte_of_the_xml_and_every_altered_file_is_noticed(folder: Path) -> None:
    written = lc.record(folder / "result", project=folder / "project.toml", dcc=True)
    assert written.dcc == folder / "result" / "record.xml"
    assert lc.verify_record(written.dcc).unaltered
    xml = written.dcc.read_bytes()
    seal = xml.index(b"sha256=")
    for at in range(60, len(xml), len(xml) // 40):
        if chr(xml[at]).isalnum() and not seal - 60 < at < seal + 1000:
            written.dcc.write_bytes(xml[:at] + b"~" + xml[at + 1 :])
            assert not check_record(written.dcc).page
    written.dcc.write_bytes(xml)
    with (folder / "result" / "residuals.csv").open("a", encoding="utf-8") as file:
        file.write(" ")
    found = lc.verify_record(written.dcc)
    assert found.page
    assert [name for name, state in found.files.items() if state == "altered"] == ["residuals.csv"]


def test_what_does_not_validate_is_not_written(folder: Path) -> None:
    stricter = folder / "dcc.xsd"
    stricter.write_text(
        '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" version="3.3.0"'
        ' targetNamespace="https://ptb.de/dcc"><xs:element name="other"/></xs:schema>'
    )
    with refused("invalid-value", "digitalCalibrationCertificate"):
        lc.record(folder / "result", project=folder / "project.toml", dcc=True, schema=stricter)
    stricter.write_text(stricter.read_text().replace("3.3.0", "2.4.0"))
    with refused("wrong-schema", "2.4.0", "3.3.0"):
        lc.record(folder / "result", project=folder / "project.toml", dcc=True, schema=stricter)
    assert not (folder / "result" / "record.html").exists()
    assert not (folder / "result" / "record.xml").exists()
