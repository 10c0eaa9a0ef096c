"""What a calibration record states, gathered once for its page and for its XML.

Sections 7.8.2 (common to reports), 7.8.4 (calibration) and 7.8.6 (statements of conformity) of
ISO/IEC 17025 name what stands in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

from loopcal.document.accuracy import Distances
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.tables import Stage, accuracy_stages, shown_parameters
from loopcal.document.verdict import UNJUDGED, Verdict
from loopcal.files.result.record_file import RecordFile
from loopcal.small_samples import t_quantile
from loopcal.statistics.verdict import Quantile

UNSTATED = "not stated"
# erf(sqrt(2)) = 2 Phi(2) - 1.
SIGMAS_2 = 0.954499736103642
"""Probability of two sds: k = 2 where sds are known."""
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
OPTIONAL = ("accreditation", "country", "performed_at", "number", "note")
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
    """A result, the texts of [record] that are stated, and the files behind both."""

    document: ResultDocument
    texts: Mapping[str, str]
    files: Sequence[RecordFile]

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
        stages = accuracy_stages(accuracy, self.document.validation).position
        return tuple(self._stage(stage) for stage in stages)

    def _stage(self, stage: Stage) -> RecordStage:
        poses = stage.distances.poses or self.document.data.used
        band = Quantile.of_summary(stage.distances.p95, poses)
        name = _NAMES.get(stage.name, stage.name)
        name = name if not stage.instrument else f"{name}, {stage.instrument}"
        return RecordStage(name, name.startswith("before"), stage.distances, poses, band)


def record_content(
    document: ResultDocument, stated: Mapping[str, str], files: Sequence[RecordFile]
) -> RecordContent:
    """What the record of a result states.

    stated: the texts of [record], of which blank ones count as missing; files: those behind it.
    """
    texts = {key: text.strip() for key, text in stated.items() if text and text.strip()}
    return RecordContent(document, texts, files)


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
