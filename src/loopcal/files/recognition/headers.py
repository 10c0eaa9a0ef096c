"""Headers as people write them ("J1 [deg]", "X (mm)", "theta1_rad") into a name and a unit."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from loopcal.files.recognition.vocabulary import meanings, words

_SPOKEN = meanings("units")
_OPENING, _CLOSING = re.compile(r"[\[({]"), re.compile(r"[\])}]")
# NFKD takes accents away, but turns no letter of another alphabet into a word.
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
    name, unit = unicodedata.normalize("NFKC", text).strip(), None
    for name_part, stated in (_in_brackets(name), _after_slash(name)):
        if (spoken := _unit(stated)) is not None:
            return Heading(text, stem(name_part), spoken)
        if stated.strip().casefold() in words("open", "angle"):
            return Heading(text, stem(name_part))
    parts = stem(name).split("_")
    if len(parts) > 1 and parts[-1] in _SPOKEN and parts[-1] not in ("s", "ms"):
        unit = _unit(parts[-1])
        parts = parts[:-1]
        if len(parts) > 1 and parts[-1] == "in":
            parts = parts[:-1]
    return Heading(text, "_".join(parts), unit)


def _in_brackets(name: str) -> tuple[str, str]:
    """What stands ahead of the brackets at the end, and in them; "" without brackets there."""
    if not _CLOSING.match(name[-1:]):
        return name, ""
    earlier = max(name.rfind(mark, 0, -1) for mark in "])}") + 1
    opened = _OPENING.search(name, earlier)
    return (name[: opened.start()], name[opened.end() : -1]) if opened else (name, "")


def _after_slash(name: str) -> tuple[str, str]:
    """What stands ahead of the last slash, and behind it; "" without one."""
    name_part, _, stated = name.rpartition("/")
    return (name_part, stated) if name_part else (name, "")


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
    return _SPOKEN.get(word)
