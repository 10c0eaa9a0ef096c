"""Results on the disk that reports are made of: plain ones, and one whose names are markup."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.result import write_result

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MARKUP = "<img/src=x/onerror=document.title='run'>"
SCRIPT = "</script><script>document.title='run'</script>"


@pytest.fixture(scope="session")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planar example with a validation."""
    out = tmp_path_factory.mktemp("report") / "planar"
    run_calibration(EXAMPLES / "planar" / "project.toml", Request(folds=5, report=True), out=out)
    return out


@pytest.fixture(scope="session")
def six_axis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The six-axis example, an arm in space."""
    out = tmp_path_factory.mktemp("report") / "six_axis"
    run_calibration(EXAMPLES / "six_axis" / "project.toml", Request(report=True), out=out)
    return out


@pytest.fixture(scope="session")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result in which every text that a user chooses is markup."""
    x, y = f"x{MARKUP}", f"y{SCRIPT}"

    def line(q, p):
        return (p[f"a{SCRIPT}"] * q[x] + p[f"b{MARKUP}"] - q[y],)

    mechanism = lc.Mechanism.from_function(
        line,
        quantities={x: "m", y: "m"},
        parameters={f"a{SCRIPT}": (1.0, "1"), f"b{MARKUP}": (0.0, "m")},
        outputs=(y,),
        name=MARKUP,
    )
    random = np.random.default_rng(4)
    true = np.linspace(0.0, 1.0, 30)
    data = lc.Dataset.from_arrays(
        {x: true, y: 1.1 * true + 0.2 + 1e-3 * random.standard_normal(30)},
        poses=[f"{i}{MARKUP}" for i in range(30)],
    )
    result = lc.calibrate(
        mechanism, data, noise=lc.Noise({x: 1e-3, y: 1e-3}), method="implicit-loop"
    )
    folder = tmp_path_factory.mktemp("report") / "<b>hostile<b>"
    written = write_result(
        result,
        folder,
        title=f"{MARKUP}{SCRIPT}",
        inputs={"data": {"file": f"{SCRIPT}.csv"}},
        warnings=(MARKUP,),
        report=True,
    )
    return written.folder
