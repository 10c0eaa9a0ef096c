"""What a release consists of: its files parse, agree on the version, and run on every system."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
POSIX_NAMES = {
    *("fork", "forkpty", "getuid", "geteuid", "getpgid", "killpg", "mkfifo", "nice", "setsid"),
    *("O_NONBLOCK", "O_DIRECTORY", "sched_getaffinity", "sysconf", "wait4", "waitid", "uname"),
    *("SIGALRM", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGUSR1", "SIGUSR2", "pthread_sigmask"),
}
# Windows has no named pipe that is a file, and forks on Linux alone are asked for
# (`process_cores`).
GUARDED = {
    ("files/tables/raw.py", "O_NONBLOCK"),
    *(("execution/forked.py", name) for name in ("fork", "SIGKILL", "pthread_sigmask", "waitid")),
}


def parsed(workflow: Path) -> dict[str, Any]:
    yaml = pytest.importorskip("yaml", reason="PyYAML is absent; `make partners` installs it")
    found: dict[str, Any] = yaml.safe_load(workflow.read_text("utf-8"))
    return found


@pytest.mark.skipif(not WORKFLOWS, reason="the sources were distributed without .github")
def test_workflows_parse_pin_their_actions_and_may_only_read() -> None:
    for workflow in WORKFLOWS:
        content = parsed(workflow)
        assert content["permissions"] == {"contents": "read"}, workflow.name
        for name, job in content["jobs"].items():
            assert job["timeout-minutes"] <= 60, name
            for step in job["steps"]:
                assert ("uses" in step) != ("run" in step), step
                assert re.fullmatch(
                    r"[\w-]+/[\w-]+@[0-9a-f]{40}", step.get("uses", "a/b@" + "0" * 40)
                )


@pytest.mark.skipif(not WORKFLOWS, reason="the sources were distributed without .github")
def test_the_suite_runs_on_three_systems_and_every_stated_python() -> None:
    matrix = parsed(ROOT / ".github/workflows/test.yml")["jobs"]["suite"]["strategy"]["matrix"]
    assert {system.split("-")[0] for system in matrix["os"]} == {"ubuntu", "macos", "windows"}
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["classifiers"]
    assert [f"Programming Language :: Python :: {v}" in stated for v in matrix["python"]] == [
        True
    ] * 3


def test_version_changelog_and_citation_agree() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    latest = re.search(r"^## (\d+\.\d+\.\d+)", changes, re.M)
    assert latest is not None
    assert latest[1] == VERSION
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


def test_the_citation_is_a_citation() -> None:
    content = parsed(ROOT / "CITATION.cff")
    assert {"cff-version", "message", "title", "authors", "version"} <= set(content)
    assert content["references"][0]["year"] == 1995


def test_the_trust_boundary_names_every_kind_of_input() -> None:
    told = (ROOT / "SECURITY.md").read_text("utf-8")
    for kind in ("CSV", "XLSX", "Parquet", "MATLAB", "TOML", "JSON", "URDF", "Python", "cluster"):
        assert kind in told, kind


def posix_only(text: str, name: str) -> list[str]:
    """POSIX-only names used without a guard, and POSIX-only modules imported at import time."""
    tree = ast.parse(text)
    found = []
    for node in tree.body:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name in POSIX_MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module in POSIX_MODULES:
            found.append(node.module)
    for used in ast.walk(tree):
        if isinstance(used, ast.Attribute) and isinstance(used.value, ast.Name):
            of_posix = used.value.id in ("os", "signal") and used.attr in POSIX_NAMES
            if of_posix and (name, used.attr) not in GUARDED:
                found.append(used.attr)
    return found


def test_nothing_runs_on_one_family_of_systems_only() -> None:
    source = ROOT / "src" / "loopcal"
    found = {
        name: calls
        for path in sorted(source.rglob("*.py"))
        if (
            calls := posix_only(
                path.read_text("utf-8"), name := path.relative_to(source).as_posix()
            )
        )
    }
    assert found == {}


def test_a_call_of_posix_alone_is_found() -> None:
    assert posix_only("import os\nos.fork()", "a.py") == ["fork"]
    assert posix_only("import resource", "a.py") == ["resource"]
    assert posix_only("def f():\n    import resource", "a.py") == []


def test_what_is_distributed_is_named_from_the_root() -> None:
    """A folder named tests or src anywhere else, as in an environment, does not belong to it."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["scikit-build"]
    folders = [name for name in settings["sdist"]["include"] if "." not in name]
    assert all(name.startswith("/") or name == "Makefile" for name in folders)
