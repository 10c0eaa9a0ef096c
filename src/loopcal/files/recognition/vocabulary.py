"""The words of headers, from vocabulary.toml: what they mean, in several languages."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


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
