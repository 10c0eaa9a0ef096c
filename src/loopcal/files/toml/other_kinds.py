"""Files and folders that are named where a project belongs: what they are, and where they go."""

from __future__ import annotations

from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.tables.registry import BY_ENDING, READERS

_TABLES = {*BY_ENDING, *(ending for reader in READERS for ending in reader.relatives)}
_ROBOTS = (".urdf", ".xacro")


def refuse_other_kind(path: str | Path) -> None:
    """Raise InputError for what by its name is readings, a robot, a result or a folder."""
    path, name = Path(path), f"'{path}'" if " " in str(path) else str(path)
    ending = path.suffix.lower()
    result = path if path.is_dir() else path.parent
    if ending in _TABLES:
        words = "this is a table of readings"
        remedy = f"make a project of it: loopcal init {name} --urdf ROBOT.urdf, or --dh TABLE.csv"
    elif ending in _ROBOTS:
        words = "this is the description of a robot"
        remedy = f"make a project of it and of your readings: loopcal init READINGS --urdf {name}"
    elif (path.is_dir() or ending == ".json") and (result / "result.json").is_file():
        words = "this is the result of a calibration"
        remedy = "name the project that it came from; verify, predict, export and report take it"
    elif path.is_dir() and (path / "project.toml").is_file():
        words, remedy = "this is a folder", f"name the project in it: {path / 'project.toml'}"
    elif path.is_dir():
        words, remedy = "this is a folder", "name the project file in it"
    else:
        return
    raise InputError(
        f"{words}, not a project file", code="wrong-file-type", place=str(path), remedy=remedy
    )
