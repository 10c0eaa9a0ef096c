"""XML as its author wrote it: where start tags and attribute values stand in the text.

A parser says what a file means, and forgets how it was written. Here attribute values are found in
the text itself, so that single ones can be replaced and everything else stays byte for byte. The
text is known to be well-formed, without a document type (`safe_xml`).
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from loopcal.errors import InputError
from loopcal.files.programs.program import Place, Span, replaced

# Comments and CDATA come first: what looks like a tag inside them is none.
_TOKEN = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|</[^>]*>"
    r"|<(?P<tag>[^\s/>!?]+)(?P<inside>(?:[^\"'>]|\"[^\"]*\"|'[^']*')*)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"([^\s=/]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')", re.DOTALL)
# UTF-32 first: its little-endian mark begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


@dataclass(frozen=True)
class StartTag:
    """A start tag in a text: its tag as written, and where its parts stand.

    end: behind the tag and its blanks and attributes, ahead of "/>" or ">"; after: behind ">";
    values: attribute as written -> its value, without the quotes.
    """

    tag: str
    end: int
    after: int
    values: Mapping[str, Span]


@dataclass(frozen=True)
class XmlText:
    """The text of a file and the codec that makes its bytes again."""

    text: str
    codec: str

    @classmethod
    def of(cls, content: bytes, encoding: str | None, place: str) -> XmlText:
        """The text of a file; encoding: as its parser found it.

        Raises InputError where the bytes do not come back the same.
        """
        mark = next((codec for bytes_, codec in _MARKS if content.startswith(bytes_)), None)
        codec = mark or encoding or "utf-8"
        try:
            text = content.decode(codec)
            same = text.encode(codec) == content
        except (LookupError, UnicodeError):
            same = False
        if not same:
            raise InputError(
                f"the bytes of this file are not its text in {codec}, so that it cannot be patched "
                "in place",
                code="invalid-syntax",
                place=place,
                remedy="save it as UTF-8 and export again",
            )
        return cls(text, codec)

    def tags(self) -> Iterator[StartTag]:
        """Its start tags, in the order of the elements."""
        for match in _TOKEN.finditer(self.text):
            if match["tag"] is None:
                continue
            inside, begin = match["inside"], match.start("inside")
            end = begin + len(inside.removesuffix("/").rstrip())
            values = {
                a[1]: Span(*(begin + place for place in a.span(2 if a[2] is not None else 3)))
                for a in _ATTRIBUTE.finditer(inside)
            }
            yield StartTag(match["tag"], end, match.end(), values)

    def edited(self, edits: Sequence[Place]) -> bytes:
        """The bytes with the edits made."""
        return replaced(self.text, Span(0, len(self.text)), edits).encode(self.codec)
