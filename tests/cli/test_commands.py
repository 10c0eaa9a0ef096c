"""What the commands print, write and end with."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from loopcal.cli.progress import Counted, Progress
from loopcal.workflow import calibration
from tests import command_line
from tests.cli.conftest import PROJECT, Run, contents

CALIBRATE = ["calibrate", "project.toml"]


def test_the_summary_is_printed_and_the_files_are_named(folder: Path, run: Run) -> None:
    done = run(*CALIBRATE, "--out", "here")
    assert done.code == 0
    assert done.err == ""
    assert done.out.startswith("A planar arm\n")
    files = "result.json, residuals.csv, mechanism.toml, report.html"
    assert done.out.endswith(f"written to here: {files}\n")
    assert sorted(path.name for path in (folder / "here").iterdir()) == [
        "mechanism.toml",
        "report.html",
        "residuals.csv",
        "result.json",
    ]


def test_by_default_results_lie_beside_the_project(folder: Path, run: Run) -> None:
    (folder / "arm.toml").write_text(PROJECT)
    assert run("calibrate", folder / "arm.toml").code == 0
    assert (folder / "arm-result" / "result.json").exists()


def test_json_is_one_document_the_same_as_the_file(folder: Path, run: Run) -> None:
    done = run(*CALIBRATE, "--json")
    assert done.code == 0
    assert json.loads(done.out) == json.loads((folder / "project-result/result.json").read_bytes())
    assert "project-result" in done.err


def test_the_same_input_gives_the_same_bytes(folder: Path, run: Run) -> None:
    before = contents(folder)
    assert run(*CALIBRATE).code == 0
    assert contents(folder) == before


def test_the_method_of_the_command_wins(folder: Path, run: Run) -> None:
    done = run(*CALIBRATE, "--method", "least-squares", "--json")
    assert json.loads(done.out)["method"] == "least-squares"


def test_a_dash_reads_the_project_from_stdin(folder: Path) -> None:
    done = command_line.run("calibrate", "-", "--json", cwd=folder, stdin=PROJECT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["data"]["file"] == "readings.csv"
    assert (folder / "loopcal-result" / "result.json").exists()


def test_the_truth_adds_the_error_of_every_parameter(folder: Path, run: Run) -> None:
    truth = json.loads((folder / "readings.truth.json").read_text())["parameters"]
    done = run(*CALIBRATE, "--truth", "readings.truth.json")
    assert "(error: true minus estimate)" in done.out
    parameters = json.loads((folder / "project-result/result.json").read_bytes())["parameters"]
    for parameter in parameters:
        error = truth[parameter["name"]]["value"] - parameter["value"]
        assert parameter["error"] == error
        assert abs(error) < 5 * parameter["sd"]


def test_without_the_truth_no_error_is_known(folder: Path) -> None:
    document = json.loads((folder / "project-result/result.json").read_bytes())
    assert {p["error"] for p in document["parameters"]} == {None}


def test_a_truth_of_some_parameters_gives_their_errors_alone(folder: Path, run: Run) -> None:
    stated = {"schema": 1, "parameters": {"l2": {"value": 803, "unit": "mm"}}}
    (folder / "t.json").write_text(json.dumps(stated))
    parameters = json.loads(run(*CALIBRATE, "--truth", "t.json", "--json").out)["parameters"]
    assert [p["name"] for p in parameters if p["error"] is not None] == ["l2"]


def test_a_fit_that_does_not_converge_ends_with_4_and_is_written(folder: Path, run: Run) -> None:
    text = PROJECT.replace("[prior]", "[parameters]\nphi30 = 0.2\n[prior]")
    (folder / "project.toml").write_text(text.replace("[fit]", "[fit]\nmax_iterations = 1"))
    done = run(*CALIBRATE)
    assert done.code == 4
    assert "NOT CONVERGED (max_iterations)" in done.out
    assert "no trustworthy result" in done.err
    status = json.loads((folder / "project-result/result.json").read_bytes())["status"]
    assert status["converged"] is False
    assert status["reason"] == "max_iterations"


@pytest.mark.parametrize("where", ["option", "project"])
def test_what_is_not_identifiable_ends_with_4_where_that_was_asked(
    where: str, folder: Path, run: Run
) -> None:
    # a first joint that stands still cannot tell its link from the placement of the arm
    text = PROJECT.replace("from = -90, to = 90, step = 30", "from = 20, to = 20, step = 30")
    text = text.replace("[prior]", "phi2 = 0\n[prior]")
    if where == "project":
        text = text.replace("[fit]", "[fit]\nrequire_identifiable = true")
    (folder / "project.toml").write_text(text)
    assert run("simulate", "project.toml", "--out", "readings.csv").code == 0
    option = ["--require-identifiable"] if where == "option" else []
    done = run(*CALIBRATE, *option)
    assert done.code == 4
    assert "cannot be distinguished" in done.err
    assert "Not identifiable" in done.out
    parameters = json.loads((folder / "project-result/result.json").read_bytes())["parameters"]
    loose = [p for p in parameters if not p["identifiable"]]
    assert loose
    assert {p["sd"] for p in loose} == {None}
    if where == "option":
        assert run(*CALIBRATE).code == 0


def test_odd_readings_are_warned_of_on_stderr_and_in_the_result(folder: Path, run: Run) -> None:
    rows = (folder / "readings.csv").read_text().splitlines()
    rows[2] = "1" + rows[2][rows[2].index(",") :]
    (folder / "readings.csv").write_text("\n".join(rows) + "\n")
    done = run(*CALIBRATE, "--json")
    assert "warning" in done.err
    assert "more than once" in done.err
    assert "more than once" in json.loads(done.out)["warnings"][0]


def test_simulate_writes_what_the_project_reads(folder: Path, run: Run) -> None:
    done = run("simulate", "project.toml", "--out", "new/r.csv", "--seed", "7")
    assert done.code == 0
    assert "42 poses" in done.out
    rows = list(csv.DictReader(io.StringIO((folder / "new/r.csv").read_text())))
    assert list(rows[0]) == ["pose", "x", "y", "a", "b"]
    assert float(rows[0]["a"]) == pytest.approx(-90, abs=0.3)
    truth = json.loads((folder / "new/r.truth.json").read_text())
    assert truth["seed"] == 7
    assert truth["parameters"]["l2"] == {"value": 0.803, "unit": "m"}
    assert truth["quantities"]["phi2"]["values"][0] == -math.pi / 2


def test_simulate_tells_as_json_where_things_are(folder: Path, run: Run) -> None:
    told = json.loads(run("simulate", "project.toml", "--out", "r.tsv", "--json").out)
    assert told == {"readings": "r.tsv", "truth": "r.truth.json", "poses": 42, "seed": 0}


@pytest.mark.parametrize("ending", ["tsv", "parquet"])
def test_simulated_readings_read_back_alike_from_every_kind_of_file(
    ending: str, folder: Path, run: Run
) -> None:
    def values() -> list[float]:
        return [p["value"] for p in json.loads(run(*CALIBRATE, "--json").out)["parameters"]]

    expected = values()
    assert run("simulate", "project.toml", "--out", f"r.{ending}", "--seed", "1").code == 0
    (folder / "project.toml").write_text(PROJECT.replace("readings.csv", f"r.{ending}"))
    assert values() == expected


@pytest.mark.parametrize(
    "kind", ["planar-two-link", "serial", "urdf", "exponentials", "motoman-ma1400", "function"]
)
def test_a_new_project_can_be_simulated_and_calibrated_as_it_says(
    kind: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = run("new", "my-arm", "--mechanism", kind)
    assert made.code == 0
    commands = [line.split() for line in made.out.splitlines() if line.startswith("  loopcal ")]
    assert [command[1] for command in commands] == ["simulate", "calibrate"]
    for command in commands:
        done = run(*command[1:])
        assert done.code == 0, done.err
    document = json.loads((tmp_path / "my-arm/project-result/result.json").read_bytes())
    free = [p for p in document["parameters"] if not p["fixed"]]
    true = [p for p in free if p["error"] is not None]  # not those of the model error
    assert max(abs(p["error"]) / p["sd"] for p in true) < 5
    assert document["chi_squared"]["p_value"] > 1e-4


def test_the_calibrated_mechanism_is_the_next_nominal(folder: Path, run: Run) -> None:
    text = PROJECT.replace('type = "planar-two-link"', 'file = "project-result/mechanism.toml"')
    (folder / "again.toml").write_text(text)
    first = json.loads((folder / "project-result/result.json").read_bytes())
    again = json.loads(run("calibrate", "again.toml", "--json").out)
    for before, after in zip(first["parameters"], again["parameters"], strict=True):
        assert after["nominal"] == before["value"]
        assert abs(after["value"] - before["value"]) < 1e-6 * before["sd"]


@pytest.mark.parametrize("name", ["project", "result"])
def test_schemas_are_published(name: str, run: Run) -> None:
    from jsonschema import Draft202012Validator

    schema = json.loads(run("schema", name).out)
    Draft202012Validator.check_schema(schema)


def test_a_project_keeps_to_the_published_schema(run: Run) -> None:
    import jsonschema

    schema = json.loads(run("schema", "project").out)
    jsonschema.validate(tomllib.loads(PROJECT), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(PROJECT.replace("[noise]", "[nois]")), schema)


def test_version_and_help(run: Run) -> None:
    import loopcal

    told = run("--version").out
    assert re.fullmatch(rf"loopcal {loopcal.__version__} \(engine: (numpy|compiled, .+)\)\n", told)
    for arguments in (["--help"], ["calibrate", "-h"], ["simulate", "-h"], ["new", "--help"]):
        done = run(*arguments)
        assert done.code == 0
        assert "Usage: loopcal" in done.out
        assert "\x1b" not in done.out


def test_a_fault_of_ours_asks_for_a_report(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("inner")

    monkeypatch.setattr(calibration, "run_calibration", broken)
    done = run(*CALIBRATE)
    assert done.code == 1
    assert "Traceback" in done.err
    assert "fault of loopcal" in done.err
    assert "please report it" in done.err


def test_an_interruption_is_one_line(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(calibration, "run_calibration", interrupted)
    done = run(*CALIBRATE)
    assert done.code == 130
    assert done.err == "loopcal: interrupted\n"


def test_a_reader_that_goes_away_is_no_fault(folder: Path) -> None:
    program = [sys.executable, "-m", "loopcal", *CALIBRATE, "--json"]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=command_line.environment()
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        told = process.stderr.read()
        assert process.wait() == 0
    assert b"Traceback" not in told
    assert b"Exception" not in told


def test_a_terminal_without_unicode_shows_what_it_can(folder: Path) -> None:
    (folder / "project.toml").write_text(PROJECT.replace("A planar arm", "Größe in µm"), "utf-8")
    ascii_only = {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    text = command_line.run(*CALIBRATE, cwd=folder, env=ascii_only)
    assert text.returncode == 0, text.stderr
    document = command_line.run(*CALIBRATE, "--json", cwd=folder, env=ascii_only)
    assert json.loads(document.stdout)["title"] == "Größe in µm"


def test_no_heavy_library_is_loaded_without_need(folder: Path) -> None:
    code = (
        "import sys, loopcal\n"
        "assert 'numpy' not in sys.modules\n"
        "from loopcal.cli import main\n"
        "main(['--version'])\n"
        "assert 'numpy' not in sys.modules\n"
        "assert main(['calibrate', 'project.toml', '--no-report']) == 0\n"
        "aside = 'report.page statistics.models statistics.intervals '\n"
        "aside += 'workflow.checking workflow.streams simulation.simulate statistics.causes '\n"
        "aside += 'estimation.stream.merit mechanisms.effects.registry files.machines.chains '\n"
        "aside += 'estimation.solve.newton mechanisms.effects.drift '\n"
        "aside += 'measurements.joining document.notebook_html '\n"
        "aside += 'files.project.new_project files.machines.serial '\n"
        "aside += 'mechanisms.parallel.registry files.machines.declared_function'\n"
        "heavy = {'scipy', 'jinja2', 'html', 'multiprocessing', 'concurrent.futures.process'}\n"
        "heavy |= {f'loopcal.{name}' for name in aside.split()}\n"
        "assert len([name for name in sys.modules if name.startswith('loopcal.')]) <= 290\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "from loopcal.files.toml.model import Model\n"
        "def below(model): return [model, *(m for c in model.__subclasses__() for m in below(c))]\n"
        "built = {model.__name__ for model in below(Model) if model.__pydantic_complete__}\n"
        "assert {'ProjectTables', 'PlanarTwoLinkMachine'} <= built, built\n"
        "aside = {'SerialMachine', 'UrdfMachine', 'DriftEffect', 'PointInstrument'}\n"
        "assert not built & aside, built\n"
        "assert main(['calibrate', 'project.toml']) == 0\n"
        "from loopcal.document.result_document import ResultDocument\n"
        "assert main(['predict', 'project-result', 'readings.csv']) == 0\n"
        "assert main(['verify', 'project-result', 'readings.csv']) in (0, 4)\n"
        # the schema alone needs the descriptions, which are read from the source files
        "assert not ResultDocument.__pydantic_config__['use_attribute_docstrings']\n"
        "assert not {'scipy.stats', 'scipy.optimize'} & set(sys.modules)\n"
        "heavy = {'polars', 'scipy.io', 'python_calamine', 'rich', 'jsonschema', 'pandas'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=command_line.environment(),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0, done.stderr


class Terminal(io.StringIO):
    """A stream that says what it is."""

    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self.terminal = terminal

    def isatty(self) -> bool:
        return self.terminal


def ticking(monkeypatch: pytest.MonkeyPatch, step: float) -> None:
    seconds = iter(step * i for i in range(1000))
    monkeypatch.setattr("time.monotonic", lambda: next(seconds))


@pytest.mark.parametrize("terminal", [True, False])
def test_short_fits_show_no_progress(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 0.1)
    stream = Terminal(terminal)
    with Progress(stream) as progress:
        for i in range(1, 19):
            progress(i, 100.0 / i, 1.0)
    assert stream.getvalue() == ""


def test_on_a_terminal_progress_is_one_line_that_vanishes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ticking(monkeypatch, 1.0)
    stream = Terminal(True)
    with Progress(stream) as progress:
        for i in range(1, 6):
            progress(i, 100.0 / i, 1.0)
    shown = stream.getvalue()
    assert "\n" not in shown
    assert "iteration 5: chi-squared 20" in shown
    assert shown.rsplit("\r", 2)[1].strip() == ""


def test_elsewhere_progress_is_plain_lines_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 1.0)
    stream = Terminal(False)
    with Progress(stream) as progress:
        for i in range(1, 31):
            progress(i, 100.0 / i, 1.0)
    lines = stream.getvalue().splitlines()
    assert [line.split(":")[0] for line in lines] == ["iteration 2", "iteration 12", "iteration 22"]
    assert "\r" not in stream.getvalue()


def test_what_is_waited_for_gets_a_line_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 3.0)
    stream = Terminal(True)
    monkeypatch.setattr("sys.stderr", stream)
    with Progress() as progress:
        progress.pieces("folds", 1, 10)
        progress.waiting()
    shown, blank, line = stream.getvalue().split("\r")[1:]
    assert (shown, blank.strip()) == ("1 of 10 folds", "")
    assert line == "loopcal: waiting for running pieces to finish\n"


def test_the_fit_is_shown_at_once_while_it_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 0.1)
    stream = Terminal(True)
    fit: Any = SimpleNamespace(accuracy_after=SimpleNamespace(rms=0.000194, unit="m"))
    with Progress(stream) as progress:
        progress.fitted(fit)
        progress.due = 0.0
        progress.pieces("folds", 1, 10)
    first, second = stream.getvalue().split("\r")[1:3]
    assert first == "fitted: error 0.194 mm rms; judging"
    assert second.strip() == "fitted: error 0.194 mm rms; 1 of 10 folds"


def test_counted_work_says_what_time_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 1.0)
    stream = Terminal(False)
    with Counted(stream) as progress:
        for done in range(1, 31):
            progress(10 * done, 300)
    lines = stream.getvalue().splitlines()
    assert lines == [
        "20 of 300 fits, 28 s left",
        "120 of 300 fits, 18 s left",
        "220 of 300 fits, 8 s left",
    ]
