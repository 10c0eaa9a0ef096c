"""The calibration record: one page for print with what ISO/IEC 17025 asks of a certificate.

Sections 7.8.2 (common to reports), 7.8.4 (calibration) and 7.8.6 (statements of conformity) name
what stands in it. What the project does not state prints "not stated".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import accuracy_stages, shown_parameters
from loopcal.files.result.record_file import OPEN, RecordFile, manifest, sealed
from loopcal.files.versions import version
from loopcal.presentation.shown import NONE, by_sd, size, unit_shown
from loopcal.report.page import environment, part
from loopcal.report.tables import Table
from loopcal.report.top import accuracy_bars
from loopcal.small_samples import t_quantile
from loopcal.statistics.tolerance import Quantile
from loopcal.statistics.verdict import verdict_of

UNSTATED = "not stated"
SIGMAS_2 = 0.954499736103642
"""Probability of two sds: k = 2 where sds are known."""
FIELDS: Mapping[str, Mapping[str, str]] = {
    "Laboratory and customer": {
        "laboratory": "Laboratory",
        "accreditation": "Accreditation",
        "place": "Place of calibration",
        "customer": "Customer",
    },
    "Item": {
        "machine": "Make and model",
        "serial": "Serial number",
        "received": "Received",
        "date": "Calibrated",
        "issued": "Issued",
    },
    "Method and conditions": {
        "procedure": "Procedure",
        "temperature": "Temperature",
        "payload": "Payload",
        "warm_up": "Warm-up",
        "speed": "Speed",
        "deviations": "Deviations from the procedure",
    },
    "Instrument": {
        "instrument": "Make and model",
        "instrument_serial": "Serial number",
        "traceability": "Traceability",
    },
}
PEOPLE = {"operator": "Measured by", "authorised_by": "Authorised by"}
OTHERS = ("number", "adjustment", "note")
RULE = (
    "95 % of poses shall lie within the tolerance. The machine passes where the upper end of the "
    "95 % confidence interval of that quantile (the guard band) is not above the tolerance, and "
    "fails where its lower end is above it. Between the two there is no decision."
)


@dataclass(frozen=True)
class RecordPage:
    """html: the page; number: unique; title; missing: keys of [record] that are not stated."""

    html: str
    number: str
    title: str
    missing: tuple[str, ...]


def record_page(
    document: ResultDocument, stated: Mapping[str, str], files: Sequence[RecordFile]
) -> RecordPage:
    """The page of a result, sealed with its SHA-256; nothing in it is asked of any network.

    stated: the texts of [record]; files: those behind it.
    """
    texts = {key: text.strip() for key, text in stated.items() if text and text.strip()}
    number = texts.get("number") or _number(texts, files)
    title = "Calibration certificate" if "accreditation" in texts else "Calibration record"
    verdict = document.verdict or verdict_of(document)
    keys = [key for fields in FIELDS.values() for key in fields]
    optional = {"accreditation", "number", "note"}
    missing = tuple(
        key for key in (*keys, *PEOPLE, *OTHERS) if key not in texts and key not in optional
    )
    html = (
        environment()
        .get_template("record.html")
        .render(
            title=title,
            number=number,
            texts=texts,
            fields={
                section: {
                    label: texts.get(key, UNSTATED)
                    for key, label in fields.items()
                    if key != "accreditation" or key in texts
                }
                for section, fields in FIELDS.items()
            },
            people={label: texts.get(key, UNSTATED) for key, label in PEOPLE.items()},
            adjustment=texts.get("adjustment", UNSTATED),
            note=texts.get("note"),
            document=document,
            verdict=verdict,
            decided=verdict.tolerance.code != "no-tolerance",
            rule=RULE,
            drawn=accuracy_bars(document),
            accuracy=_accuracy(document),
            parameters=_parameters(document),
            files=files,
            manifest=manifest(files),
            seal=OPEN,
            version=version(),
            style=part("style.css") + part("record.css"),
        )
    )
    return RecordPage(sealed(html), number, title, missing)


def _number(texts: Mapping[str, str], files: Sequence[RecordFile]) -> str:
    """A number that follows from the content: other content has another one."""
    content = repr(sorted(texts.items())) + "".join(file.sha256 for file in files)
    return f"LC-{sha256(content.encode('utf-8')).hexdigest()[:12].upper()}"


def _accuracy(document: ResultDocument) -> Table | None:
    """Distances before and after, with the 95 % interval of the distance that 95 % keep."""
    accuracy = document.accuracy
    if accuracy is None:
        return None
    unit = accuracy.unit
    stages = accuracy_stages(accuracy, document.validation)
    rows = []
    for stage in stages.position:
        found = stage.distances
        poses = found.poses or document.data.used
        band = Quantile.of_summary(found.p95, poses)
        within = NONE if band is None else f"{size(band.low, unit)} to {size(band.high, unit)}"
        name = _NAMES.get(stage.name, stage.name)
        name = name if not stage.instrument else f"{name}, {stage.instrument}"
        values = (found.mean, found.rms, found.p95)
        shown = [size(value, unit) for value in values]
        rows.append((name, str(poses), *shown, within, size(found.max, unit)))
    if stages.noise_floor is not None:
        rows.append(
            ("noise of the readings", NONE, NONE, size(stages.noise_floor, unit), *[NONE] * 3)
        )
    head = ("", "poses", "mean", "rms", "95 % of poses", "its 95 % interval", "largest")
    caption = f"Distance between computed and measured position [{unit_shown(unit)}]"
    return Table(caption, head, tuple(rows))


_NAMES = {
    "nominal": "before: nominal",
    "nominal, best placed": "before: nominal, instrument and target placed",
    "calibrated": "after: calibrated, same poses",
    "on poses not used": "after: on poses not used",
    "in regions not used": "after: in regions not used",
}


def _parameters(document: ResultDocument) -> Table:
    """Every parameter before and after, its expanded uncertainty U = k sd, and k."""
    rows = [_parameter(entry) for entry in shown_parameters(document.parameters, document.terms)]
    head = ("parameter", "unit", "before", "after", "U", "k")
    caption = "Parameters before (nominal) and after calibration"
    return Table(caption, head, tuple(rows))


def _parameter(entry: ParameterEntry) -> tuple[str, ...]:
    before = by_sd(entry.nominal, entry.sd, entry.unit)
    after = by_sd(entry.value, entry.sd, entry.unit)
    unit = unit_shown(entry.unit)
    if entry.fixed:
        return (entry.name, unit, before, "held", NONE, NONE)
    if entry.sd is None:
        return (entry.name, unit, before, "not determined", NONE, NONE)
    freedom = entry.degrees_of_freedom
    k = t_quantile(SIGMAS_2, float("inf") if freedom is None else freedom)
    return (entry.name, unit, before, after, size(k * entry.sd, entry.unit, 2), f"{k:.2f}")
