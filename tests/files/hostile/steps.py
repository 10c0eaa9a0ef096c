"""Steps of a backtracking search, counted: what a pattern costs, without a clock.

`steps` matches as Python's `re` does, character by character, and counts each character that it
compares and each choice that it takes back.
"""

from __future__ import annotations

import re
import re._constants as c  # type: ignore[import-not-found]
import re._parser as parser  # type: ignore[import-not-found]
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_CATEGORIES = {
    c.CATEGORY_DIGIT: str.isdecimal,
    c.CATEGORY_SPACE: str.isspace,
    c.CATEGORY_WORD: lambda letter: letter.isalnum() or letter == "_",
}
_NEGATED = {
    c.CATEGORY_NOT_DIGIT: c.CATEGORY_DIGIT,
    c.CATEGORY_NOT_SPACE: c.CATEGORY_SPACE,
    c.CATEGORY_NOT_WORD: c.CATEGORY_WORD,
}
_ONE = (c.LITERAL, c.NOT_LITERAL, c.IN, c.ANY)


@dataclass(frozen=True)
class Steps:
    """spans: begin and end of every match; count: of the steps that find them."""

    spans: list[tuple[int, int]]
    count: int


def steps(pattern: re.Pattern[Any], text: str, *, anchored: bool = False) -> Steps:
    """All searches of `finditer` in a text; anchored: that of `match` alone."""
    counter = _Counter(pattern, text)
    at, found = 0, []
    while at <= len(text):
        end = next(counter.match(counter.nodes, 0, at), None)
        if end is not None:
            found.append((at, end))
        if anchored:
            break
        at = at + 1 if end is None or end == at else end
    return Steps(found, counter.steps)


class _Counter:
    def __init__(self, pattern: re.Pattern[Any], text: str) -> None:
        source = pattern.pattern if isinstance(pattern.pattern, str) else pattern.pattern.decode()
        flags = pattern.flags & ~re.UNICODE if isinstance(pattern.pattern, bytes) else pattern.flags
        self.nodes = [*parser.parse(source, flags & ~re.ASCII & ~re.UNICODE)]
        self.fold = bool(pattern.flags & re.IGNORECASE)
        self.lines = bool(pattern.flags & re.MULTILINE)
        self.all = bool(pattern.flags & re.DOTALL)
        self.text = text.lower() if self.fold else text
        self.groups: dict[int, str] = {}
        self.steps = 0

    def match(self, nodes: list[Any], i: int, at: int) -> Iterator[int]:
        """Where the nodes from the i-th on end that begin at a place, the preferred end first."""
        if i == len(nodes):
            yield at
            return
        kind, value = nodes[i]
        if kind in _ONE:
            self.steps += 1
            if at < len(self.text) and self.fits(kind, value, self.text[at]):
                yield from self.match(nodes, i + 1, at + 1)
        elif kind in (c.MAX_REPEAT, c.MIN_REPEAT, c.POSSESSIVE_REPEAT):
            least, most, part = value
            for end in self.repeated(kind, least, most, part, at):
                yield from self.match(nodes, i + 1, end)
        elif kind is c.SUBPATTERN:
            for end in self.match([*value[3]], 0, at):
                if value[0] is not None:
                    self.groups[value[0]] = self.text[at:end]
                yield from self.match(nodes, i + 1, end)
        elif kind is c.BRANCH:
            for branch in value[1]:
                for end in self.match([*branch], 0, at):
                    yield from self.match(nodes, i + 1, end)
        elif kind is c.ATOMIC_GROUP:
            own = next(self.match([*value], 0, at), None)
            if own is not None:
                yield from self.match(nodes, i + 1, own)
        elif kind in (c.ASSERT, c.ASSERT_NOT):
            direction, part = value
            if self.seen(direction, part, at) == (kind is c.ASSERT):
                yield from self.match(nodes, i + 1, at)
        elif kind is c.GROUPREF:
            again = self.groups.get(value, "")
            self.steps += len(again)
            if self.text.startswith(again, at):
                yield from self.match(nodes, i + 1, at + len(again))
        elif kind is c.AT:
            self.steps += 1
            if self.placed(value, at):
                yield from self.match(nodes, i + 1, at)
        else:
            raise AssertionError(f"the matcher of this test knows no {kind}")

    def repeated(self, kind: Any, least: int, most: Any, part: Any, at: int) -> Iterator[int]:
        nodes = [*part]
        limit = len(self.text) + 1 if most is c.MAXREPEAT else int(most)
        if kind is c.MIN_REPEAT:
            yield from self.lazy(nodes, least, limit, at)
        elif kind is c.POSSESSIVE_REPEAT:
            end = next(self.greedy(nodes, least, limit, at), None)
            if end is not None:
                yield end
        else:
            yield from self.greedy(nodes, least, limit, at)

    def greedy(self, nodes: list[Any], least: int, limit: int, at: int) -> Iterator[int]:
        ends = [(at, iter(()))]
        current = self.match(nodes, 0, at) if limit else iter(())
        while True:  # deeper while the part matches, then back out, end by end
            end = next(current, None) if len(ends) <= limit else None
            if end is not None and end > ends[-1][0]:
                ends.append((end, current))  # type: ignore[arg-type]
                current = self.match(nodes, 0, end)
                continue
            if len(ends) > least:
                self.steps += 1
                yield ends[-1][0]
            if len(ends) == 1:
                return
            current = ends.pop()[1]

    def lazy(self, nodes: list[Any], least: int, limit: int, at: int) -> Iterator[int]:
        if not least:
            self.steps += 1
            yield at
        for end in self.match(nodes, 0, at) if limit else ():
            if end > at:
                yield from self.lazy(nodes, max(least - 1, 0), limit - 1, end)

    def seen(self, direction: int, part: Any, at: int) -> bool:
        nodes = [*part]
        begin = at if direction > 0 else at - parser.SubPattern(part.state, nodes).getwidth()[0]
        return begin >= 0 and next(self.match(nodes, 0, begin), None) is not None

    def placed(self, where: Any, at: int) -> bool:
        text = self.text
        word = _CATEGORIES[c.CATEGORY_WORD]
        if where in (c.AT_BOUNDARY, c.AT_NON_BOUNDARY):
            before, after = (at > 0 and word(text[at - 1])), (at < len(text) and word(text[at]))
            return (before != after) == (where is c.AT_BOUNDARY)
        if where in (c.AT_BEGINNING, c.AT_BEGINNING_STRING):
            line = self.lines and where is c.AT_BEGINNING and at > 0 and text[at - 1] == "\n"
            return at == 0 or line
        line = self.lines and where is c.AT_END and at < len(text) and text[at] == "\n"
        return at == len(text) or line

    def fits(self, kind: Any, value: Any, letter: str) -> bool:
        if kind is c.ANY:
            return self.all or letter != "\n"
        if kind is c.IN:
            return self.among(value, letter)
        same = (chr(value).lower() if self.fold else chr(value)) == letter
        return same == (kind is c.LITERAL)

    def among(self, choices: list[Any], letter: str) -> bool:
        negated = choices[0][0] is c.NEGATE
        found = False
        for kind, value in choices:
            if kind is c.LITERAL:
                found |= (chr(value).lower() if self.fold else chr(value)) == letter
            elif kind is c.RANGE:
                found |= any(value[0] <= ord(x) <= value[1] for x in {letter, letter.upper()})
            elif kind is c.CATEGORY:
                its = _CATEGORIES.get(value)
                found |= its(letter) if its else not _CATEGORIES[_NEGATED[value]](letter)
        return found != negated
