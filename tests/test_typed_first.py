"""What people type first in Python: each call works, or one sentence names the call that does."""

from __future__ import annotations

import json
import pydoc
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import polars as pl
import pytest

import loopcal as lc
from tests.command_line import run_here as run

JOINTS = [f"joint_{i}" for i in range(1, 7)]
FAST = {"method": "least-squares"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A robot, its readings in all the ways in which people hold them, and results."""
    folder = tmp_path_factory.mktemp("typed")
    run("new", "robot", "--mechanism", "urdf", cwd=folder)
    out = ("--out", "robot/poses.csv", "--seed", "1")
    assert run("simulate", "robot/project.toml", *out, cwd=folder).returncode == 0
    columns = {**dict.fromkeys(JOINTS, "rad"), **dict.fromkeys("xyz", "mm")}
    csv = folder / "robot" / "poses.csv"
    read = lc.read_dataset(csv, {name: name for name in columns}, units=columns)
    q = np.column_stack([read[name] for name in JOINTS])
    p = 1e3 * np.column_stack([read[axis] for axis in "xyz"])
    degrees = {f"J{i + 1}": np.degrees(q[:, i]) for i in range(6)}
    table = {**degrees, **{axis: p[:, i] for i, axis in enumerate("xyz")}}
    pl.DataFrame(degrees).write_csv(folder / "joints.csv")
    pl.DataFrame({axis: table[axis] for axis in "xyz"}).write_csv(folder / "tracker.csv")
    df = pd.DataFrame(table)
    urdf = folder / "robot" / "robot.urdf"
    result: Any = lc.calibrate(df, urdf=urdf, **FAST)
    result.save(folder / "result")
    return SimpleNamespace(
        folder=folder,
        urdf=str(urdf),
        project=str(folder / "robot" / "project.toml"),
        csv=str(csv),
        table=table,
        df=df,
        q=q,
        deg=np.degrees(q),
        xyz=p,
        result=result,
        saved=lc.load(folder / "result"),
        # Its mechanism has quantities that stand for the error of the model, which no user reads.
        learnt=lc.calibrate(df, urdf=urdf, method="implicit-loop", model_error="structured"),
        robot=lc.load_urdf(urdf),
        rms=lc.init(df, urdf=urdf).rms,
    )


Call = Callable[[SimpleNamespace], Any]
# A calibration takes a second: those of other tables are compared by what `init` made of them.
CALLS: dict[str, Call] = {
    "len(result)": lambda m: len(m.result) == len(m.result.params) > 0,
    "name in result": lambda m: "joint_2_x" in m.saved and "q" not in m.saved,
    "dict(result)": lambda m: [*dict(m.result)] == [*m.result.keys()] == [*m.result],
    "robot._repr_html_()": lambda m: "joint_2_x" in m.robot._repr_html_(),
    "lc.calibrate(df, urdf=)": lambda m: m.result.converged,
    "lc.calibrate(joints, tracker, urdf=)": lambda m: (
        lc.calibrate(
            str(m.folder / "joints.csv"), m.folder / "tracker.csv", urdf=m.urdf, **FAST
        ).rms
        == pytest.approx(m.result.rms, rel=1e-6)
    ),
    "lc.init(polars)": lambda m: same(m, pl.DataFrame(m.table)),
    "lc.init(dict of arrays)": lambda m: same(m, m.table),
    "lc.init(dict of two arrays)": lambda m: same(m, {"q": m.deg, "p": m.xyz}),
    "lc.init(q, xyz)": lambda m: same(m, m.deg, m.xyz),
    "lc.init(joints df, points df)": lambda m: same(m, m.df[[f"J{i}" for i in range(1, 7)]], m.xyz),
    "lc.init([file, file])": lambda m: (
        len(lc.init([m.folder / "joints.csv", m.folder / "tracker.csv"], urdf=m.urdf).dataset)
        == 100
    ),
    "result[name]": lambda m: m.result["tool_x"] == m.result.params["tool_x"],
    "learnt.fk(q)": lambda m: (
        m.learnt.mechanism.disturbances and m.learnt.fk(m.deg).shape == (100, 4, 4)
    ),
    "learnt.predict((N, 6))": lambda m: predicts(m, m.learnt.predict(m.deg)),
    "lc.init(file)": lambda m: lc.init(m.csv, urdf=m.urdf).rms < 0.02,
    "lc.check(df, urdf=)": lambda m: lc.check(m.df, urdf=m.urdf).verdict,
    "lc.calibrate(project)": lambda m: lc.calibrate(lc.load(m.project), **FAST).converged,
    "saved.status": lambda m: m.saved.status.converged,
    "saved.corrections": lambda m: len(m.saved.corrections["x"]) == 100,
    "lc.load(result folder)": lambda m: m.saved.converged,
    "lc.load(result.json)": lambda m: lc.load(m.folder / "result" / "result.json").converged,
    "lc.load(project)": lambda m: isinstance(lc.load(m.project), lc.Project),
    "lc.load(urdf)": lambda m: isinstance(lc.load(m.urdf), lc.Machine),
    "lc.load_urdf(path, base, tip)": lambda m: lc.load_urdf(m.urdf).quantities,
    "lc.report(result)": lambda m: lc.report(m.result, m.folder / "a.html").is_file(),
    "lc.report(folder)": lambda m: lc.report(m.folder / "result", m.folder / "b.html").is_file(),
    "lc.plot(result)": lambda m: lc.plot(m.result).data,
    "lc.export(result, 'urdf')": lambda m: lc.export(m.result, "urdf").files,
    "lc.predict(result, df)": lambda m: predicts(m, lc.predict(m.saved, m.df)),
    "lc.verify(result, df)": lambda m: lc.verify(m.result, m.df).poses,
    "lc.plan(result, 5)": lambda m: lc.plan(m.result, 5, noise={"*": 1e-4}).poses,
    "lc.verify(result, file, file)": lambda m: (
        lc.verify(m.result, m.folder / "joints.csv", m.folder / "tracker.csv").worst
    ),
    "lc.simulate(result, q)": lambda m: (
        len(lc.simulate(m.result, dict(zip(JOINTS, m.q.T, strict=True)), noise={"*": 0.0}).dataset)
        == 100
    ),
    "result.predict(array in rad)": lambda m: predicts(
        m, m.result.predict(m.q, units={"joint_*": "rad"})
    ),
    "result.predict(one pose)": lambda m: (
        len(m.result.predict({f"J{i + 1}": v for i, v in enumerate(m.deg[0])}).outputs["x"]) == 1
    ),
    "result.fk(q, units='rad')": lambda m: m.result.fk(m.q, units="rad").shape == (100, 4, 4),
    "result.to_json() version": lambda m: json.loads(m.result.to_json())["loopcal"] != "",
    "lc.calibrate(df, 'robot.urdf')": lambda m: lc.calibrate(m.df, m.urdf, **FAST).converged,
    "lc.Dataset(df)": lambda m: len(lc.Dataset(m.df)) == len(lc.Dataset(m.table)) == 100,
    "len(robot)": lambda m: len(m.robot) == 6,
    "robot(q)": lambda m: np.array_equal(m.robot(m.q), m.robot.fk(m.q)),
    "robot.fk(q)": lambda m: m.robot.fk(m.q[0]).shape == (4, 4),
    "robot.fk(list)": lambda m: m.robot.fk([0.0] * 6).shape == (4, 4),
    "robot.fk((N, 6))": lambda m: m.robot.fk(m.q).shape == (100, 4, 4),
    "robot.fk(mapping)": lambda m: m.robot.fk(dict.fromkeys(JOINTS, 0.1)).shape == (4, 4),
    "robot.forward_kinematics(q)": lambda m: m.robot.forward_kinematics(m.q[0]).shape == (4, 4),
    "mechanism.fk(q)": lambda m: m.result.mechanism.fk(m.q).shape == (100, 4, 4),
    "result.predict(df)": lambda m: predicts(m, m.result.predict(m.df)),
    "result.predict(joints only)": lambda m: predicts(m, m.result.predict(m.df.iloc[:, :6])),
    "result.predict(polars)": lambda m: predicts(m, m.result.predict(pl.DataFrame(m.table))),
    "result.predict(array)": lambda m: predicts(m, m.result.predict(m.deg)),
    "saved.predict(df)": lambda m: predicts(m, m.saved.predict(m.df)),
    "result.fk(df)": lambda m: m.result.fk(m.df).shape == (100, 4, 4),
    "result.fk(q)": lambda m: m.result.fk(m.deg[0]).shape == (4, 4),
    "result.forward_kinematics(q)": lambda m: m.saved.forward_kinematics(m.deg[:2]).shape[0] == 2,
    "result.to_urdf(path)": lambda m: "<robot" in m.result.to_urdf(m.folder / "o.urdf").read_text(),
    "result.export('urdf')": lambda m: m.saved.export("urdf").files,
    "result.predict(df).to_dataframe()": lambda m: (
        len(m.result.predict(m.df).to_dataframe()) == 100
    ),
    "result.correct(df)": lambda m: "joint" in str(m.result.correct(m.df.iloc[:2])),
    "result.to_dataframe()": lambda m: "sd" in m.result.to_dataframe().columns,
    "result.params.to_dataframe()": lambda m: len(m.result.params.to_dataframe()) > 6,
    "result.rms": lambda m: m.result.rms == m.saved.rms,
    "result.outliers": lambda m: isinstance(m.result.outliers, tuple),
    "result.plot()": lambda m: m.result.plot().data,
    "result.plot.residuals()": lambda m: m.result.plot.residuals().data,
    "result.report(path)": lambda m: m.result.report(m.folder / "r.html").is_file(),
    "result.to_html()": lambda m: m.saved.to_html().startswith("<!"),
    "result.to_json()": lambda m: json.loads(m.result.to_json())["schema"],
    "bool(result.verdict)": lambda m: bool(m.result.verdict) is m.result.verdict.ok is False,
    "print(result)": lambda m: judged_first(m.result),
    "help(lc)": lambda m: len(pydoc.plain(pydoc.render_doc(lc)).splitlines()) <= 80,
    "dir(lc)": lambda m: dir(lc) == sorted(lc.__all__),
}
MISSES: dict[str, tuple[Call, type[Exception], str]] = {
    "result.residuals": (lambda m: m.result.residuals, AttributeError, "result.plot.residuals()"),
    "result.predicts": (lambda m: m.result.predicts, AttributeError, "did you mean 'predict'?"),
    "lc.load(result)": (lambda m: lc.load(m.result), lc.InputError, "folder of a result"),
    "lc.record(result)": (lambda m: lc.record(m.result), lc.InputError, "result.save(folder)"),
    "lc.performance(df)": (lambda m: lc.performance(m.df), lc.InputError, "to_csv"),
    "result.predict([])": (lambda m: m.result.predict([]), lc.InputError, "(N, 6) numbers"),
    "from_function(number)": (
        lambda m: lc.Mechanism.from_function(cast(Any, 5), {"x": "m"}, {"a": (0.0, "m")}),
        lc.InputError,
        "a function f(x, p)",
    ),
    "lc.calibrat": (lambda m: lc.calibrat, AttributeError, "did you mean 'calibrate'?"),
    "lc.read_csv": (lambda m: lc.read_csv, AttributeError, "lc.read_dataset"),
    "lc.demo": (lambda m: lc.demo, AttributeError, "loopcal demo"),
    "lc.hand_eye": (lambda m: lc.hand_eye, AttributeError, "images"),
    "lc.from_urdf": (lambda m: lc.from_urdf, AttributeError, "lc.load_urdf"),
    "result.verify": (lambda m: m.result.verify, AttributeError, "lc.verify(result, readings)"),
    "result.plot.errors": (lambda m: m.result.plot.errors, AttributeError, "'residuals'"),
    "lc.kinematics": (lambda m: lc.kinematics, AttributeError, "lc.load_urdf('robot.urdf').fk(q)"),
    "lc.URDF": (lambda m: lc.URDF, AttributeError, "lc.load_urdf"),
    "lc.minimize": (lambda m: lc.minimize, AttributeError, "lc.calibrate"),
    "lc.from_pandas": (lambda m: lc.from_pandas, AttributeError, "lc.calibrate(readings"),
    "lc.qwertz": (lambda m: lc.qwertz, AttributeError, "help(loopcal)"),
    "Mechanism.from_urdf": (
        *(lambda m: lc.Mechanism.from_urdf(m.urdf), AttributeError, "lc.load_urdf(path)"),
    ),
    "lc.Mechanism(urdf)": (lambda m: lc.Mechanism(*[m.urdf]), lc.InputError, "lc.load_urdf"),
    "Dataset.from_pandas": (
        *(lambda m: lc.Dataset.from_pandas(m.df), AttributeError, "Dataset.from_arrays"),
    ),
    "list(result.findings)": (
        *(lambda m: list(m.result.findings), TypeError, "result.document.findings"),
    ),
    "result.findings[0]": (
        *(lambda m: m.result.findings[0], TypeError, "result.document.findings"),
    ),
    "result.score(df)": (lambda m: m.result.score, AttributeError, "result.rms"),
    "result.transform(df)": (lambda m: m.result.transform, AttributeError, "result.correct"),
    "result.to_pickle": (lambda m: m.result.to_pickle, AttributeError, "result.save(folder)"),
    "result.show()": (lambda m: m.saved.show, AttributeError, "result.report()"),
    "robot.fkine": (lambda m: m.robot.fkine, AttributeError, "robot.fk(q)"),
    "robot.jacob0": (lambda m: m.robot.jacob0, AttributeError, "lc.correct"),
    "robot.links": (lambda m: m.robot.links, AttributeError, "robot.parameters"),
    "robot[0]": (lambda m: m.robot[0], TypeError, "robot.quantities"),
    "list(robot)": (lambda m: [*m.robot], TypeError, "robot.parameters"),
    "lc.Result.load(folder)": (lambda m: lc.Result.load("a"), AttributeError, "lc.load(folder)"),
    "result.interval": (lambda m: m.result.interval, AttributeError, "lc.intervals(result)"),
    "lc.Noise(sd)": (lambda m: lc.Noise(*m.xyz[:1]), lc.InputError, "dict of sds by quantity"),
    "lc.Prior(sd)": (lambda m: lc.Prior(*m.xyz[:1]), lc.InputError, "dict of sds by parameter"),
    "lc.read_bag(csv)": (lambda m: lc.read_bag(m.csv), lc.InputError, "lc.read_dataset"),
    "lc.simulate(mechanism, q)": (
        lambda m: lc.simulate(m.result.mechanism, dict(zip(JOINTS, m.q.T, strict=True))),
        lc.InputError,
        'Noise({"*": 0.0})',
    ),
    "lc.calibrate(points=)": (
        lambda m: lc.calibrate(joints=m.q, points=m.xyz, urdf=m.urdf),
        TypeError,
        "lc.calibrate(joints, points, urdf=",
    ),
    "lc.calibrate(dh=rows)": (
        lambda m: lc.calibrate(m.df, dh=[[0.0, 1.0, 0.0, 0.0]]),
        lc.InputError,
        "to_csv('dh.csv')",
    ),
    "robot.quantitis": (lambda m: m.robot.quantitis, AttributeError, "'quantities'"),
    "lc.save": (lambda m: lc.save, AttributeError, "result.save(folder)"),
    "result.chi2": (lambda m: m.result.chi2, AttributeError, "result.chi_squared"),
    "result.to_csv": (lambda m: m.result.to_csv, AttributeError, "result.to_pandas()"),
    "result.corr": (lambda m: m.result.corr, AttributeError, "result.plot.correlations()"),
    "result.dh": (lambda m: m.saved.dh, AttributeError, "result.export('dh')"),
    "robot.dof": (lambda m: m.robot.dof, AttributeError, "len(robot)"),
    "result.predict(radians)": (*(lambda m: m.result.predict(m.q), lc.InputError, "units='rad'"),),
    "saved.fk(radians)": (lambda m: m.saved.fk(m.q[0]), lc.InputError, "units='rad'"),
    "lc.plan(robot, 5)": (lambda m: lc.plan(m.robot, 5), lc.InputError, "lc.assemble"),
    "robot.calibrate(df)": (lambda m: m.robot.calibrate(m.df), AttributeError, "lc.calibrate"),
    "lc.simulate(project, 5)": (
        *(lambda m: lc.simulate(m.project, 5), lc.InputError, "lc.random_poses"),
    ),
    "project.check()": (lambda m: lc.load(m.project).check(), AttributeError, "lc.check(project)"),
    "init.calibrate()": (
        *(
            lambda m: begun(m).calibrate,
            AttributeError,
            "lc.calibrate(p",
        ),
    ),
    "init.predict(df)": (
        *(
            lambda m: begun(m).predict,
            AttributeError,
            "lc.calibrate(",
        ),
    ),
    "result.plan(5)": (lambda m: m.result.plan(5), AttributeError, "lc.plan(result"),
    "robot.ik": (lambda m: m.robot.ik, AttributeError, "lc.correct"),
    "lc.calibrate(df)": (lambda m: lc.calibrate(m.df), lc.InputError, "urdf='robot.urdf'"),
    "lc.calibrate()": (lambda m: lc.calibrate(), lc.InputError, "lc.calibrate(readings, urdf="),
    "lc.calibrate(csv)": (lambda m: lc.calibrate(m.csv), lc.InputError, "urdf='robot.urdf'"),
    "lc.calibrate(robot, df)": (
        *(lambda m: lc.calibrate(m.robot, m.df), lc.InputError, "lc.assemble"),
    ),
    "lc.calibrate(metod=)": (
        *(lambda m: lc.calibrate(m.df, urdf=m.urdf, metod="a"), TypeError, "mean 'method'?"),
    ),
    "lc.predict(df, df)": (lambda m: lc.predict(m.df, m.df), lc.InputError, "lc.read_result"),
    "lc.init(df)": (lambda m: lc.init(m.df), lc.LoopcalError, "urdf=FILE"),
    "robot.fk(five)": (lambda m: m.robot.fk([0.0] * 5), lc.InputError, "'joint_6'"),
    "robot.fk(a name)": (lambda m: m.robot.fk({"joint1": 0.0}), lc.InputError, "'joint1'"),
}


def same(m: SimpleNamespace, *readings: Any) -> bool:
    """Whether `init` makes of these what it made of the DataFrame."""
    return bool(
        lc.init(*readings, urdf=m.urdf).rms == pytest.approx(lc.init(m.df, urdf=m.urdf).rms)
    )


def predicts(m: SimpleNamespace, prediction: lc.Prediction) -> bool:
    """Whether the outputs are what was measured, but for the noise [m]."""
    return bool(np.abs(1e3 * prediction.outputs["x"] - m.xyz[:, 0]).max() < 1.0)


def begun(m: SimpleNamespace) -> Any:
    return lc.init(m.df, urdf=m.urdf)


def judged_first(result: lc.Result) -> bool:
    """The title, the headline, the four answers."""
    head = str(result).partition("converged in")[0].split()
    return all(word in head for word in ("sound", "valid", "better", "tolerance", "care:"))


@pytest.mark.parametrize("call", CALLS)
def test_it_works(call: str, made: SimpleNamespace) -> None:
    assert CALLS[call](made)


def test_there_are_fifty() -> None:
    assert len(CALLS) >= 50


@pytest.mark.parametrize("call", MISSES)
def test_a_miss_names_the_call_that_does(call: str, made: SimpleNamespace) -> None:
    do, kind, words = MISSES[call]
    with pytest.raises(kind) as caught:
        do(made)
    assert words in str(caught.value)
    assert "--" not in str(caught.value)


def test_the_command_line_keeps_its_options(made: SimpleNamespace) -> None:
    refused = run("init", made.csv)
    assert refused.returncode == 2
    assert "--urdf FILE" in refused.stderr


def test_nominal_and_calibrated_kinematics_agree_where_nothing_was_learnt(
    made: SimpleNamespace,
) -> None:
    """The tool on a result's last link, seen from the base, is the link's pose times the tool's."""
    result = made.result
    value = {name: result.value[name] for name in result.value}
    T = result.machine.fk(made.q[:3])
    tool = np.array([value["tool_x"], value["tool_y"], value["tool_z"]])
    expected = T[:, :3, :3] @ tool + T[:, :3, 3]
    np.testing.assert_allclose(result.fk(made.deg[:3])[:, :3, 3], expected, atol=1e-9)


def test_a_repr_is_short_and_html_is_there(made: SimpleNamespace) -> None:
    result = made.result
    project = lc.load(made.project)
    values = [result, made.saved, project, project.mechanism, made.robot, result.verdict]
    values += [result.findings, result.document, result.plot, result.predictor, result.source]
    values += [result.predict(made.df), lc.check(made.project), lc.compare(result, result)]
    values += [result.export("urdf"), result.dataset, lc.init(made.df, urdf=made.urdf)]
    for value in values:
        assert len(repr(value)) < 400, type(value).__name__
    for value in (project, project.mechanism, lc.init(made.df, urdf=made.urdf), result):
        assert "<table>" in value._repr_html_()
