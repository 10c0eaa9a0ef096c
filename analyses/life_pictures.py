"""Make the pictures of a machine's life in the how-to pages: what changed, update,
history, fleet.

    python -m analyses.life_pictures

It needs Chromium and playwright (`make partners`).
"""

from __future__ import annotations

import sys
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.what_changed import NOISE, arm, joints, measured
from loopcal.companions.life.history_folder import append_entries
from loopcal.companions.life.pages import fleet_html, history_html
from loopcal.report.verification_page import verification_html
from tests.browser import chromium, opened

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
START = datetime(2026, 1, 12, 9, tzinfo=UTC)


def changed() -> str:
    """A collision that moved two zeros of a six-axis arm, on a day with another tracker."""
    rng, drawn = np.random.default_rng(1), arm(sagging=False)
    nominal = {p.name: p.nominal for p in drawn.parameters}
    first = measured(drawn, "rigid", joints(rng, 60), 1)
    result = lc.calibrate(drawn, first, noise=NOISE, method="implicit-loop")
    hit = {"offset_4": nominal["offset_4"] + 1e-3, "offset_5": nominal["offset_5"] - 5e-4}
    there = {"T_x": nominal["T_x"] + 0.5, "T_rz": nominal["T_rz"] + 0.4}
    day = measured(drawn.with_nominal(nominal | hit | there), "rigid", joints(rng, 30), 2)
    return verification_html(lc.verify(result, day), "six-axis arm", "from memory")


def updated(folder: Path) -> str:
    """An arm whose calibration by 45 poses is updated by 15, with an allowance for its joints."""
    rng, drawn = np.random.default_rng(2), arm(sagging=False)
    first = measured(drawn, "rigid", joints(rng, 45), 3)
    result = lc.calibrate(drawn, first, noise=NOISE, method="implicit-loop")
    day = measured(drawn, "rigid", joints(rng, 15), 4)
    found = lc.update(result, day, drift={"offset_4": 2e-4, "offset_5": 2e-4})
    lc.write_result(found, folder, report=True)
    return (folder / "report.html").read_text("utf-8")


def history(folder: Path) -> str:
    """Eight calibrations: a length drifts, and a collision shortens a link."""
    rng, walk = np.random.default_rng(4), 0.0
    for i in range(8):
        walk += 8e-6 * rng.standard_normal()
        hit = 4e-5 if i > 5 else 0.0
        values = {
            "a_2": (0.6 + walk, 6e-6),
            "a_3": (0.12 - hit + 2e-6 * rng.standard_normal(), 5e-6),
        }
        its = {
            name: {"value": value, "sd": sd, "unit": "m", "kind": "length"}
            for name, (value, sd) in values.items()
        }
        rms = 6e-5 + 4e-6 * rng.standard_normal() + 0.4 * hit
        day = START + timedelta(days=91 * i)
        measured = {"first": f"{day:%Y-%m-%d}", "last": f"{day:%Y-%m-%d}"}
        content = {"words": "ok", "rms": rms, "unit": "m", "parameters": its, "measured": measured}
        append_entries(folder, [("calibration", content)], time=day)
    append_entries(folder, [("event", {"words": "collision"})], time=START + timedelta(days=500))
    return history_html(lc.history(folder))


def fleet() -> str:
    """The six arms of the how-to page, of which the last is unusual."""
    rng, results = np.random.default_rng(1), []
    noise = lc.Noise({"xP": 5e-5, "yP": 5e-5, "phi2": 5e-5, "phi3": 5e-5})
    for number in range(1, 7):
        l2, l3 = np.array([0.8, 0.6]) + 5e-5 * rng.standard_normal(2)
        its = {"l2": l2, "l3": l3 + (2e-3 if number == 6 else 0.0), "xA": 0.1 * number}
        true = lc.planar_two_link(its)
        driven = {q: rng.uniform(-2.0, 2.0, 40) for q in ("phi2", "phi3")}
        data = lc.simulate(true, driven, noise=noise, seed=number).dataset
        nominal = true.with_nominal({"l2": 0.8, "l3": 0.6})
        results.append(lc.calibrate(nominal, data, noise=noise, method="implicit-loop"))
    return fleet_html(lc.fleet(results), "from memory")


def main() -> None:
    """Write changed.png, updated.png, history.png and fleet.png."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        pages = {
            "changed": (changed(), "#l-angles"),
            "updated": (updated(Path(folder) / "updated"), "#r1-sds_angles"),
            "history": (history(Path(folder) / "arm.history"), "#h-lengths"),
            "fleet": (fleet(), "#l-spread"),
        }
        for name, (text, where) in pages.items():
            page = Path(folder) / f"{name}.html"
            page.write_text(text, "utf-8")
            with opened(browser, page, width=820) as seen:
                seen.page.wait_for_selector(f"{where} .main-svg")
                drawn = seen.page.locator(f"figure:has({where})").screenshot()
                (PICTURES / f"{name}.png").write_bytes(drawn)
    print(f"written to docs/pictures: {', '.join(f'{name}.png' for name in pages)}")


if __name__ == "__main__":
    try:
        main()
    except pytest.skip.Exception as absent:
        sys.exit(str(absent))
