"""A project as `init` understood it, ready to be written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from loopcal.files.toml.writer import document
from loopcal.measurements.dataset import Dataset

PROJECT, READINGS = "project.toml", "readings.csv"
HEAD = "Written by loopcal init. Paths are relative to this file; change whatever is wrong."


@dataclass(frozen=True, eq=False)
class Begun:
    """What was understood: the tables of the project file, the files beside it, what was found in
    words, the readings, and in a line how many there are."""

    tables: Mapping[str, Any]
    beside: Mapping[str, bytes]
    remarks: tuple[str, ...]
    dataset: Dataset
    words: str

    @property
    def text(self) -> str:
        """Of the project file."""
        return document(self.tables, (HEAD,), {"data": self.remarks})
