"""What a calibration record states, gathered once for its page and for its XML.

Sections 7.8.2 (common to reports), 7.8.4 (calibration) and 7.8.6 (statements of conformity) of
ISO/IEC 17025 name what stands in it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

from loopcal.companions.record.budget import SIGMAS_2, Budget
from loopcal.companions.record.record_file import RecordFile
from loopcal.document.accuracy import Distances
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import Stage, accuracy_stages, shown_parameters
from loopcal.document.verdict import UNJUDGED, Verdict
from loopcal.measurements.days import Days
from loopcal.presentation.shown import significant
from loopcal.small_samples import t_quantile
from loopcal.statistics.verdict import Quantile
from loopcal.units import from_si

UNSTATED = "not stated"
FIELDS: Mapping[str, Mapping[str, str]] = {
    "Laboratory and customer": {
        "laboratory": "Laboratory",
        "accreditation": "Accreditation",
        "country": "Country of calibration",
        "performed_at": "Calibrated at",
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
        "temperature_sd": "sd of the temperature",
        "expansion": "Thermal expansion",
        "payload": "Payload",
        "warm_up": "Warm-up",
        "speed": "Speed",
        "deviations": "Deviations from the procedure",
    },
    "Instrument": {
        "instrument": "Make and model",
        "instrument_serial": "Serial number",
        "traceability": "Traceability",
        "instrument_calibrated": "Calibrated",
        "instrument_due": "Calibration due",
        "instrument_scale": "sd of its scale",
    },
}
PEOPLE = {"operator": "Measured by", "authorised_by": "Authorised by"}
OTHERS = ("number", "adjustment", "note")
QUANTITIES = {"instrument_scale": "ppm", "temperature_sd": "K", "expansion": "ppm/K"}
"""Keys of [record] that are numbers, and the units in which they are shown."""
OPTIONAL = (
    *("accreditation", "country", "performed_at", "number", "note"),
    *("instrument_calibrated", "instrument_due", *QUANTITIES),
)
"""Keys of which a page without them says nothing."""
RULE = (
    "95 % of poses shall lie within the tolerance. The machine passes where the upper end of the "
    "95 % confidence interval of that quantile (the guard band) is not above the tolerance, and "
    "fails where its lower end is above it. Between the two there is no decision."
)


@dataclass(frozen=True)
class RecordStage:
    """Distances before or after; poses: how many; band: the 95 % interval of their 95 % quantile.

    before: whether with the nominal parameters.
    """

    name: str
    before: bool
    distances: Distances
    poses: int
    band: Quantile | None


@dataclass(frozen=True)
class Expanded:
    """The expanded uncertainty u = k sd of a parameter [its unit]."""

    u: float
    k: float


@dataclass(frozen=True)
class RecordContent:
    """A result, the texts of [record] that are stated, and the files behind both.

    budgets: of predicted positions; no_budget: why there is none.
    """

    document: ResultDocument
    texts: Mapping[str, str]
    files: Sequence[RecordFile]
    budgets: Sequence[Budget] = ()
    no_budget: str = ""

    @property
    def title(self) -> str:
        """A certificate only where an accreditation is stated."""
        return "Calibration certificate" if "accreditation" in self.texts else "Calibration record"

    @property
    def number(self) -> str:
        """The stated number, else one that follows from the content: other content, another one."""
        content = repr(sorted(self.texts.items())) + "".join(file.sha256 for file in self.files)
        # 48 bits: among a million records two share a number with a probability of 0.2 %.
        made = f"LC-{sha256(content.encode('utf-8')).hexdigest()[:12].upper()}"
        return self.texts.get("number") or made

    @property
    def missing(self) -> tuple[str, ...]:
        """Keys that the page prints as "not stated"."""
        keys = [key for fields in FIELDS.values() for key in fields]
        return tuple(k for k in (*keys, *PEOPLE, *OTHERS) if k not in {*self.texts, *OPTIONAL})

    @property
    def cautions(self) -> tuple[str, ...]:
        """Dates that do not agree."""
        return date_cautions(self.document, self.texts)

    @property
    def held(self) -> tuple[str, ...]:
        """The parameters that the calibration held at their nominal values."""
        return tuple(entry.name for entry in self.parameters if entry.fixed)

    @property
    def verdict(self) -> Verdict:
        """Of the result."""
        return UNJUDGED if self.document.verdict is None else self.document.verdict

    @property
    def parameters(self) -> Sequence[ParameterEntry]:
        """Those that are shown to people."""
        return shown_parameters(self.document.parameters, self.document.terms)

    @property
    def stages(self) -> tuple[RecordStage, ...]:
        """Distances of positions before and after."""
        accuracy = self.document.accuracy
        if accuracy is None:
            return ()
        document = self.document
        stages = accuracy_stages(accuracy, document.validation, document.updated).position
        return tuple(self._stage(stage) for stage in stages)

    def _stage(self, stage: Stage) -> RecordStage:
        poses = stage.distances.poses or self.document.data.used
        band = Quantile.of_summary(stage.distances.p95, poses)
        name = _NAMES.get(stage.name, stage.name)
        name = name if not stage.instrument else f"{name}, {stage.instrument}"
        return RecordStage(name, name.startswith("before"), stage.distances, poses, band)


def record_content(
    document: ResultDocument,
    stated: Mapping[str, str | float | None],
    files: Sequence[RecordFile],
    budgets: Sequence[Budget] = (),
    no_budget: str = "",
) -> RecordContent:
    """What the record of a result states.

    stated: of [record], where blank texts count as missing and numbers are SI; files: those behind
    it; budgets, no_budget: as in `RecordContent`.
    """
    texts = {key: _text(key, value) for key, value in stated.items() if value is not None}
    texts = {key: text for key, text in texts.items() if text}
    return RecordContent(document, texts, files, budgets, no_budget)


def _text(key: str, value: str | float) -> str:
    if isinstance(value, str):
        return value.strip()
    shown = QUANTITIES[key]
    return f"{significant(float(from_si(value, shown)), 4)} {shown}"


def expanded(entry: ParameterEntry) -> Expanded | None:
    """U and k of a parameter; None for one that is held or not determined."""
    if entry.fixed or entry.sd is None:
        return None
    freedom = entry.degrees_of_freedom
    # Sds that were learnt need Student's t in place of 2 (docs/decisions/0083).
    k = t_quantile(SIGMAS_2, float("inf") if freedom is None else freedom)
    return Expanded(k * entry.sd, k)


_NAMES = {
    "nominal": "before: nominal",
    "nominal, best placed": "before: nominal, instrument and target placed",
    "calibrated": "after: calibrated, same poses",
    "on poses not used": "after: on poses not used",
    "in regions not used": "after: in regions not used",
}

# Whether the dates of a record agree with each other: what does not is a caution.


_DAY = re.compile(r"(?<!\d)\d{4}-\d{2}-\d{2}(?!\d)")
KEYS = ("date", "received", "issued", "instrument_calibrated", "instrument_due")
"""Keys of [record] that state days."""


def date_cautions(document: ResultDocument, texts: Mapping[str, str]) -> tuple[str, ...]:
    """What does not agree, with both dates; texts: those of [record]."""
    days = {key: Days.of_text(texts[key]) for key in KEYS if key in texts}
    cautions = [
        f'[record] {key} is "{texts[key]}", which is no day: its order is not checked. '
        "Write it as 2026-11-02."
        for key, day in days.items()
        if day is None
    ]
    stated, read = days.get("date"), document.data.measured
    if stated is not None and read is not None and stated != read:
        cautions.append(f"The readings are dated {read}, but [record] date is {stated}.")
    measured = read or stated
    certificate = days.get("instrument_calibrated") or _in_text(texts.get("traceability", ""))
    due = days.get("instrument_due")
    if measured is None:
        if certificate is not None or due is not None:
            cautions.append(
                "The day of the measurement is not stated: whether the certificate of the "
                "instrument covers it is not known. State [record] date."
            )
        return tuple(cautions)
    if certificate is not None and measured.first < certificate.first:
        cautions.append(
            f"The instrument was calibrated on {certificate}, after the measurement of {measured}: "
            "its certificate does not cover the measurement. State the certificate before it."
        )
    if due is not None and due.last < measured.last:
        cautions.append(
            f"The certificate of the instrument expired on {due}, before the measurement of "
            f"{measured}. Have the instrument calibrated."
        )
    for key, late in (("received", False), ("issued", True)):
        day = days.get(key)
        if day is None:
            continue
        wrong = day.last < measured.last if late else measured.first < day.first
        if wrong:
            order = "before" if late else "after"
            cautions.append(
                f"[record] {key} is {day}, {order} the measurement of {measured}. Correct one."
            )
    return tuple(cautions)


def _in_text(text: str) -> Days | None:
    """The only day in a text; which of several is that of a certificate is not guessed."""
    days = {day for day in map(Days.of_text, _DAY.findall(text)) if day is not None}
    return days.pop() if len(days) == 1 else None
