"""The kinds of numbers that result.json holds. All are finite: unknown is null."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Le

Count = Annotated[int, Ge(0)]
Size = Annotated[float, Ge(0)]
Probability = Annotated[float, Ge(0), Le(1)]
