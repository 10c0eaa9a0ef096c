"""Headers as people write them ("J1 [deg]", "X (mm)", "theta1_rad") into a name and a unit."""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.toml.reader import read_toml

# The words of headers, from vocabulary.toml: what they mean, in several languages.


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name("vocabulary.toml").read_text("utf-8"))


def words(table: str, meaning: str) -> tuple[str, ...]:
    """The words of one meaning, in their order.

    >>> words("columns", "azimuth")[:2]
    ('azimuth', 'az')
    """
    stated: str = _tables()[table][meaning]
    return tuple(stated.split())


def meanings(table: str) -> dict[str, str]:
    """Word -> what it means, of all words of a table.

    >>> meanings("units")["µm"]
    'um'
    """
    return {word: meaning for meaning in _tables()[table] for word in words(table, meaning)}


def arms() -> tuple[tuple[str, ...], ...]:
    """The joints of known arms, as their makers name them."""
    return tuple(tuple(arm.split()) for arm in _tables()["columns"]["arms"])


_SPOKEN = meanings("units")
_BEHIND = {
    **{unit: {*words("columns", "time")} for unit in ("s", "ms", "us", "ns")},
    "in": {"x", "y", "z"},
}
"""Units that are other words behind other names, such as the joint S, or "in"."""
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


OWN_WORDS = "loopcal-words.toml"
"""A file beside the readings with words of their headers and what they mean."""


def own_words(folder: Path) -> dict[str, str]:
    """Word of a header -> word of the vocabulary, from `loopcal-words.toml` in a folder.

    Raises InputError where its table [words] holds anything but texts.
    """
    path = folder / OWN_WORDS
    if not path.is_file():
        return {}
    stated = read_toml(path).get("words", {})
    if not isinstance(stated, dict) or not all(isinstance(w, str) for w in stated.values()):
        raise InputError(
            "the words are no table of texts",
            code="invalid-value",
            place=f"{OWN_WORDS}: words",
            remedy='write [words], and below it a line per word: "Gelenk" = "joint"',
        )
    return {word: meaning for word, meaning in stated.items() if word}


def heading(text: str, spoken: Mapping[str, str] = MappingProxyType({})) -> Heading:
    """The name and the unit of a header; spoken: what further words in it mean.

    >>> heading("J1 [deg]").stem, heading("theta1_rad").unit, heading("X (mm)").unit
    ('j1', 'rad', 'mm')
    >>> heading("x_in").unit, heading("valve_in").unit
    ('in', None)
    >>> heading("Csukló 2 [fok]", {"csukló": "joint", "fok": "deg"})
    Heading(text='Csukló 2 [fok]', stem='joint_2', unit='deg')
    """
    name, unit = unicodedata.normalize("NFKC", text).strip(), None
    for word, meaning in spoken.items():
        word = unicodedata.normalize("NFKC", word)
        parts = re.split(re.escape(word), name, flags=re.IGNORECASE)
        name = meaning.join(parts)
    for name_part, stated in (_in_brackets(name), _after_slash(name)):
        if (symbol := _unit(stated)) is not None:
            return Heading(text, stem(name_part), symbol)
        if stated.strip().casefold() in words("open", "angle"):
            return Heading(text, stem(name_part))
    parts = stem(name).split("_")
    *rest, last = parts
    names = _BEHIND.get(last)
    if rest and _unit(last) and (names is None or {"_".join(rest), rest[-1]} & names):
        unit, parts = _unit(last), rest
        if len(parts) > 1 and parts[-1] == "in":
            parts = parts[:-1]
    return Heading(text, "_".join(parts), unit)


_SD_BEFORE = re.compile(r"^(?:u|sd|std|sigma|unc|uncertainty|stddev|sig)_?(?P<of>.+)$")
_SD_AFTER = re.compile(r"^(?P<of>.+?)_?(?:sd|std|sigma|unc|uncertainty|stddev)$")


def sd_of(name: str, names: Container[str]) -> str | None:
    """Of these names the one whose sds stand under a name; None where there is none.

    >>> sd_of("u_x", {"x", "y"}), sd_of("x", {"x", "y"})
    ('x', None)
    """
    for form in (_SD_BEFORE, _SD_AFTER):
        match = form.match(name)
        if match and match["of"] in names and match["of"] != name:
            return match["of"]
    return None


_EXPANDED = re.compile(r"_?(?:95|k_?2|exp|expanded|2_?s(?:igma)?)(?=_|$)")


def expanded(name: str, names: Container[str]) -> bool:
    """Whether a name is that of the expanded uncertainty of one of these.

    >>> expanded("ux95", {"x", "y"}), expanded("u_x_k2", {"x"}), expanded("x95", {"x"})
    (True, True, False)
    """
    whole = _EXPANDED.sub("", name)
    return whole != name and sd_of(whole, names) is not None


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


# What stands below the readings: summaries.

_SUMMARY = tuple(f"{word}_" for word in words("rows", "summary"))


def readings_of(columns: Sequence[Sequence[str]], count: int) -> NDArray[np.intp]:
    """Positions of the rows that are no summary; columns: of text and ids, each (count,)."""
    last = count
    while last and any(f"{stem(cells[last - 1])}_".startswith(_SUMMARY) for cells in columns):
        last -= 1
    return np.arange(last)
