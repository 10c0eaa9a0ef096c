"""Whether the files of a result belong together: result.json states the SHA-256 of the others."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

from loopcal.errors import InputError

RESULT, MACHINE, RESIDUALS = "result.json", "mechanism.toml", "residuals.csv"


def refuse_stale(path: str | Path, stated: Mapping[str, str] | None = None) -> None:
    """Raise InputError for a mechanism.toml or residuals.csv of another result.json than that
    beside it.

    stated: name -> SHA-256, as that result.json has them. Files may have got other line ends since.
    """
    path = Path(path)
    if path.name not in (MACHINE, RESIDUALS) or not path.is_file():
        return
    digest = (_stated(path.with_name(RESULT)) if stated is None else stated).get(path.name)
    if digest is None:
        return
    content = path.read_bytes()
    if digest not in (sha256(c).hexdigest() for c in (content, content.replace(b"\r\n", b"\n"))):
        raise InputError(
            f"it does not belong to {RESULT} beside it: its SHA-256 differs, because a run was "
            "interrupted or one of them was changed",
            code="version-mismatch",
            place=str(path),
            remedy="calibrate again, or restore the files of one calibration",
        )


def _stated(result: Path) -> Mapping[str, str]:
    try:
        return dict(json.loads(result.read_bytes())["files"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}  # there is none, or its reader says what is wrong
