"""Projects: read, begun from a template, and the schemas of their files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from loopcal.errors import UsageError, nearest
from loopcal.files.machines.python_function import load_function
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.project.templates import TEMPLATES
from loopcal.files.result import result_file

SCHEMAS = ("project", "result")


@dataclass(frozen=True)
class NewProject:
    """A project to start from: its files, the project file, and what to type next."""

    files: tuple[Path, ...]
    project: Path
    commands: tuple[str, ...]


def new_project(name: str, kind: str) -> NewProject:
    """Write a commented project with a mechanism of some type into a folder of this name.

    Raises UsageError for a type that is none, InputError where files are in the way.
    """
    if kind not in TEMPLATES:
        raise UsageError(
            f"there is no mechanism type {kind!r}",
            code="unknown-name",
            remedy=nearest(kind, TEMPLATES),
        )
    from loopcal.files.project.new_project import write_new_project

    files = write_new_project(name, kind)
    project = Path(name) / "project.toml"
    code = [path for path in files if path.suffix == ".py"]
    loops = f" --mechanism {quote(f'{code[0]}:loops')}" if code else ""
    at, poses = quote(str(project)), Path(name) / "poses.csv"
    truth = quote(str(poses.with_name("poses.truth.json")))
    commands = (
        f"loopcal simulate {at}{loops} --out {quote(str(poses))} --seed 1",
        f"loopcal calibrate {at}{loops} --truth {truth}",
    )
    return NewProject(files, project, commands)


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of "project" files or of "result" files."""
    if name == "project":
        from loopcal.files.project.project_schema import project_schema

        return project_schema()
    if name == "result":
        return result_file.result_schema()
    raise UsageError(
        f"there is no schema {name!r}", code="unknown-name", remedy=nearest(name, SCHEMAS)
    )


def named_project(path: str | Path, function: str | None) -> Project:
    """The project of a file; function: FILE.py:NAME of its loops, where they are Python code."""
    return read_project(path, mechanism=None if function is None else load_function(function))


def project_files(project: Project, function: str | None) -> dict[str, str]:
    """Names for the command lines of findings; empty where the project's file is not all of it."""
    return {} if project.path is None or function else {"project": str(project.path)}


def stored_files(project: Project, function: str | None, folder: Path) -> dict[str, str]:
    """The same with the result's folder, as they are typed in the project's folder.

    What is stored must not depend on the folder in which the command was typed.
    """
    if not project_files(project, function) or project.path is None:
        return {}
    result = os.path.relpath(folder, project.path.parent)
    return {"project": project.path.name, "result": Path(result).as_posix()}
