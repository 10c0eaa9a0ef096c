"""Headers as people write them ("J1 [deg]", "X (mm)", "theta1_rad") into a name and a unit."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

_SPOKEN = {
    **dict.fromkeys(
        ("deg", "degs", "degree", "degrees", "°", "grd", "degres", "degré", "degrés", "stupne"),
        "deg",
    ),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("mrad", "urad", "gon", "arcsec", "arcmin", "um", "mm", "cm", "m"), ""),
    **dict.fromkeys(("µrad", "μrad"), "urad"),
    **dict.fromkeys(("µm", "μm", "micron", "microns", "micrometer"), "um"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("gons",), "gon"),
    **dict.fromkeys(("s", "ms", "sec", "seconds"), "s"),
    **dict.fromkeys(("°c", "degc", "celsius"), "degC"),
}
_OPEN = ("grad", "grads", "grade", "grades")
"""Degrees in one language, gon in another: the readings say which."""
_IN_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({]\s*(?P<unit>[^\])}]*?)\s*[\])}]\s*$")
_AFTER_SLASH = re.compile(r"^(?P<name>.+?)\s*/\s*(?P<unit>[^/]+)$")
_LETTERS = {"θ": "theta", "ϑ": "theta", "φ": "phi", "α": "alpha", "β": "beta", "Δ": "delta"}


@dataclass(frozen=True)
class Heading:
    """A header taken apart.

    text: as the file has it; stem: its name in lower case, words joined by _; unit: as stated,
    in the spelling of `loopcal.units`, None where none is.
    """

    text: str
    stem: str
    unit: str | None = None


def heading(text: str) -> Heading:
    """The name and the unit of a header.

    >>> heading("J1 [deg]").stem, heading("theta1_rad").unit, heading("X (mm)").unit
    ('j1', 'rad', 'mm')
    """
    name, unit = text.strip(), None
    for form in (_IN_BRACKETS, _AFTER_SLASH):
        found = form.match(name)
        if found and (spoken := _unit(found["unit"])) is not None:
            return Heading(text, stem(found["name"]), spoken)
        if found and found["unit"].strip().casefold() in _OPEN:
            return Heading(text, stem(found["name"]))
    words = stem(name).split("_")
    if len(words) > 1 and words[-1] in _SPOKEN and words[-1] not in ("s", "ms"):
        unit = _unit(words[-1])
        words = words[:-1]
        if len(words) > 1 and words[-1] == "in":
            words = words[:-1]
    return Heading(text, "_".join(words), unit)


def stem(name: str) -> str:
    """A name in lower case without accents, its words joined by _."""
    for letter, word in _LETTERS.items():
        name = name.replace(letter, word)
    plain = unicodedata.normalize("NFKD", name.replace("°", "deg"))
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    return re.sub(r"[\W_]+", "_", plain, flags=re.UNICODE).strip("_").lower()


def _unit(text: str) -> str | None:
    word = text.strip().casefold()
    if word in ("in", '"', "″"):
        return "in"
    if word not in _SPOKEN:
        return None
    return _SPOKEN[word] or word
