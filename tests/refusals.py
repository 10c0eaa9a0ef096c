"""Errors as tests expect them: their code, and the names, values and places that they state."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from loopcal.errors import Code, LoopcalError


@contextmanager
def refused(code: Code, *stated: str) -> Iterator[pytest.ExceptionInfo[LoopcalError]]:
    """Expect an error of this code whose text states all of these; the wording is free."""
    with pytest.raises(LoopcalError) as caught:
        yield caught
    assert caught.value.code == code, str(caught.value)
    for text in stated:
        assert text in caught.value.text
