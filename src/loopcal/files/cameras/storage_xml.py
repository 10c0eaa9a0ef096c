"""FileStorage of OpenCV as XML, as the plain data that its YAML and JSON hold."""

from __future__ import annotations

from typing import Any
from xml.parsers import expat

_ROOT = "opencv_storage"
_NO_KEY = "_"
"""How OpenCV names the items of a list."""


def is_storage(text: str) -> bool:
    """Whether a text is a FileStorage in XML."""
    return f"<{_ROOT}" in text[:1000]


def read_storage(text: str, most: int, deepest: int) -> Any:
    """Its mappings, lists and scalars; these are texts.

    Raises ValueError, in words, for text that is no XML, for a document type, which could declare
    entities, and for more elements or levels than these.
    """
    opened: list[tuple[list[tuple[str, Any]], list[str]]] = [([], [])]
    count = 0
    parser = expat.ParserCreate()

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > most or len(opened) > deepest:
            raise ValueError(f"it holds more than {most:,} values or {deepest} levels")
        opened.append(([], []))

    def end(name: str) -> None:
        inside, texts = opened.pop()
        opened[-1][0].append((name, _value(inside, "".join(texts))))

    def refuse(*declared: Any) -> None:
        raise ValueError("it declares a document type")

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = lambda some: opened[-1][1].append(some)
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"line {error.lineno}: {expat.ErrorString(error.code)}") from None
    return opened[0][0][0][1]


def _value(inside: list[tuple[str, Any]], text: str) -> Any:
    if not inside:
        words = text.split()
        return words if len(words) > 1 and not text.lstrip().startswith('"') else text.strip()
    if all(name == _NO_KEY for name, _ in inside):
        return [value for _, value in inside]
    made = dict(inside)
    if isinstance(made.get("data"), str):  # of a matrix with one number
        made["data"] = [made["data"]]
    return made
