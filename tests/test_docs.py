"""The documentation is true: its code runs, its commands print what it shows, its links lead on."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from analyses.layouts import World, described, ids, joints, written, xyz
from tests import documentation
from tests.documentation import WrongDocumentation, blocks, run_file

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)[^)]*\)")


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to run documentation in, with the examples beside it; the current one meanwhile."""
    if (ROOT / "examples").is_dir():
        ignored = shutil.ignore_patterns("__pycache__", "results")
        shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=ignored)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        # Another page may write another file of the same name.
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


def page_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_the_code_runs_and_prints_what_is_shown(
    page: Path, clone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page.name == "from-ros.md":
        pytest.importorskip("rosbags", reason="rosbags is not installed (loopcal[bags])")
    if page == README:
        files_of_a_reader(clone)
    data = Path(os.environ.get("LOOPCAL_DATA") or ROOT.parent / "shared" / "data")
    monkeypatch.setenv("LOOPCAL_DATA", str(data))
    run_file(page, clone, measured=data.is_dir())


def files_of_a_reader(folder: Path) -> None:
    """What README takes for granted: joints.csv and tracker.csv of a robot, and its URDF."""
    world = World("six", 1)
    described(world, folder)
    written(folder / "joints.csv", {"pose": ids(world), **joints(world)})
    written(folder / "tracker.csv", {"pose": ids(world), **xyz("{}", world.points)})


ELSEWHERE = {
    "loopcal study examples/seed/study.toml --out seed-study": "studies/test_seed.py",
    "python examples/seed/table_12.py": "test_examples.py",
    "loopcal app cell": "app/test_path.py",
    "loopcal calibrate project.toml --method implicit-loop --folds 10": "app/test_path.py",
}
"""Commands of README and tutorials that do not run in their page, and the test that runs them."""


def test_every_command_of_readme_and_tutorials_runs() -> None:
    pages = [README, *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
    texts = [
        b.text for page in pages for b in blocks(page) if b.language not in ("console", "python")
    ]
    lines = {line for text in texts for line in text.splitlines() if line}
    assert {line for line in lines if not line.startswith("pip install ")} == set(ELSEWHERE)
    assert [name for name in ELSEWHERE.values() if not (ROOT / "tests" / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_the_links_lead_to_files(page: Path) -> None:
    targets = LINK.findall(page.read_text("utf-8"))
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_named_analyses_can_be_run(page: Path) -> None:
    """Only as modules: some import their neighbours, and tests' references."""
    text = page.read_text("utf-8")
    assert "python analyses/" not in text
    named = re.findall(r"python -m analyses\.(\w+)", text)
    assert [name for name in named if not (ROOT / "analyses" / f"{name}.py").exists()] == []


def test_a_record_that_a_source_names_stands_in_the_index() -> None:
    index = (ROOT / "docs/decisions/README.md").read_text("utf-8")
    records = {path.name[:4] for path in (ROOT / "docs/decisions").glob("0*.md")}
    assert set(re.findall(r"\[(\d{4})\]", index)) == records
    sources = [p for part in ("src", "engine", "tests") for p in (ROOT / part).rglob("*.*")]
    texts = {p: p.read_text("utf-8") for p in sources if p.suffix in (".py", ".js", ".cpp", ".hpp")}
    named = re.compile(r"(?:[Rr]ecord |docs/decisions/)(\d{4})")
    named_in = [(p.name, n) for p, text in texts.items() for n in named.findall(text)]
    assert len(named_in) > 50
    assert [(name, number) for name, number in named_in if number not in records] == []


@pytest.mark.parametrize(
    "text",
    [
        "```python\na = 1\n```\ntext\n```python\nassert a == 1\n```\n",
        "```python\n>>> b = 3\n>>> b + 1\n4\n```\n```python\nassert b == 3\n```",
        "```csv file=data/a.csv\nx,y\n```\n```python\nimport os\nos.stat('data/a.csv')\n```",
        "```python file=loop.py\ndef f():\n    return 1\n```\n```python\nfrom loop import f\n```",
        "```python no-run\n# not run: it needs the instrument\nmeasure()\n```",
        "```text\n$ loopcal no-such-command\n```",
        "1. A list\n   ```python\n   a = [\n       1,\n   ]\n   ```\n",
        "````markdown\n```python\nassert False\n```\n````\n",
        "```console\n$ make demo\nnot looked at\n```",
    ],
)
def test_true_documentation_passes(text: str, clone: Path) -> None:
    (clone / "page.md").write_text(text, "utf-8")
    run_file(clone / "page.md", clone)


@pytest.mark.parametrize(
    "text",
    [
        "```python\n>>> 1 + 1\n3\n```\n",
        "```python no-run\nmeasure()\n```",
        "```python\na = 1\n",
        "```console\n$ loopcal no-such-command\n```",
        "```console\n$ loopcal-no-such-program\n```",
    ],
)
def test_false_documentation_does_not(text: str, clone: Path) -> None:
    (clone / "page.md").write_text(text, "utf-8")
    with pytest.raises(WrongDocumentation):
        run_file(clone / "page.md", clone)


def test_a_fault_in_a_page_is_reported_at_its_line(clone: Path) -> None:
    (clone / "page.md").write_text("# Title\n\n```python\na = 1\nb = a / 0\n```\n", "utf-8")
    with pytest.raises(ZeroDivisionError) as caught:
        run_file(clone / "page.md", clone)
    assert caught.traceback[-1].lineno + 1 == 5


@pytest.fixture
def fake_loopcal(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A `loopcal` that prints three lines, so that the comparison itself is tested.

    Always by the shell: `loopcal` in this process is the real one.
    """
    monkeypatch.setattr(documentation, "SHELL", re.compile(""))
    program = clone / "bin" / "loopcal"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\nprintf 'one\\ntwo  \\nthree\\n'\necho note >&2\nexit ${1:-0}\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program.with_name("python")))


@pytest.mark.usefixtures("fake_loopcal")
@pytest.mark.parametrize(
    "text",
    [
        "```console\n$ loopcal\none\ntwo\nthree\n```\n",
        "```console\n$ loopcal\none\n...\nthree\n$ loopcal | wc -l\n3\n```\n",
        "```console\n$ loopcal \\\n    0\none\n...\n```\n",
        "```console\n$ loopcal\n```\n",
        "```console exit=3\n$ loopcal 3\none\ntwo\nthree\nnote\n```\n",
    ],
)
def test_a_shown_session_that_is_true_passes(text: str, clone: Path) -> None:
    (clone / "page.md").write_text(text, "utf-8")
    run_file(clone / "page.md", clone)


@pytest.mark.usefixtures("fake_loopcal")
@pytest.mark.parametrize(
    "text",
    [
        "```console\n$ loopcal\none\ntwo\nfour\n```\n",
        "```console\n$ loopcal\none\nthree\n```\n",
        "```console\n$ loopcal 3\n```\n",
        "```console exit=3\n$ loopcal 0\n```\n",
    ],
)
def test_a_shown_session_that_is_false_does_not(text: str, clone: Path) -> None:
    (clone / "page.md").write_text(text, "utf-8")
    with pytest.raises(WrongDocumentation):
        run_file(clone / "page.md", clone)
