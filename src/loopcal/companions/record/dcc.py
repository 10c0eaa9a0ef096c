"""The calibration record as a Digital Calibration Certificate: XML after schema 3.3.0 of the PTB.

Elements and their order are those of dcc.xsd 3.3.0 (https://www.ptb.de/dcc), numbers and units
those of D-SI 2. The page for people is embedded, the files behind the record are named with their
SHA-256, and so is the XML itself: that with 64 zeros in the place of its hash.

Quantities in D-SI, the form of numbers and units in digital calibration certificates.

D-SI names units by words with a backslash and exponents by ``\tothe{}`` (PTB, Digital System of
Units; BIPM SI brochure, 9th edition). A unit outside the SI, such as the inch, is converted.
"""

from __future__ import annotations

import math
import re
from base64 import b64encode
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

from loopcal.companions.record.budget import SIGMAS_2
from loopcal.companions.record.content import PEOPLE, RULE, RecordContent, expanded
from loopcal.companions.record.record_file import OPEN, manifest, sealed
from loopcal.errors import InputError
from loopcal.files.versions import version
from loopcal.measurements.days import Days
from loopcal.report.templates import environment
from loopcal.statistics.verdict import CONFIDENCE
from loopcal.units import difference_to_si, to_si, unit

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
_COUNTRY = re.compile("[A-Z]{2}")
# All but the characters that XML 1.0 allows (section 2.2, Char).
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def record_dcc(content: RecordContent, page: str) -> str:
    """The XML of a record, sealed with its SHA-256; page: that for people, which it embeds.

    Raises InputError naming every key of [record] that the schema needs and that is not stated.
    """
    _check(content)
    xml = (
        environment()
        .get_template("record.xml")
        .render(
            schema=VERSION,
            version=version(),
            content=content,
            document=content.document,
            texts=content.texts,
            days=_days(content.texts["date"], "date"),
            people=PEOPLE,
            rule=RULE,
            seal=OPEN,
            manifest=manifest(content.files),
            page=b64encode(page.encode("utf-8")).decode("ascii"),
            in_dsi=in_dsi,
            number=_number,
            expanded=expanded,
            confidence=CONFIDENCE,
            sigmas_2=SIGMAS_2,
        )
    )
    # Ahead of the seal, which is that of the text as it is written.
    return sealed(f'<?xml version="1.0" encoding="UTF-8"?>\n{_indented(xml)}\n')


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
        ).offering("--project", "PROJECT")
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


def _days(text: str, key: str) -> Days:
    """The day, or for "date" the days, that a key of [record] states."""
    days = Days.of_text(text)
    if days is None or (key != "date" and days.first != days.last):
        span = ', or "2026-11-02 to 2026-11-04"' if key == "date" else ""
        raise InputError(
            f"{text!r} is no day that a digital calibration certificate can hold",
            code="invalid-value",
            place=f"[record].{key}",
            remedy=f'write it as "2026-11-02"{span}',
        )
    return days


def _indented(xml: str) -> str:
    """The same with one element on a line, and without characters that XML forbids."""
    made, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = made.start, made.end
    parser.CharacterDataHandler = made.data
    parser.Parse(_FORBIDDEN.sub("\ufffd", xml), True)
    root = made.close()
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _number(value: float) -> str:
    return repr(float(value)) if math.isfinite(value) else "NaN"


_NAMES = {
    "m": r"\metre", "cm": r"\centi\metre", "mm": r"\milli\metre",
    "um": r"\micro\metre", "nm": r"\nano\metre",
    "rad": r"\radian", "mrad": r"\milli\radian", "urad": r"\micro\radian",
    "deg": r"\degree", "arcmin": r"\arcminute", "arcsec": r"\arcsecond",
    "1": r"\one", "kg": r"\kilogram", "g": r"\gram", "N": r"\newton", "s": r"\second",
    "K": r"\kelvin", "mK": r"\milli\kelvin", "degC": r"\degreecelsius",
}  # fmt: skip


@dataclass(frozen=True)
class DsiQuantity:
    """A value and its sizes (uncertainties, which are differences) in a D-SI unit."""

    value: float
    unit: str
    sizes: tuple[float, ...] = ()


def in_dsi(value: float, name: str, *sizes: float) -> DsiQuantity:
    r"""A value [unit `name`] and uncertainties in D-SI; in SI units where D-SI has no such unit.

    >>> in_dsi(0.3, "mm", 0.01)
    DsiQuantity(value=0.3, unit='\\milli\\metre', sizes=(0.01,))
    >>> in_dsi(2.0, "urad/(N m)").unit
    '\\micro\\radian\\newton\\tothe{-1}\\metre\\tothe{-1}'
    >>> in_dsi(1.0, "in")
    DsiQuantity(value=0.0254, unit='\\metre', sizes=())
    """
    named = _named(unit(name).name)
    if named is not None:
        return DsiQuantity(value, named, sizes)
    si = _named(unit(name).si)
    assert si is not None  # every SI unit of ours has a name
    converted = tuple(float(difference_to_si(size, name)) for size in sizes)
    return DsiQuantity(float(to_si(value, name)), si, converted)


def _named(name: str) -> str | None:
    above, _, below = name.partition("/")
    parts = [_NAMES.get(above), *(_NAMES.get(part) for part in below.strip("()").split())]
    if None in parts:
        return None
    first, *others = (str(part) for part in parts)
    first = "" if others and first == _NAMES["1"] else first
    return first + "".join(rf"{part}\tothe{{-1}}" for part in others)
