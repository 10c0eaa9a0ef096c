"""Documentation as a program: the fenced blocks of a Markdown file, run in order.

    ```python                 runs, in one namespace per file; `>>>` prompts are checked as doctests
    ```python no-run          does not run; its first line must be `# not run: REASON`
    ```toml file=arm.toml     is written to that file (any language, also python)
    ```console                `$ loopcal ...` runs; the lines below it are its stdout, `...` matches
                              anything, and no line at all leaves the output unchecked
    ```console data           as above, where the measured data are at hand
    ```console exit=3         as above, where the last command must end with that exit code; the
                              lines below are what it prints on stdout and stderr

Everything happens in a folder of its own, which holds a copy of the project's `examples`: the
reader stands in a fresh clone.
"""

from __future__ import annotations

import doctest
import re
import shlex
import subprocess
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests import command_line

FENCE = re.compile(r"^(?P<indent> *)(?P<ticks>`{3,}|~{3,})(?P<info>[^`]*)$")
SHELL = re.compile(r"[|<>&;$*?`]")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


class WrongDocumentation(AssertionError):
    """A block that does not do what the text around it says."""


@dataclass(frozen=True)
class Block:
    """One fenced block: `source:line` of its first line of text, its language and its options."""

    source: Path
    line: int
    language: str
    options: dict[str, str]
    text: str

    @property
    def place(self) -> str:
        return f"{self.source}:{self.line}"


@dataclass(frozen=True)
class Command:
    """A line typed at the prompt, and what the document says is printed below it."""

    line: int
    typed: str
    printed: str


def blocks(source: Path) -> Iterator[Block]:
    """The fenced blocks of a Markdown file, from the top."""
    lines = iter(enumerate(source.read_text("utf-8").splitlines(), start=1))
    for number, line in lines:
        opening = FENCE.match(line)
        if opening is None:
            continue
        body = []
        for _, inner in lines:
            closing = FENCE.match(inner)
            if closing and closing["ticks"].startswith(opening["ticks"]) and not closing["info"]:
                break
            body.append(inner)
        else:
            raise WrongDocumentation(f"{source}:{number}: this block is never closed")
        language, *options = opening["info"].split() or [""]
        pairs = (option.partition("=") for option in options)
        text = textwrap.dedent("\n".join(body)) + "\n"
        yield Block(source, number + 1, language, {key: value for key, _, value in pairs}, text)


def commands(block: Block) -> Iterator[Command]:
    """The commands of a console block; a backslash at the end of a line continues it."""
    # Each starts at a prompt; the text before the first prompt belongs to none.
    starts = [match.start() for match in re.finditer(r"^\$ ", block.text, re.MULTILINE)]
    for start, end in zip(starts, [*starts[1:], len(block.text)], strict=True):
        line = block.line + block.text.count("\n", 0, start)
        typed, _, printed = block.text[start + 2 : end].replace("\\\n", " ").partition("\n")
        yield Command(line, typed, printed.rstrip())


def run_file(source: Path, folder: Path, *, measured: bool = False) -> None:
    """Run the blocks of `source` in `folder`, which must be the current one; measured: whether the
    measured data are at hand."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(source):
        if "file" in block.options:
            target = folder / block.options["file"]
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, "utf-8")
        elif block.language == "python":
            run_python(block, namespace)
        elif block.language == "console" and ("data" not in block.options or measured):
            run_console(block, folder)


def run_python(block: Block, namespace: dict[str, Any]) -> None:
    if "no-run" in block.options:
        if not re.match(r"# not run: \w+", block.text):
            raise WrongDocumentation(f"{block.place}: begin with '# not run: ' and the reason")
    elif re.search(r"^>>> ", block.text, re.MULTILINE):
        run_prompts(block, namespace)
    else:
        # Blank lines above, so that a traceback points into the Markdown file.
        code = "\n" * (block.line - 1) + block.text
        exec(compile(code, str(block.source), "exec"), namespace)


def run_prompts(block: Block, namespace: dict[str, Any]) -> None:
    test = doctest.DocTestParser().get_doctest(
        block.text, namespace, block.source.name, str(block.source), block.line - 1
    )
    told: list[str] = []
    results = doctest.DocTestRunner(optionflags=FLAGS).run(test, out=told.append, clear_globs=False)
    namespace.update(test.globs)
    if results.failed:
        raise WrongDocumentation(f"{block.place}\n{''.join(told)}")


def run_console(block: Block, folder: Path) -> None:
    every = list(commands(block))
    for command in every:
        if not command.typed.startswith("loopcal"):
            continue
        ends_with = int(block.options.get("exit", 0)) if command is every[-1] else 0
        done = typed(command.typed, folder, together=bool(ends_with))
        place = f"{block.source}:{command.line}: $ {command.typed}"
        if done.returncode != ends_with:
            told = f"{done.stdout}{done.stderr or ''}"
            raise WrongDocumentation(f"{place}\nends with {done.returncode}:\n{told}")
        if command.printed and not alike(command.printed, done.stdout):
            raise WrongDocumentation(
                f"{place}\nthe document shows:\n{command.printed}\nit prints:\n{done.stdout}"
            )


def typed(line: str, folder: Path, *, together: bool) -> subprocess.CompletedProcess[str]:
    """What a line at the prompt leaves, stdout and stderr `together` where they are shown so.

    A plain command runs in this process, which has loaded already what it needs.
    """
    program, *arguments = shlex.split(line)
    if program != "loopcal" or SHELL.search(line):
        return subprocess.run(
            line,
            shell=True,
            cwd=folder,
            env=command_line.environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if together else subprocess.PIPE,
            encoding="utf-8",
            timeout=300,
            check=False,
        )
    return command_line.run_here(*arguments, cwd=folder, together=together)


def alike(shown: str, printed: str) -> bool:
    """Whether the two texts are equal, but for trailing blanks and what `...` stands for."""
    want, got = (
        "\n".join(line.rstrip() for line in text.rstrip().splitlines()) for text in (shown, printed)
    )
    return doctest.OutputChecker().check_output(want, got, doctest.ELLIPSIS)
