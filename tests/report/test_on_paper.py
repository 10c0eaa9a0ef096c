"""Every page on A4: nothing wider or taller than the paper, colours kept, no JSON, its origin."""

from __future__ import annotations

import re
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.cli import main
from loopcal.companions.life.pages import fleet_html
from loopcal.companions.planning.page import plan_html
from loopcal.companions.studies.page import study_html
from loopcal.companions.studies.run import run_study
from loopcal.execution.executor import InProcess
from loopcal.figures.space import FIELD, space_layout
from loopcal.presentation.shown import Table
from loopcal.report.templates import Section, section_page
from loopcal.report.verification_page import verification_html
from loopcal.workflow.result import write_result
from tests.browser import chromium, opened
from tests.report.test_study_page import STUDY

MILLIMETRE = 96.0 / 25.4
WIDTH = {"record": round((210 - 32) * MILLIMETRE)}
"""[px] between the margins of A4, where it is not 210 mm - 24 mm."""
HEIGHT = (297 - 24) * MILLIMETRE
LONG = "a_name_such_as_long_robot_descriptions_carry_it_"
DAY = r"\d{4}-\d\d-\d\d"
ON_TOP = {
    "report": rf"{DAY}.* 60 of 60 poses",
    "six": rf"{DAY}.* poses\.csv: 100 of 100 poses",
    "tables": rf"written {DAY}",
    "record": r"Calibrated not stated.* from memory: 60 of 60 poses",
    "plan": rf"project\.toml.* poses 8 .*{DAY}",
    "verify": rf"day\.csv.* poses 60 .*{DAY}",
    "fleet": rf"one, two, three.* poses 60, 60, 60 .*{DAY}",
    "history": rf"machine\.history.* entries 3 .*{DAY}",
    "performance": rf"performance\.csv.* measurements 150 .*{DAY}",
    "study": rf"folder .* poses 49 .*{DAY}",
}
"""What the head of each page holds."""
MEASURED = """async () => {
  dispatchEvent(new Event("beforeprint"));
  const wide = document.documentElement.clientWidth, said = (e) =>
    `${e.tagName} ${e.className || e.id} ${e.textContent.slice(0, 40)}`;
  const shown = [...document.body.querySelectorAll("*:not(script):not(option)")]
    .filter((e) => e.checkVisibility() && !e.closest("svg"));
  const box = (e) => e.getBoundingClientRect();
  const cut = [];
  for (const image of document.querySelectorAll(".still[src^='data:image/svg']")) {
    const holder = document.createElement("div");
    holder.innerHTML = decodeURIComponent(image.src.slice(image.src.indexOf(",") + 1));
    document.body.append(holder);
    const edge = box(holder.firstElementChild);
    for (const text of holder.querySelectorAll("text")) {
      const at = box(text);
      if (at.width && (at.left < edge.left - 1 || at.right > edge.right + 1 ||
          at.top < edge.top - 1 || at.bottom > edge.bottom + 1))
        cut.push(`${image.id}: ${text.textContent.slice(0, 60)}`);
    }
    holder.remove();
  }
  return {
    wide: shown.filter((e) => box(e).right > wide + 1 || box(e).left < -1).map(said),
    cut,
    tall: [...document.querySelectorAll("figure")]
      .map((e) => [e.querySelector(".still").id, box(e).height]),
    figures: document.querySelectorAll(".plot").length,
    stills: [...document.querySelectorAll(".still")].filter((e) => box(e).height > 50).length,
    text: shown.filter((e) => e.tagName === "PRE").map((e) => e.textContent),
    top: document.body.innerText.replace(/\\s+/g, " ").slice(0, 900),
    small: shown.filter((e) => e.tagName === "TD" && e.textContent.trim()
      && parseFloat(getComputedStyle(e).fontSize) < 4).map(said),
  };
}"""


@dataclass(frozen=True)
class Paper:
    """What was measured of a page in print, and the colours of its PDF without and with grounds.

    trouble: what the page asked for beside itself, and complained about.
    """

    measured: dict[str, Any]
    colours: tuple[set[bytes], set[bytes]]
    sizes: set[bytes]
    trouble: list[str]


def long_names(count: int = 7) -> tuple[list[lc.Result], list[lc.Dataset]]:
    """A linear model whose quantities and parameters have long names; three days of readings."""
    outputs = [f"{LONG}output_{i}" for i in range(count)]
    gains, ends = (
        [f"{LONG}gain_{i}" for i in range(count)],
        [f"{LONG}end_{i}" for i in range(count)],
    )

    def lines(q, p):
        return tuple(
            p[a] * q["joint"] + p[b] - q[y] for a, b, y in zip(gains, ends, outputs, strict=True)
        )

    mechanism = lc.Mechanism.from_function(
        lines,
        quantities={"joint": "rad", **dict.fromkeys(outputs, "m")},
        parameters={**dict.fromkeys(gains, (1.0, "1")), **dict.fromkeys(ends, (0.0, "m"))},
        outputs=tuple(outputs),
        name=LONG,
    )
    random, at = np.random.default_rng(7), np.linspace(-1.0, 1.0, 60)
    days = [
        lc.Dataset.from_arrays(
            {"joint": at, **{y: 1.01 * at + 1e-3 * random.standard_normal(60) for y in outputs}},
            poses=[f"{LONG}pose_{i}" for i in range(60)],
        )
        for _ in range(3)
    ]
    noise = lc.Noise({"*": 1e-3})
    results = [lc.calibrate(mechanism, d, noise=noise, method="implicit-loop") for d in days]
    return results, days


def table_of(columns: int) -> Table:
    """Numbers, lengths of texts that no other page brings, and words without a space."""
    row = ("12345.6789", "value +- sd [mm/rad]", "x" * 90, "many short words " * 8)
    cells = tuple(row[i % 4] for i in range(columns))
    return Table("caption " * 30, tuple(f"head {LONG}"[: 5 * i] for i in range(columns)), (cells,))


def performance_table(folder: Path) -> Path:
    """Attained poses with every figure."""
    assert main(["new", str(folder), "--performance"]) == 0
    path, rng = folder / "performance.csv", np.random.default_rng(1)
    head, *rows = path.read_text("utf-8").splitlines()
    lines = [f"{head},direction,time [min]"]
    for i, row in enumerate(rows):
        pose, cycle, *asked = row.rstrip(",").split(",")
        at = np.array(asked, dtype=float) + rng.normal([0.2, 0.0, 0.1], 0.02)
        where = ",".join([pose, cycle, *asked, *(f"{v:.4f}" for v in at)])
        lines.append(f"{where},{'+x' if i % 2 else '-x'},{2 * i}")
    path.write_text("\n".join(lines), "utf-8")
    return path


@pytest.fixture(scope="module")
def pages(six_axis: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of every kind, of long names where names are the user's."""
    folder = tmp_path_factory.mktemp("paper")
    results, days = long_names()
    for name, result in zip(("one", "two", "three"), results, strict=True):
        inputs, paged = {"data": {"file": LONG}}, name == "one"
        write_result(result, folder / name, title=LONG, inputs=inputs, report=paged)
    html = {
        "six": (six_axis / "report.html").read_text("utf-8"),
        "tables": section_page(
            "life", Section("l", "x", (), [table_of(columns) for columns in (2, 6, 10)]), {}
        ),
        "verify": verification_html(lc.verify(results[0], days[1]), LONG, "result, day.csv"),
        "fleet": fleet_html(lc.fleet(results), "one, two, three"),
    }
    machine = results[0].calibrated
    planned = lc.plan(machine, 8, noise=lc.Noise({"*": 1e-3}), candidates=days[0])
    html["plan"] = plan_html(planned, LONG, machine, "project.toml")
    (folder / "study.toml").write_text(STUDY.replace("third <i>joint</i> poor", LONG))
    html["study"] = study_html(run_study(folder / "study.toml", draws=4, executor=InProcess()))
    table = performance_table(folder / "test")
    assert main(["performance", str(table), "--out", str(folder / "performance.html")]) == 0
    history = str(folder / "machine.history")
    event = ["--event", f"{LONG} {LONG}"]
    six = shutil.copytree(six_axis, folder / "six")  # a history leaves notes beside results
    added = ["--add", str(six), "--add", str(six)]
    assert main(["history", history, *added, *event, "--out", str(folder / "history.html")]) == 0
    assert main(["record", str(folder / "one"), "--out", str(folder / "record.html")]) == 0
    shutil.copy(folder / "one" / "report.html", folder / "report.html")
    for name, text in html.items():
        (folder / f"{name}.html").write_text(text, "utf-8")
    return {name: folder / f"{name}.html" for name in ON_TOP}


@pytest.fixture(scope="module")
def papers(pages: dict[str, Path]) -> Iterator[dict[str, Paper]]:
    """Every page, measured in print and printed."""
    with chromium() as browser:
        yield {name: printed(browser, path, name) for name, path in pages.items()}


def printed(browser: Any, path: Path, name: str) -> Paper:
    """A page at the width of A4, and as PDF as a reader's dialogue prints it."""
    wide = WIDTH.get(name, round((210 - 24) * MILLIMETRE))
    with opened(browser, path, width=wide, scheme="dark", drawn=name != "record") as seen:
        trouble = [*seen.requests, *seen.complaints]  # on the screen
        seen.page.emulate_media(media="print", color_scheme="dark")
        measured = seen.page.evaluate(MEASURED)
        with_grounds, without = (
            seen.page.pdf(print_background=ground, prefer_css_page_size=True)
            for ground in (True, False)
        )
    return Paper(measured, (filled(without), filled(with_grounds)), sizes(without), trouble)


def filled(pdf: bytes) -> set[bytes]:
    """The colours with which a PDF fills."""
    streams = re.findall(rb"/Filter /FlateDecode.*?stream\r?\n(.*?)endstream", pdf, re.DOTALL)
    found = set()
    for stream in streams:
        try:
            found |= set(re.findall(rb"[\d.]+ [\d.]+ [\d.]+ rg", zlib.decompress(stream)))
        except zlib.error:
            continue
    return found


def sizes(pdf: bytes) -> set[bytes]:
    """Sizes of the pages [pt]."""
    return set(re.findall(rb"/MediaBox \[0 0 (\d+)[\d.]* (\d+)", pdf))


@pytest.mark.parametrize("name", ON_TOP)
def test_nothing_is_wider_or_taller_than_a4(name: str, papers: dict[str, Paper]) -> None:
    paper = papers[name]
    assert paper.measured["wide"] == []
    assert [one for one in paper.measured["tall"] if one[1] > HEIGHT] == []
    assert paper.measured["small"] == []
    assert paper.measured["stills"] == paper.measured["figures"]
    assert paper.sizes <= {(b"594", b"841"), (b"595", b"842"), (b"594", b"842"), (b"595", b"841")}


@pytest.mark.parametrize("name", ON_TOP)
def test_it_is_drawn_silently_without_any_network(name: str, papers: dict[str, Paper]) -> None:
    assert papers[name].trouble == []


@pytest.mark.parametrize("name", [name for name in ON_TOP if name not in ("record", "tables")])
def test_no_text_is_cut_inside_a_figure(name: str, papers: dict[str, Paper]) -> None:
    assert papers[name].measured["figures"] > 0
    assert papers[name].measured["cut"] == []


@pytest.mark.parametrize("name", ON_TOP)
def test_colours_are_printed_though_the_reader_prints_no_backgrounds(
    name: str, papers: dict[str, Paper]
) -> None:
    without, with_grounds = papers[name].colours
    assert without == with_grounds
    assert len(without) > 2


@pytest.mark.parametrize("name", ON_TOP)
def test_paper_shows_no_json(name: str, papers: dict[str, Paper]) -> None:
    assert [text for text in papers[name].measured["text"] if text.lstrip()[:1] in "{["] == []


@pytest.mark.parametrize(("name", "held"), ON_TOP.items())
def test_day_files_and_number_of_poses_stand_on_top(
    name: str, held: str, papers: dict[str, Paper]
) -> None:
    assert re.search(held, papers[name].measured["top"])


@pytest.mark.parametrize("box", [(1, 1, 1), (3, 0.1, 0.1), (0.1, 0.1, 3), (5, 5, 0), (0, 0, 0)])
def test_a_scene_holds_all_that_it_shows(box: tuple[float, float, float]) -> None:
    """Every point projects inside the picture of a camera with plotly's field of view."""
    at = np.random.default_rng(3).uniform(-0.5, 0.5, (3, 50)) * np.array(box)[:, None] + 2.0
    scene = space_layout([dict(zip("xyz", at.tolist(), strict=True))])["scene"]
    ranges = np.array([scene[f"{a}axis"]["range"] for a in "xyz"])
    ratio = np.array([scene["aspectratio"][a] for a in "xyz"])
    assert np.allclose(np.diff(ranges)[:, 0] / ratio, np.diff(ranges)[0, 0] / ratio[0])
    shown = ((at.T - ranges.mean(axis=1)) / np.diff(ranges)[:, 0]) * ratio
    eye = np.array([scene["camera"]["eye"][a] for a in "xyz"])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    depth = (shown - eye) @ forward
    edge = np.tan(FIELD / 2.0) * depth
    assert (depth > 0.0).all()
    assert (np.abs((shown - eye) @ right) <= edge).all()
    assert (np.abs((shown - eye) @ np.cross(right, forward)) <= edge).all()
