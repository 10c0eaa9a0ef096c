"""What every result answers, whether it was just fitted or read from its folder."""

from __future__ import annotations

from collections.abc import ItemsView, Iterator, KeysView, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.plain import plain
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Verdict
from loopcal.errors import InputError, nearest
from loopcal.lazy import cached_property
from loopcal.mechanisms.bodies import limb

if TYPE_CHECKING:
    from pathlib import Path

    from loopcal.document.findings import Outlier
    from loopcal.document.fit import ParameterEntry
    from loopcal.document.parameter_table import ParameterTable
    from loopcal.figures.figure import Figure
    from loopcal.measurements.dataset import Dataset
    from loopcal.mechanisms.mechanism import Mechanism
    from loopcal.report.source import Source
    from loopcal.statistics.prediction import Prediction
    from loopcal.statistics.predictor import Predictor
    from loopcal.workflow.readings import Units


class Views:
    """Tables, figures and texts of a result, from its document.

    Names that users of SciPy, lmfit and statsmodels try first work as well, where they mean the
    same (`loopcal.document.aliases`).
    """

    # At run time these would become defaults of fields with the same names in dataclasses below.
    if TYPE_CHECKING:

        @property
        def document(self) -> ResultDocument: ...  # everything that result.json holds

        @property
        def unjudged(self) -> ResultDocument: ...  # at hand before any search for findings

        @property
        def predictor(self) -> Predictor: ...  # what predictions need of it

        @property
        def source(self) -> Source: ...  # what the report shows

    @property
    def converged(self) -> bool:
        """Whether the point found is the optimum; `verdict` says whether it can be used."""
        return self.unjudged.status.converged

    @property
    def verdict(self) -> Verdict | None:
        """Whether the result can be used, and for what; None: an earlier version wrote it."""
        return self.document.verdict

    @property
    def inputs(self) -> Mapping[str, Any]:
        """The project as it was read, in whose columns further readings come."""
        return self.unjudged.inputs

    @property
    def params(self) -> ParameterTable:
        """Every parameter by name [SI]: value, sd, nominal; as a DataFrame by `to_pandas()`."""
        from loopcal.document.parameter_table import ParameterTable

        return ParameterTable(self.unjudged.parameters)

    def __getitem__(self, name: str) -> ParameterEntry:
        """The parameter of this name, as `params` has it."""
        return self.params[name]

    def __iter__(self) -> Iterator[str]:
        """The names of all parameters, as of a mapping."""
        return iter(self.params)

    def __len__(self) -> int:
        return len(self.params)

    def __contains__(self, name: object) -> bool:
        return name in self.params

    def __bool__(self) -> bool:
        """True: that it is there. Whether to use it says `bool(result.verdict)`."""
        return True

    def keys(self) -> KeysView[str]:
        """The names of all parameters."""
        return self.params.keys()

    def items(self) -> ItemsView[str, ParameterEntry]:
        """Each parameter with its name."""
        return self.params.items()

    @property
    def rms(self) -> float | None:
        """Of computed minus measured outputs at the poses used [m]; None: not known."""
        accuracy = self.unjudged.accuracy
        return None if accuracy is None or accuracy.after is None else accuracy.after.rms

    @property
    def outliers(self) -> tuple[Outlier, ...] | None:
        """What does not fit, worst first; None: no reading was tested."""
        return self.document.outliers

    @property
    def plot(self) -> Plots:
        """The report's figures, as plotly figures: `result.plot.residuals()`."""
        from loopcal.report.drawn import figures

        return Plots(figures(self.source))

    @property
    def fitted_outputs(self) -> dict[str, NDArray[np.float64]]:
        """Output -> (N,) values [SI] computed from the other readings of the poses used."""
        table = self.source.table
        return {n: table.readings[n] + d for n, d in table.differences_after.items()}

    def __str__(self) -> str:
        return str(self.document)

    def summary(self) -> str:
        """The printed summary, headed by the verdict."""
        return str(self)

    def predict(self, data: Any, *, units: Units = None, **options: Any) -> Prediction:
        """`loopcal.predict` of this result: outputs for readings, with their covariance.

        data: a table or file with the columns and units of the first readings; or an array (N, n)
        of the joints in the units of these, SI where they state none. units: what to take instead,
        quantity or glob -> unit. Raises InputError for joints of an array that another unit of
        angles puts among the calibrated poses.
        """
        from loopcal.statistics.prediction import predict
        from loopcal.workflow.readings import later_readings

        return predict(self.predictor, later_readings(self, data, units, whole=False), **options)

    def fk(self, q: Any, *, units: Units = None) -> NDArray[np.float64]:
        """(N, 4, 4) of the calibrated tool in the base of its arm [m], effects included; (N, k)
        outputs of a machine that is no arm.

        q: readings as `predict` takes them; one pose (n,) gives (4, 4) or (k,).
        """
        from loopcal.companions import called
        from loopcal.workflow.readings import later_readings

        single = isinstance(q, list | tuple | np.ndarray) and np.ndim(q) == 1
        data = later_readings(self, np.atleast_2d(q) if single else q, units, whole=False)
        if self.predictor.mechanism.chain:
            poses = called("tool_poses")(self, data)
        else:
            poses = np.stack([*self.predict(data).outputs.values()], axis=-1)
        shown: NDArray[np.float64] = poses[0] if single else poses
        return shown

    def forward_kinematics(self, q: Any, *, units: Units = None) -> NDArray[np.float64]:
        """The same as `fk`."""
        return self.fk(q, units=units)

    def limb(self, body: str) -> Limb:
        """The limb that ends at a body, for a robot that has several limbs.

        It is an arm: `export`, `correct`, `predict` and `fk` work on it. Raises InputError where
        the robot has no such body.
        """
        return Limb(self, body)

    def export(self, to: str, **options: Any) -> Any:
        """`loopcal.export` of this result."""
        from loopcal.companions import called

        return called("export")(self, to, **options)

    def to_urdf(self, out: str | Path, **options: Any) -> Path:
        """Write the calibrated URDF, and return its path; options: of `loopcal.export`."""
        from pathlib import Path

        from loopcal.files.atomic import write_atomic

        files = self.export("urdf", **options).files
        write_atomic(Path(out), next(text for name, text in files.items() if name.endswith("urdf")))
        return Path(out)

    def correct(self, targets: Any, **options: Any) -> Any:
        """`loopcal.correct` of targets by this result."""
        from loopcal.companions import called

        return called("correct")(self, targets, **options)

    def report(self, out: str | Path = "report.html") -> Path:
        """`loopcal.report` of this result."""
        from loopcal.report.page import report

        return report(self, out)

    def to_html(self) -> str:
        """The page of the report."""
        from loopcal.report.page import html_of

        return html_of(self)

    def to_json(self) -> str:
        """The content of result.json as text."""
        from loopcal.files.json_files import marked_json

        return marked_json(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json as plain data."""
        from loopcal.files.versions import version

        made_by = self.document.loopcal or version()  # empty until it is written
        content: dict[str, Any] = plain(replace(self.document, loopcal=made_by))
        return content

    def _repr_html_(self) -> str:
        from loopcal.document.notebook_html import result_html

        return result_html(self.document)

    if not TYPE_CHECKING:  # a type checker shall still find misspelt names

        def __getattr__(self, name: str) -> Any:
            if hasattr(type(self), name):  # a property that failed: say what failed in it
                return object.__getattribute__(self, name)
            from loopcal.document.aliases import aliased

            return aliased(self, name)


@dataclass(frozen=True, eq=False)
class Limb(Views):
    """The limb of a result that ends at a body: `result.limb("left_hand")`.

    Its numbers are those of the whole robot.
    """

    whole: Any
    body: str

    @property
    def document(self) -> ResultDocument:
        """That of the whole robot."""
        document: ResultDocument = self.whole.document
        return document

    @property
    def unjudged(self) -> ResultDocument:
        """That of the whole robot, without its verdict."""
        document: ResultDocument = self.whole.unjudged
        return document

    @property
    def poses(self) -> Dataset | None:
        """The poses used."""
        poses: Dataset | None = self.whole.poses
        return poses

    @property
    def source(self) -> Source:
        """What the report of the whole robot shows."""
        source: Source = self.whole.source
        return source

    @property
    def shared(self) -> tuple[str, ...]:
        """Its joints that move other limbs too, as those of a waist."""
        joints, tree = self.machine.joints, self.whole.machine.tree
        paths = [{s.joint for s in tree.path(leaf) if s.joint} for leaf in tree.leaves]
        others = set[str]().union(*(path for path in paths if path - joints.keys()))
        return tuple(q for q in joints if q in others)

    @cached_property
    def machine(self) -> Mechanism:
        """The calibrated arm."""
        return limb(self.whole.machine, self.body)

    @property
    def mechanism(self) -> Mechanism:
        """The calibrated arm."""
        return self.machine

    @cached_property
    def predictor(self) -> Predictor:
        """What predictions need."""
        whole: Predictor = self.whole.predictor
        return replace(whole, mechanism=limb(whole.mechanism, self.body))


@dataclass(frozen=True)
class Plots:
    """The report's figures of a result, as plotly figures; they show themselves in a notebook."""

    drawn: Mapping[str, Figure]

    def __call__(self) -> Any:
        """The same as `residuals`."""
        return self.residuals()

    def __repr__(self) -> str:
        return "<Plots: residuals(), space(), parameters(), correlations()>"

    def __getattr__(self, name: str) -> Any:
        figures = [n for n in dir(type(self)) if not n.startswith("_") and n != "drawn"]
        raise AttributeError(f"no figure is called {name!r}: {nearest(name, figures)}")

    def residuals(self) -> Any:
        """Computed minus measured outputs pose by pose, before and after."""
        return self._figure("residuals")

    def space(self) -> Any:
        """Arrows from measured to computed points, and the machine."""
        return self._figure("arrows")

    def parameters(self) -> Any:
        """Changes of the parameters from their nominal values, with 95 % intervals."""
        return self._figure("parameters")

    def correlations(self) -> Any:
        """Correlations of the estimated parameters, as a map."""
        return self._figure("correlations")

    def _figure(self, key: str) -> Any:
        if key not in self.drawn:
            raise InputError(
                f"the result has no numbers for the figure {key!r}",
                code="no-data",
                remedy=f"draw one of: {', '.join(self.drawn)}",
            )
        return self.drawn[key].plotly()
