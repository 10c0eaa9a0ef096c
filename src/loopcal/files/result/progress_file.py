"""How far an interrupted calibration came: where its last iteration began."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from loopcal.estimation.solve.checkpoint import Checkpoint
from loopcal.files.atomic import write_atomic

NAME = "unfinished.json"


class ProgressFile:
    """unfinished.json in the folder of a result; it is there only while a calibration runs.

    task: whatever makes it this calibration and no other (the project, its data, the method).
    """

    def __init__(self, folder: str | Path, task: Mapping[str, Any]) -> None:
        self.path = Path(folder) / NAME
        self.key = sha256(json.dumps(task, sort_keys=True, default=str).encode()).hexdigest()

    def read(self) -> Checkpoint[bool] | None:
        """The checkpoint that this very calibration had reached; None without any."""
        try:
            content = json.loads(self.path.read_text("utf-8"))
            return Checkpoint.read(content["checkpoint"]) if content["task"] == self.key else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def present(self) -> bool:
        """Whether there is such a file, of whatever calibration."""
        return self.path.is_file()

    def write(self, reached: Checkpoint[bool]) -> None:
        """Keep a checkpoint. Raises InputError where it cannot be written."""
        document = {"task": self.key, "checkpoint": reached.document()}
        write_atomic(self.path, json.dumps(document, indent=1) + "\n")

    def remove(self) -> None:
        """Nothing is unfinished any more."""
        self.path.unlink(missing_ok=True)
