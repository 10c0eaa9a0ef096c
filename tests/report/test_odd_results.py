"""Reports of results that lack something: outputs, sds, readings, an optimum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.result import FitResult
from loopcal.report.page import report_html
from loopcal.report.source import read_source
from loopcal.workflow.result import write_result
from tests.golden_files import page_text

MADE = lc.simulate(
    lc.planar_two_link(),
    {
        name: np.repeat(np.linspace(-1.0, 1.0, 5), 5) + 0.3 * i
        for i, name in enumerate(("phi2", "phi3"))
    }
    | {"phi3": np.tile(np.linspace(0.4, 2.0, 5), 5)},
    noise=lc.Noise({"*": 1e-3}),
    seed=2,
)
DATA = MADE.dataset
NOISE = lc.Noise({"*": 1e-3})


def without_outputs() -> FitResult:
    mechanism = lc.Mechanism.from_function(
        lambda x, p: (x.a * p.gain + p.zero - x.b,),
        quantities={"a": "m", "b": "m"},
        parameters={"gain": (1.0, "1"), "zero": (0.0, "m")},
    )
    a = np.linspace(0.0, 1.0, 12)
    data = lc.Dataset.from_arrays({"a": a, "b": 1.2 * a + 1e-3 * np.sin(9 * a)})
    return lc.calibrate(mechanism, data, noise=NOISE, method="implicit-loop")


def with_gaps() -> FitResult:
    holes = DATA["xP"].copy()
    holes[3] = np.nan
    data = lc.Dataset.from_arrays(
        {"xP": holes, "yP": DATA["yP"], "phi2": DATA["phi2"], "phi3": DATA["phi3"]}
    )
    return lc.calibrate(lc.planar_two_link(), data, noise=NOISE, method="implicit-loop")


def only_one_parameter() -> lc.Mechanism:
    arm = lc.planar_two_link()
    return arm.with_parameters(
        arm.parameters.with_fixed([n for n in arm.parameters.names if n != "l2"])
    )


RESULTS = {
    "no outputs": without_outputs,
    "gaps": with_gaps,
    "least squares": lambda: lc.calibrate(lc.planar_two_link(), DATA, method="least-squares"),
    "exact readings": lambda: lc.calibrate(
        lc.planar_two_link(),
        DATA,
        noise=lc.Noise({"?P": 1e-3, "phi?": 0.0}),
        method="implicit-loop",
    ),
    "stopped": lambda: lc.calibrate(
        lc.planar_two_link({"l2": 0.3}), DATA, noise=NOISE, max_iterations=1, method="implicit-loop"
    ),
    "robust": lambda: lc.calibrate(
        lc.planar_two_link(), DATA, noise=NOISE, loss="huber", method="implicit-loop"
    ),
    "one parameter": lambda: lc.calibrate(
        only_one_parameter(), DATA, noise=NOISE, method="implicit-loop"
    ),
    # a single angle between the links
    "not identifiable": lambda: lc.calibrate(
        lc.planar_two_link(),
        DATA.exclude([pose for i, pose in enumerate(DATA.poses) if i % 5]),
        noise=NOISE,
        method="implicit-loop",
    ),
}


@pytest.mark.parametrize("name", RESULTS)
def test_there_is_a_report_all_the_same(name: str, tmp_path: Path) -> None:
    result = RESULTS[name]()
    written = write_result(result, tmp_path, report=True)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert report_html([read_source(tmp_path)]) == page
    text = page_text(page)
    assert "nan" not in text.lower().split()
    assert all(entry.name in text for entry in written.document.parameters)
    assert ("did not converge" in text) == (not result.status.converged)
