"""What a command may be given to keep what it judged, beside the files that it writes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol

from loopcal.document.result_document import ResultDocument
from loopcal.files.atomic import Data
from loopcal.measurements.days import Days
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.verified import Verification


class Writer(Protocol):
    """Writes files and removes others, all or none, as `files.atomic.write_all` does."""

    def __call__(self, files: Mapping[Path, Data], *, remove: Iterable[Path] = ()) -> object:
        """Raises InputError where anything cannot be written."""


class Keeper(Protocol):
    """Keeps calibrations and verifications of a machine, such as its history."""

    def refuse(self) -> None:
        """Raise InputError, before any work, where nothing can be kept."""

    def of_calibration(
        self, document: ResultDocument, calibrated: Calibrated, path: Path
    ) -> Writer:
        """Writes the files of a calibration and keeps it with them; path: of its result.json."""

    def of_verification(
        self,
        verification: Verification,
        result: str | Path,
        readings: str | Path,
        measured: Days | None,
    ) -> Writer:
        """Writes the files of a verification and keeps it with them; measured: by its readings."""

    def note(self, result: str | Path) -> None:
        """Tell a result what is kept of its machine."""
