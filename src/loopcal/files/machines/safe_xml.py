"""XML files, read as data: no entity is expanded, no document type read, nothing fetched."""

from __future__ import annotations

import codecs
from io import BytesIO
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.reader import shown

MOST_BYTES, MOST_ELEMENTS = 20_000_000, 300_000
"""Meshes lie in files of their own, so that a robot is a few hundred kilobytes."""


def read_xml(path: str | Path, tag: str, remedy: str) -> Any:
    """The root element of an XML file, which is to be <tag>.

    remedy: what to do where the file is not of this kind. Raises InputError for what is no XML,
    of another kind, larger than 20 MB, of more than 300,000 elements, or has a document type.
    """
    from lxml import etree

    name, content = shown(path), _declared_first(content_of(path))
    # Without zero bytes UTF-16 and UTF-32 are searched alike, before any parser sees the file.
    if b"<!doctype" in content.replace(b"\0", b"").lower():
        raise _document_type(name)
    events = etree.iterparse(
        BytesIO(content),
        ("start",),
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
    )
    try:  # element by element: what holds too many takes no more memory than those
        if any(count >= MOST_ELEMENTS for count, _ in enumerate(events)):
            raise _too_large(name, f"has more than {MOST_ELEMENTS:,} elements")
        root = events.root
    except (etree.XMLSyntaxError, ValueError) as error:
        raise InputError(
            f"this is not XML: {error}", code="wrong-file-type", place=name, remedy=remedy
        ) from None
    if root.getroottree().docinfo.doctype:  # in an encoding that hid it
        raise _document_type(name)
    if local(root) != tag:
        raise InputError(
            f"this is XML of another kind: it describes <{local(root)}>, not <{tag}>",
            code="wrong-file-type",
            place=name,
            remedy=remedy,
        )
    return root


def local(element: Any) -> str:
    """The tag without its namespace; "" for comments."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def children(element: Any, tag: str) -> list[Any]:
    """The elements of this tag right below another."""
    return [child for child in element if local(child) == tag]


def at(element: Any, file: str) -> str:
    """Where an element stands, for messages."""
    return f"{file}, line {element.sourceline}"


def _document_type(name: str) -> InputError:
    return InputError(
        "this XML has a document type, which is refused because it can load or expand external "
        "content",
        code="wrong-file-type",
        place=name,
        remedy="delete <!DOCTYPE ...> from the file",
    )


def _declared_first(content: bytes) -> bytes:
    """The content with blank lines before its XML declaration put behind it; lines keep numbers."""
    # A parser refuses a declaration behind blank lines, though the rest is sound.
    bare = content.removeprefix(codecs.BOM_UTF8).lstrip()
    if not bare.startswith(b"<?xml"):
        return content
    blank, end = content[: len(content) - len(bare)], bare.find(b"?>") + 2
    return bare[:end] + b"\n" * blank.count(b"\n") + bare[end:]


def content_of(path: str | Path) -> bytes:
    """The bytes of an XML file. Raises InputError for one larger than 20 MB."""
    content = bytes_of(path, MOST_BYTES)
    if len(content) > MOST_BYTES:
        raise _too_large(shown(path), f"is larger than {MOST_BYTES // 1_000_000} MB")
    return content


def _too_large(name: str, how: str) -> InputError:
    return InputError(
        f"this file {how}, the limit for a robot",
        code="too-large",
        place=name,
        remedy="keep meshes in separate files",
    )
