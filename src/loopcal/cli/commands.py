"""The commands and their options. What they do is in `loopcal.workflow`, loaded when needed."""

from __future__ import annotations

from shlex import quote
from typing import Annotated

from loopcal.cli.application import (
    AnewOption,
    ClusterOption,
    DateOption,
    ForceOption,
    FullOption,
    FunctionOption,
    HistoryOption,
    JsonOption,
    NoReportOption,
    ProjectArgument,
    ReadingsArgument,
    RemountedOption,
    ResultArgument,
    WorkersOption,
    app,
    argument,
    flag,
    option,
    out_option,
)
from loopcal.cli.output import below, log, print_data, print_done, print_json, print_out, screen
from loopcal.cli.registry import keeper
from loopcal.companions import called
from loopcal.errors import InputError, NoTrustworthyResult, UsageError
from loopcal.estimation.methods.registry import METHODS
from loopcal.files.project.templates import TEMPLATES


@app.command()
def calibrate(
    project: ProjectArgument,
    method: Annotated[
        str | None,
        option("METHOD", f"Fit by {', '.join(METHODS)} [default: the project's fit.method]."),
    ] = None,
    truth: Annotated[
        str | None,
        option(
            "FILE",
            "Compare with the truth of a simulation: print every parameter's error, true "
            "minus estimate.",
        ),
    ] = None,
    out: Annotated[
        str | None,
        out_option(
            "DIR", "Write the results to this folder [default: NAME-result beside NAME.toml]."
        ),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
    require_identifiable: Annotated[
        bool,
        flag("--require-identifiable", "Exit with code 4 unless every parameter is determined."),
    ] = False,
    tolerance: Annotated[
        float | None,
        option(
            "MM",
            "Judge whether 95 % of poses in the working region lie within this distance "
            "[default: the project's verdict.tolerance].",
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        option(
            "QUESTION",
            "Exit with code 4 unless the verdict answers this with yes: sound, valid, better, "
            "tolerance; repeatable or comma separated [default: sound must not fail].",
        ),
    ] = None,
    folds: Annotated[
        int | None,
        option(
            "N",
            "Validate by N-fold cross-validation [default: the project's fit.validation].",
            min=2,
        ),
    ] = None,
    profile: Annotated[
        list[str] | None,
        option(
            "GLOB",
            "Compute profile likelihood intervals of these parameters; repeatable [default: none].",
        ),
    ] = None,
    compare: Annotated[
        bool,
        flag(
            "--compare",
            "Compare the project's [[compare.model]] on held-out poses and calibrate with "
            "the recommended one.",
        ),
    ] = False,
    no_report: NoReportOption = False,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    machine_history: HistoryOption = None,
    date: DateOption = None,
) -> None:
    """Fit; write result.json, residuals.csv, mechanism.toml and report.html; print a summary."""
    from loopcal.cli.progress import Progress, executor_of, try_cluster
    from loopcal.workflow.calibration import Listeners, Request, run_calibration

    with Progress() as progress:
        executor = executor_of(workers, cluster, waiting=progress.waiting)
        done = run_calibration(
            project,
            Request(
                method=method,
                truth=truth,
                require_identifiable=require_identifiable,
                require=[name for part in require or () for name in part.split(",")],
                folds=folds,
                profile=profile or (),
                compare=compare,
                report=not no_report,
                keeper=keeper(machine_history, date),
                tolerance=None if tolerance is None else 1e-3 * tolerance,
            ),
            out=out,
            function=mechanism,
            executor=executor,
            listeners=Listeners(
                sharing=try_cluster,
                progress=progress,
                fitted=progress.fitted,
                pieces=progress.pieces,
                notice=log,
                warn=lambda words: log(f"warning: {words}"),
            ),
        )
    where = f"written to {done.written.folder}: {', '.join(done.written.files)}"
    typed, full = done.typed, full or bool(truth or profile or compare)  # what was asked is shown
    text = f"{typed.title}\n{typed}\n\n{done.result.findings.words()}"
    print_done(done.written.document, as_json, text=text, where=where, full=full)
    if done.objection is not None:
        error = NoTrustworthyResult(f"no trustworthy result: {done.objection}")
        answers = () if typed.verdict is None else typed.verdict.answers.values()
        error.command = next((a.command for a in answers if a.passed is False and a.command), "")
        raise error


@app.command()
def check(
    project: ProjectArgument,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Check a project before a fit: ranges, what the poses can determine, the expected sds."""
    from loopcal.workflow.checking import run_check

    done = run_check(project, function=mechanism)
    cure, title = called("cure_of")(done), done.project.title
    for warning in done.warnings:
        log(f"warning: {warning}")
    if as_json:
        cured = None if cure is None else cure.document()
        document = {"title": title, **done.check.document(), "cure": cured}
        print_json({**document, "warnings": [*done.warnings]})
    else:
        more = "" if cure is None else f"\n\n{cure}"
        text = f"{title}: {done.check.poses} poses, nothing fitted\n\n{done.check}{more}"
        print_out(text if full else screen(text))


@app.command()
def predict(
    result: ResultArgument,
    file: Annotated[
        list[str],
        argument("FILE...", "Readings in the columns of the project or its first files' layout."),
    ],
    out: Annotated[
        str | None,
        out_option(
            "FILE",
            "Write the table to this file (.csv, .tsv or .parquet) [default: CSV on stdout].",
        ),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Predict end points for given readings, with their covariance; warn of extrapolation."""
    from loopcal.workflow.checking import prediction_table, run_prediction

    done = run_prediction(result, file, out=out, function=mechanism)
    if as_json:
        print_json(done.document())
    elif out is None:
        print_data(prediction_table(done).rstrip("\n"))
        for line in done.words().splitlines():
            log(line)
    else:
        print_out(f"{done.words()}\nwritten to {out}")


@app.command()
def compare(
    a: Annotated[str, argument("A", "Folder of a calibration, or its result.json.")],
    b: Annotated[str, argument("B", "Another calibration of the same machine.")],
    poses: Annotated[
        str | None,
        option(
            "FILE",
            "Compare at these readings, in the columns of A's project [default: the poses "
            "of both].",
        ),
    ] = None,
    same_frame: Annotated[
        bool,
        flag(
            "--same-frame",
            "Compare the instrument's placement too; it must not have moved between A and B.",
        ),
    ] = False,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Compare two calibrations of one machine: differences, their sds and their significance."""
    from loopcal.workflow.public import compare as compared
    from loopcal.workflow.saved_result import read_result

    first, second = (read_result(path, mechanism=mechanism) for path in (a, b))
    try:
        done = compared(first, second, poses=poses, align=not same_frame)
    except InputError as error:
        raise (error if error.place else error.at(f"{a}, {b}")) from None
    print_done(done, as_json, full=full)


@app.command()
def report(
    results: Annotated[
        list[str],
        argument("RESULT...", "Folders of calibrations, or the result.json in them."),
    ],
    out: Annotated[
        str | None,
        out_option(
            "FILE", "Write the page to this file [default: report.html beside a single result]."
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write one self-contained HTML page of one result, or of several side by side."""
    from loopcal.cli.reporting import run_report

    print_out(f"written to {run_report(results, out)}")


@app.command()
def noise(
    files: Annotated[
        list[str],
        argument("FILE...", "Repeated readings of one pose, one series per file."),
    ],
    project: Annotated[
        str | None,
        option("PROJECT", "Take columns, units and loops from this project file."),
    ] = None,
    columns: Annotated[
        str | None,
        option(
            "NAME=UNIT,...",
            "Read these columns: S=rad,L=rad,x=m [default: all columns of numbers].",
        ),
    ] = None,
    pose: Annotated[
        str | None, option("COLUMN", "Skip this column of ids [default: none].")
    ] = None,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Estimate sensor sds from repeated readings of one pose, separating drift from scatter."""
    from loopcal.workflow.checking import sensor_noise

    done = sensor_noise(files, project=project, columns=columns, pose=pose, function=mechanism)
    print_done(done, as_json, text=done.text)


@app.command()
def simulate(
    project: ProjectArgument,
    out: Annotated[str, out_option("FILE", "Readings to write: .csv, .tsv or .parquet.")],
    force: ForceOption = False,
    seed: Annotated[int, option("N", "Seed of all random numbers [default: 0].", min=0)] = 0,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Simulate readings of the project's mechanism with its noise; write the truth beside them."""
    from loopcal.workflow.checking import run_simulation

    done = run_simulation(project, out=out, seed=seed, function=mechanism)
    poses = len(done.simulation.dataset)
    if as_json:
        paths = {"readings": str(done.file), "truth": str(done.truth_file)}
        print_json({**paths, "poses": poses, "seed": seed})
    else:
        print_out(
            f"{poses} poses written to {done.file} (seed {seed}), the truth to {done.truth_file}"
        )


@app.command()
def new(
    name: Annotated[str, argument("NAME", "Folder of the project, NAME/project.toml.")],
    mechanism: Annotated[str | None, option("TYPE", f"One of {', '.join(TEMPLATES)}.")] = None,
    performance: Annotated[
        bool,
        flag("--performance", "Write a table to fill in for `loopcal performance` instead."),
    ] = False,
) -> None:
    """Write a commented project to start from, or a table for measurements of pose performance."""
    if performance == (mechanism is not None):
        raise UsageError(
            "one of --mechanism TYPE and --performance is needed",
            remedy="loopcal new NAME --mechanism serial, or loopcal new NAME --performance",
        )
    if mechanism is None:
        (table,) = called("new_performance")(name)
        print_out(
            f"written: {table}\n\nFill in the measured x, y, z, then:\n"
            f"  loopcal performance {quote(str(table))}"
        )
        return
    from loopcal.workflow.projects import new_project

    made = new_project(name, mechanism)
    lines = ["", "To simulate readings and calibrate:", *(f"  {line}" for line in made.commands)]
    print_out("\n".join([f"written: {', '.join(map(str, made.files))}", *lines]))


@app.command()
def demo(
    out: Annotated[str, out_option("DIR", "Write the project to this folder.")] = "loopcal-demo",
    force: ForceOption = False,
) -> None:
    """Calibrate a simulated arm without any file, and open the report."""
    from loopcal.cli.asking import open_page
    from loopcal.workflow.demonstration import run_demonstration

    done = run_demonstration(out)
    print_out(str(done))
    open_page(done.report)


@app.command()
def init(
    files: Annotated[
        list[str] | None,
        argument(
            "FILE...",
            "Readings, joined by pose ids or else by row order [default: none yet; the project "
            "serves `loopcal plan`].",
        ),
    ] = None,
    urdf: Annotated[str | None, option("FILE", "Take the robot from this URDF.")] = None,
    dh: Annotated[
        str | None,
        option(
            "FILE",
            "Take the robot from this table of Denavit-Hartenberg parameters (a, d, alpha, theta).",
        ),
    ] = None,
    machine: Annotated[
        str | None,
        option(
            "TYPE",
            "Take a type with nominal values (motoman-ma1400, linear-delta), or the machine of a "
            "mechanism file.",
        ),
    ] = None,
    base: Annotated[
        str | None,
        option("LINK", "Link that does not move [default: the one that fits]."),
    ] = None,
    tip: Annotated[
        str | None,
        option("LINK", "Link that carries the target [default: the one that fits]."),
    ] = None,
    out: Annotated[str, out_option("DIR", "Write the project to this folder.")] = "calibration",
    force: ForceOption = False,
    sheet: Annotated[
        str | None,
        option(
            "NAME",
            "Sheet of a workbook, variable of a MATLAB file or measuring topic of a ROS bag "
            "[default: the sheet with by far the most numbers].",
        ),
    ] = None,
    joints: Annotated[
        str | None,
        option(
            "COLUMNS",
            "Columns of the joints in the machine's order, such as J1,-J2,J3+J2 "
            "[default: those with which the nominal machine fits clearly best].",
        ),
    ] = None,
    leave_out: Annotated[
        str | None,
        option("COLUMNS", "Columns that take no part, such as '*_soll,v*' [default: none]."),
    ] = None,
    exclude: Annotated[
        str | None,
        option("POSES", "Poses that take no part, by id or row: P004,P012 [default: none]."),
    ] = None,
    observe: Annotated[
        list[str] | None,
        option(
            "TEXT",
            "Observe this between two bodies of a whole robot, such as 'point on=hand "
            "columns=x,y,z' or 'contact between=left,right radius=20mm,20mm'; once for each.",
        ),
    ] = None,
    infer_units: Annotated[
        bool,
        flag("--infer-units", "Take no unit from the headers: infer all by the nominal machine."),
    ] = False,
    run: Annotated[bool, flag("--run", "Calibrate at once and open the report.")] = False,
    full: FullOption = False,
) -> None:
    """Recognise readings and a robot; write a finished project."""
    from loopcal.cli.asking import ask_on_terminal, open_page
    from loopcal.cli.progress import Stages
    from loopcal.workflow.beginning.initial import initial_project
    from loopcal.workflow.beginning.robot_file import RobotFile

    if full and not run:
        raise UsageError("--full is of a calibration", remedy="add --run, or leave --full out")
    looking = tuple(observe or ())
    robot = RobotFile(
        urdf, dh, machine, base, tip, joints, leave_out, looking, infer_units, exclude
    )
    with Stages() as stages:
        done = initial_project(
            files or (), robot, out=out, sheet=sheet, ask=ask_on_terminal(), progress=stages
        )
    if not run:
        print_out(str(done))
    else:
        try:
            with below(done.inferred):
                calibrate(str(done.written[0]), full=full)
        except InputError as error:  # the project is written: this is no bad input any more
            raise NoTrustworthyResult(
                error.message, code=error.code, place=error.place, remedy=error.remedy
            ) from None
        finally:  # the report is there too where the result is not sound
            open_page(done.written[0].with_name("project-result") / "report.html")


@app.command()
def schema(
    name: Annotated[str, argument("project|result", "Which file.")],
) -> None:
    """Print the JSON Schema of project files, or of result.json."""
    from loopcal.workflow import projects

    print_json(projects.schema(name))


@app.command()
def verify(
    result: ResultArgument,
    file: ReadingsArgument,
    remounted: RemountedOption = False,
    anew: AnewOption = None,
    tolerance: Annotated[
        float | None,
        option("MM", "Require that 95 % of poses lie within this distance [default: none]."),
    ] = None,
    out: Annotated[
        str | None, out_option("FILE", "Write a page with figures to this file [default: none].")
    ] = None,
    force: ForceOption = False,
    machine_history: HistoryOption = None,
    date: DateOption = None,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Verify a calibration with readings of another day, the instrument placed anew."""
    from loopcal.workflow.checking import run_verification

    done = run_verification(
        result,
        file,
        remounted=remounted,
        anew=anew or (),
        tolerance=None if tolerance is None else 1e-3 * tolerance,
        out=out,
        keeper=keeper(machine_history, date),
        function=mechanism,
    )
    print_done(done, as_json, full=full)
    if out is not None:
        log(f"written to {out}")
    if done.failed:
        reasons = " ".join(answer.words for answer in done.failed)
        raise NoTrustworthyResult(
            reasons, code="not-verified", remedy=" ".join(a.next for a in done.failed if a.next)
        )
