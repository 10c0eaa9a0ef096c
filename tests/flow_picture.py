"""The picture of `docs/explanation/how-a-calibration-flows.md`, drawn from what the code is.

Each step names functions of the source; its folders follow from them. `tests/test_flow.py` holds
the steps to the code and the drawing to the file. After a change that is meant, draw it again:

    LOOPCAL_REMAKE_GOLDEN=1 python -m pytest tests/test_flow.py
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cached_property
from html import escape
from operator import attrgetter
from typing import Any

WIDTH, TOP, PITCH, BOX = 700, 52, 62, 30
LEFT, WIDE, BESIDE = 16, 112, 452
"""Of the boxes, and where the companions begin."""


@dataclass(frozen=True)
class Value:
    """What passes from one step to the next, and its type, MODULE:NAME."""

    word: str
    type: str


@dataclass(frozen=True)
class Step:
    """What leads from a value to the next: functions, MODULE:NAME, the first of them last to end.

    also: folders that take part by what these functions are handed.
    """

    words: str
    functions: tuple[str, ...]
    also: tuple[str, ...] = ()

    @cached_property
    def folders(self) -> tuple[str, ...]:
        """Where the functions are."""
        modules = (name.partition(":")[0].split(".") for name in self.functions)
        return tuple(dict.fromkeys([*("/".join(module[1:-1]) for module in modules), *self.also]))


VALUES = (
    Value("bytes", "typing:BinaryIO"),
    Value("table", "loopcal.files.tables.table:Table"),
    Value("data set", "loopcal.measurements.dataset:Dataset"),
    Value("problem", "loopcal.estimation.problem.problem:Problem"),
    Value("fit", "loopcal.estimation.result:FitResult"),
    Value("facts", "loopcal.document.verdict:Fact"),
    Value("findings", "loopcal.document.verdict:Finding"),
    Value("verdict", "loopcal.document.verdict:Verdict"),
    Value("document", "loopcal.document.result_document:ResultDocument"),
    Value("words, pages", "builtins:str"),
)
STEPS = (
    Step(
        "A reader finds the columns.",
        ("loopcal.files.tables.readers:_table", "loopcal.files.tables.raw:read_text"),
    ),
    Step("Columns get names, units and ids.", ("loopcal.files.tables.readers:dataset_of",)),
    Step(
        "{steps}.",
        (
            "loopcal.estimation.steps:examined",
            "loopcal.estimation.steps:prepared",
            "loopcal.estimation.steps:placed",
            "loopcal.estimation.steps:State",
            "loopcal.estimation.steps:State.problem",
        ),
    ),
    Step(
        "Least corrections close all loops.",
        (
            "loopcal.estimation.calibrate:_result",
            "loopcal.estimation.solve.solver:solve",
            "loopcal.estimation.noise.estimation:estimate_noise",
        ),
    ),
    Step(
        "Analyses state code, numbers and place.",
        ("loopcal.statistics.findings:findings", "loopcal.statistics.sound:SOUND"),
    ),
    Step("Catalogue rows add severity and remedy.", ("loopcal.document.catalogue:findings",)),
    Step("The gravest finding answers each question.", ("loopcal.document.verdict:Verdict.of",)),
    Step(
        "All of it becomes one typed value.",
        ("loopcal.statistics.verdict:judged", "loopcal.document.result_document:ResultDocument"),
    ),
    Step(
        "It is rendered, and never judged again.",
        ("loopcal.files.result.result_file:result_json", "loopcal.report.page:report_html"),
        ("figures",),
    ),
)
COMPANIONS = {
    "Which poses to measure": ("companions/planning",),
    "Many simulated draws": ("companions/studies",),
    "The life of a machine": ("companions/life",),
    "Formats of controllers": ("companions/robot/exports",),
    "Corrected robot programs": ("companions/robot",),
    "Pose performance, ISO 9283": ("companions/performance",),
    "A record to sign": ("companions/record",),
    "The app runs command lines": ("companions/app",),
}
"""What stands beside the core: it takes the core's values, and the core never imports it."""
BELOW = ("expressions", "mechanisms", "measurements", "simulation", "execution", "presentation")
ABOVE = ("cli", "workflow")
STYLE = """
svg { --ink: #1c1e21; --quiet: #5c6068; --line: #8d8f96; --page: #fff; --box: #eef3f8 }
@media (prefers-color-scheme: dark) {
  svg { --ink: #e8eaed; --quiet: #a9adb5; --line: #7d818a; --page: #16181b; --box: #24303c }
}
text { fill: var(--ink) } .quiet { fill: var(--quiet); font-size: 12px }
.page { fill: var(--page) } .box { fill: var(--box); stroke: var(--line) }
.beside { fill: none; stroke: var(--line); stroke-dasharray: 3 4 }
.arrow { stroke: var(--line); fill: none; stroke-width: 1.5 }
"""


def named(name: str) -> Any:
    """The thing that MODULE:NAME names."""
    module, _, attribute = name.partition(":")
    return attrgetter(attribute)(importlib.import_module(module))


def text(x: float, y: float, words: str, quiet: bool = False) -> str:
    """A line of text."""
    style = ' class="quiet"' if quiet else ""
    return f'<text x="{x}" y="{y}"{style}>{escape(words)}</text>'


def drawing() -> str:
    """The picture as SVG."""
    from loopcal.estimation.steps import STEPS as FIRST

    steps = ", ".join(step.__name__ for step in FIRST)
    height = TOP + PITCH * (len(VALUES) - 1) + BOX + 44
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'width="{WIDTH}" height="{height}" font-family="system-ui, sans-serif" font-size="13">',
        "<title>How a calibration flows</title>",
        f"<desc>{', '.join(value.word for value in VALUES)}; companions beside.</desc>",
        f"<style>{STYLE}</style>",
        f'<rect class="page" width="{WIDTH}" height="{height}"/>',
        text(LEFT, 28, f"{' and '.join(ABOVE)} lead a reading from the top to the bottom:"),
    ]
    for i, value in enumerate(VALUES):
        y = TOP + PITCH * i
        kind = value.type.partition(":")[2]
        lines += [
            f'<rect class="box" x="{LEFT}" y="{y}" width="{WIDE}" height="{BOX}" rx="5"/>',
            f'<text x="{LEFT + WIDE / 2}" y="{y + 20}" text-anchor="middle">{value.word}</text>',
            text(LEFT + WIDE + 10, y + 20, kind, quiet=True) if ":" not in kind else "",
        ]
    for i, step in enumerate(STEPS):
        y, x = TOP + PITCH * i + BOX, LEFT + WIDE / 2
        end = y + PITCH - BOX - 2
        lines += [
            f'<path class="arrow" d="M{x} {y + 2}V{end}m-4 -6l4 6l4 -6"/>',
            text(x + 16, y + 13, step.words.format(steps=steps)),
            text(x + 16, y + 28, " · ".join(step.folders), quiet=True),
        ]
    return "\n".join([*filter(None, lines), *companions(), *below(height), "</svg>", ""])


def companions() -> list[str]:
    """The dashed box at the right."""
    y = TOP
    lines = [
        f'<rect class="beside" x="{BESIDE}" y="{y}" width="{WIDTH - BESIDE - LEFT}" '
        f'height="{68 + 44 * len(COMPANIONS)}" rx="8"/>',
        text(BESIDE + 14, y + 24, "Companions take these values."),
        text(BESIDE + 14, y + 42, "The core imports none of them."),
    ]
    for i, (words, folders) in enumerate(COMPANIONS.items()):
        at = y + 78 + 44 * i
        lines += [
            text(BESIDE + 14, at, words),
            text(BESIDE + 14, at + 16, " · ".join(folders), quiet=True),
        ]
    return lines


def below(height: float) -> list[str]:
    """What all of it stands on."""
    return [text(LEFT, height - 14, f"Below: {' · '.join(BELOW)}", quiet=True)]
