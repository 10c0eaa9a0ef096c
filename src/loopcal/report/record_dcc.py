"""The calibration record as a Digital Calibration Certificate: XML after schema 3.3.0 of the PTB.

Elements and their order are those of dcc.xsd 3.3.0 (https://www.ptb.de/dcc), numbers and units
those of D-SI 2. The page for people is embedded, the files behind the record are named with their
SHA-256, and so is the XML itself: that with 64 zeros in the place of its hash.
"""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections.abc import Iterator, Sequence
from datetime import date
from xml.etree import ElementTree

from loopcal.document.fit import ParameterEntry
from loopcal.errors import InputError
from loopcal.files.result.record_file import OPEN, manifest, sealed
from loopcal.files.versions import version
from loopcal.presentation.dsi import in_dsi
from loopcal.report.record_content import (
    PEOPLE,
    RULE,
    SIGMAS_2,
    RecordContent,
    RecordStage,
    expanded,
)
from loopcal.statistics.tolerance import CONFIDENCE

VERSION = "3.3.0"
"""Of the schema that the XML follows."""
NEEDED = {
    "laboratory": "Measuring Room 2, Example Works, Exampletown",
    "country": "DE",
    "performed_at": "customer",
    "customer": "Example Works, body shop, Exampletown",
    "machine": "Example Robotics ER-6",
    "serial": "ER6-00417",
    "date": "2026-11-02",
    "authorised_by": "B. Jones",
}
"""Keys of [record] without which no certificate validates, with examples."""
_CONDITIONS = ("temperature", "payload", "warm_up", "speed")
_STATEMENTS = ("traceability", "deviations", "accreditation", "note")
_DAYS = re.compile(r"(\d{4}-\d{2}-\d{2})(?:\s*(?:/|to|–|until)\s*(\d{4}-\d{2}-\d{2}))?")
_COUNTRY = re.compile("[A-Z]{2}")
# All but the characters that XML 1.0 allows (section 2.2, Char).
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_BEFORE = "Before adjustment: nominal parameters"
_AFTER = "After adjustment: calibrated parameters"

Element = ElementTree.Element


def record_dcc(content: RecordContent, page: str) -> str:
    """The XML of a record, sealed with its SHA-256; page: that for people, which it embeds.

    Raises InputError naming every key of [record] that the schema needs and that is not stated.
    """
    _check(content)
    root = _of(
        "dcc:digitalCalibrationCertificate",
        _of(
            "dcc:administrativeData",
            _software(),
            _core(content),
            _items(content),
            _of("dcc:calibrationLaboratory", _contact("dcc:contact", content, "laboratory")),
            _people(content),
            _contact("dcc:customer", content, "customer"),
            _of("dcc:statements", *_statements(content)),
        ),
        _of(
            "dcc:measurementResults",
            _method(content),
            *_equipment(content),
            *_conditions(content),
            _of(
                "dcc:measurementMetaData", *(_file(f.name, f.role, f.sha256) for f in content.files)
            )
            if content.files
            else None,
            *(_results(content, before=before) for before in (True, False)),
        ),
        _of("dcc:comment", _seal(content)),
        _of(
            "dcc:document",
            _text("dcc:description", "The record for people", "en"),
            _of("dcc:fileName", text="record.html"),
            _of("dcc:mimeType", text="text/html"),
            _of("dcc:dataBase64", text=b64encode(page.encode("utf-8")).decode("ascii")),
        ),
    )
    # Prefixes are set by hand: ElementTree would call them ns0 and ns1.
    root.set("xmlns:dcc", "https://ptb.de/dcc")
    root.set("xmlns:si", "https://ptb.de/si")
    root.set("schemaVersion", VERSION)
    # Ahead of the seal, which is that of the text as it is written.
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return sealed(f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n')


def _check(content: RecordContent) -> None:
    texts = content.texts
    missing = [key for key in NEEDED if key not in texts]
    if missing:
        wanted = ", ".join(f'{key} = "{NEEDED[key]}"' for key in missing)
        raise InputError(
            f"a digital calibration certificate needs {', '.join(missing)}, not stated in [record]",
            code="missing-key",
            place="[record]",
            remedy=f"state them in [record] of the project, such as {wanted}; "
            "then give that project with --project",
        )
    for key in ("date", "received", "issued"):
        if key in texts:
            _days(texts[key], key)
    if not _COUNTRY.fullmatch(texts["country"]):
        raise InputError(
            f"{texts['country']!r} is no country code of ISO 3166-1",
            code="invalid-value",
            place="[record].country",
            remedy="give two capital letters, such as DE",
        )


def _days(text: str, key: str) -> tuple[str, str]:
    """First and last day of "2026-11-02" or "2026-11-02 to 2026-11-04"."""
    match = _DAYS.fullmatch(text)
    try:
        if match is None or (key != "date" and match[2] is not None):
            raise ValueError
        first, last = (date.fromisoformat(day) for day in (match[1], match[2] or match[1]))
        if last < first:
            raise ValueError
    except ValueError:
        span = ', or "2026-11-02 to 2026-11-04"' if key == "date" else ""
        raise InputError(
            f"{text!r} is no day that a digital calibration certificate can hold",
            code="invalid-value",
            place=f"[record].{key}",
            remedy=f'write it as "2026-11-02"{span}',
        ) from None
    return first.isoformat(), last.isoformat()


def _of(tag: str, *children: Element | None, text: str | None = None) -> Element:
    """An element with those of the children that are there."""
    made = Element(tag)
    made.extend([child for child in children if child is not None])
    if text is not None:
        made.text = _FORBIDDEN.sub("\ufffd", text)
    return made


def _text(tag: str, words: str, language: str | None = None) -> Element:
    """Words in a language; those of the project are in one that we do not know."""
    content = _of("dcc:content", text=words)
    if language is not None:
        content.set("lang", language)
    return _of(tag, content)


def _software() -> Element:
    return _of(
        "dcc:dccSoftware",
        _of(
            "dcc:software",
            _text("dcc:name", "loopcal"),
            _of("dcc:release", text=version()),
            _of("dcc:type", text="application"),
        ),
    )


def _core(content: RecordContent) -> Element:
    texts = content.texts
    first, last = _days(texts["date"], "date")

    def day(tag: str, key: str) -> Element | None:
        return _of(tag, text=texts[key]) if key in texts else None

    return _of(
        "dcc:coreData",
        _of("dcc:countryCodeISO3166_1", text=texts["country"]),
        _of("dcc:usedLangCodeISO639_1", text="en"),
        _of("dcc:mandatoryLangCodeISO639_1", text="en"),
        _of("dcc:uniqueIdentifier", text=content.number),
        day("dcc:receiptDate", "received"),
        _of("dcc:beginPerformanceDate", text=first),
        _of("dcc:endPerformanceDate", text=last),
        _of("dcc:performanceLocation", text=texts["performed_at"]),
        day("dcc:issueDate", "issued"),
    )


def _items(content: RecordContent) -> Element:
    texts = content.texts
    return _of(
        "dcc:items",
        _of("dcc:item", _text("dcc:name", texts["machine"]), _serial(texts["serial"])),
    )


def _serial(number: str) -> Element:
    return _of(
        "dcc:identifications",
        _of(
            "dcc:identification",
            _of("dcc:issuer", text="manufacturer"),
            _of("dcc:value", text=number),
            _text("dcc:name", "Serial number", "en"),
        ),
    )


def _contact(tag: str, content: RecordContent, key: str) -> Element:
    """Name and address from one text: the name ends at its first comma."""
    text = content.texts[key]
    code = _of("dcc:countryCode", text=content.texts["country"]) if key == "laboratory" else None
    return _of(
        tag,
        _text("dcc:name", text.split(",")[0].strip() or text),
        _of("dcc:location", code, _text("dcc:further", text)),
    )


def _people(content: RecordContent) -> Element:
    """Who authorises is the main signer."""
    people = []
    for key in sorted(PEOPLE):
        if key in content.texts:
            person = _of(
                "dcc:respPerson",
                _of("dcc:person", _text("dcc:name", content.texts[key])),
                _of("dcc:role", text=PEOPLE[key]),
                _of("dcc:mainSigner", text=str(key == "authorised_by").lower()),
            )
            people.append(person)
    return _of("dcc:respPersons", *people)


def _statements(content: RecordContent) -> Iterator[Element]:
    """Those that hold for the whole record; conformity only where a tolerance is stated."""
    verdict, texts = content.verdict, content.texts

    def statement(name: str, words: str, *more: Element | None, ours: bool = True) -> Element:
        return _of(
            "dcc:statement",
            _text("dcc:name", name, "en"),
            _text("dcc:declaration", words, "en" if ours else None),
            *more,
        )

    yield statement(
        "Scope",
        "The results relate only to the item calibrated, in the state and under the conditions "
        "stated. This document may be reproduced only in full, unless the laboratory approves "
        "otherwise in writing.",
    )
    yield statement("Validity", " ".join((verdict.headline, verdict.valid.words)))
    for warning in content.document.warnings:
        yield statement("Warning", warning)
    answer = verdict.tolerance
    if answer.asked:
        word = {True: "pass", False: "fail", None: None}[answer.passed]
        conformity = None if word is None else _of("dcc:conformity", text=word)
        open_ = "No decision. " if word is None else ""
        yield statement("Conformity", f"{open_}{answer.words} Decision rule: {RULE}", conformity)
    for key in _STATEMENTS:
        if key in texts:
            yield statement(key.capitalize(), texts[key], ours=False)


def _method(content: RecordContent) -> Element:
    document = content.document
    method = document.method_label or document.method
    procedure = content.texts.get("procedure")
    return _of(
        "dcc:usedMethods",
        _of(
            "dcc:usedMethod",
            _text(
                "dcc:name",
                f"loopcal {document.loopcal}, {method}, {document.data.used} poses",
                "en",
            ),
            None if procedure is None else _text("dcc:description", procedure),
        ),
    )


def _equipment(content: RecordContent) -> Iterator[Element]:
    texts = content.texts
    if "instrument" not in texts:
        return
    yield _of(
        "dcc:measuringEquipments",
        _of(
            "dcc:measuringEquipment",
            _text("dcc:name", texts["instrument"]),
            _text("dcc:description", texts["traceability"]) if "traceability" in texts else None,
            _serial(texts["instrument_serial"]) if "instrument_serial" in texts else None,
        ),
    )


def _conditions(content: RecordContent) -> Iterator[Element]:
    conditions = [
        _condition(key.replace("_", "-").capitalize(), content.texts[key])
        for key in (*_CONDITIONS, "place")
        if key in content.texts
    ]
    if conditions:
        yield _of("dcc:influenceConditions", *conditions)


def _condition(name: str, words: str, status: str | None = None) -> Element:
    return _of(
        "dcc:influenceCondition",
        _text("dcc:name", name, "en"),
        None if status is None else _of("dcc:status", text=status),
        _of("dcc:data", _text("dcc:text", words)),
    )


def _file(name: str, role: str, digest: str) -> Element:
    return _of(
        "dcc:metaData",
        _text("dcc:name", name),
        _text("dcc:description", role, "en"),
        _of("dcc:reference", text=f"SHA-256 {digest}"),
    )


def _results(content: RecordContent, *, before: bool) -> Element:
    """Distances and parameters of one state of the machine."""
    status, name = ("beforeAdjustment", _BEFORE) if before else ("afterAdjustment", _AFTER)
    adjusted = content.texts.get("adjustment", "not stated")
    distances = [_distances(s, content) for s in content.stages if s.before is before]
    parameters = [_parameter(entry, before=before) for entry in content.parameters]
    none = _text("dcc:text", "none", "en")
    return _of(
        "dcc:measurementResult",
        _text("dcc:name", name, "en"),
        _of("dcc:influenceConditions", _condition("Adjustment", adjusted, status)),
        _of(
            "dcc:results",
            *(
                _result("Distance between computed and measured position", d)
                for d in [distances]
                if d
            ),
            _result("Parameters", parameters or [none]),
        ),
    )


def _result(name: str, data: Sequence[Element]) -> Element:
    return _of("dcc:result", _text("dcc:name", name, "en"), _of("dcc:data", *data))


def _distances(stage: RecordStage, content: RecordContent) -> Element:
    accuracy = content.document.accuracy
    assert accuracy is not None  # it has stages
    distances, unit, band = stage.distances, accuracy.unit, stage.band
    ends = () if band is None else (band.low, band.high)
    return _of(
        "dcc:list",
        _text("dcc:name", stage.name, "en"),
        _quantity("Poses", _real(float(stage.poses), "1")),
        _quantity("Mean", _real(distances.mean, unit)),
        _quantity("Root mean square", _real(distances.rms, unit)),
        _quantity(
            "Not exceeded by 95 % of poses", _real(distances.p95, unit, _interval(unit, *ends))
        ),
        _quantity("Largest", _real(distances.max, unit)),
    )


def _parameter(entry: ParameterEntry, *, before: bool) -> Element:
    """Before: the nominal value. After: the calibrated one with its expanded uncertainty."""
    wide = expanded(entry)
    if before or entry.fixed:
        held = "held at its nominal value" if entry.fixed else None
        return _quantity(entry.name, _real(entry.nominal, entry.unit), held)
    if wide is None:
        return _quantity(entry.name, _text("dcc:noQuantity", "not determined", "en"))
    expanded_u = in_dsi(entry.value, entry.unit, wide.u).sizes[0]
    uncertainty = _of(
        "si:expandedMU",
        _of("si:valueExpandedMU", text=_number(expanded_u)),
        _of("si:coverageFactor", text=f"{wide.k:.4f}"),
        _of("si:coverageProbability", text=f"{SIGMAS_2:.4f}"),
        _of(
            "si:distribution",
            text="normal" if entry.degrees_of_freedom is None else "Student's t",
        ),
    )
    return _quantity(entry.name, _real(entry.value, entry.unit, uncertainty))


def _interval(unit: str, *ends: float) -> Element | None:
    """An interval that is not symmetric has no standard uncertainty: D-SI writes NaN."""
    if not ends:
        return None
    low, high = in_dsi(0.0, unit, *ends).sizes
    return _of(
        "si:coverageIntervalMU",
        _of("si:valueStandardMU", text="NaN"),
        _of("si:intervalMin", text=_number(low)),
        _of("si:intervalMax", text=_number(high)),
        _of("si:coverageProbability", text=f"{CONFIDENCE:.2f}"),
    )


def _quantity(name: str, value: Element, words: str | None = None) -> Element:
    description = None if words is None else _text("dcc:description", words, "en")
    return _of("dcc:quantity", _text("dcc:name", name), description, value)


def _real(value: float, unit: str, uncertainty: Element | None = None) -> Element:
    dsi = in_dsi(value, unit)
    wide = None if uncertainty is None else _of("si:measurementUncertaintyUnivariate", uncertainty)
    return _of(
        "si:real",
        _of("si:value", text=_number(dsi.value)),
        _of("si:unit", text=dsi.unit),
        wide,
    )


def _number(value: float) -> str:
    return repr(float(value)) if math.isfinite(value) else "NaN"


def _seal(content: RecordContent) -> Element:
    """What `loopcal record --verify` reads: the hash of this XML and the files behind it."""
    made = _of("record", text=manifest(content.files))
    made.set("xmlns", "urn:loopcal:record")
    made.set("sha256", OPEN)
    return made
