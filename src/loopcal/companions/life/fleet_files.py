"""Results of several machines of one type, and the start of the next project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from loopcal.companions.life.fleet import Fleet, learn
from loopcal.companions.life.measured_machine import MeasuredMachine
from loopcal.errors import InputError, UsageError
from loopcal.files.atomic import Data, write_all
from loopcal.files.result.deployed import FLEET, note_deployed, result_path
from loopcal.files.toml.writer import document
from loopcal.statistics.calibrated import Calibrated
from loopcal.workflow.resolved import result_of
from loopcal.workflow.result import Result
from loopcal.workflow.saved_result import SavedResult, read_result


@dataclass(frozen=True, eq=False)
class FleetDone:
    """A fleet, and what was written of it: a part of a project file, and a page."""

    fleet: Fleet
    written: tuple[Path, ...]


def run_fleet(
    results: Sequence[str | Path],
    *,
    out: str | Path = "fleet.toml",
    report: bool = False,
    function: str | None = None,
) -> FleetDone:
    """Compare the results of folders and write where the next project begins, with a page beside.

    Raises InputError for what cannot be read, compared or written.
    """
    comparison = learn([_measured(read_result(path, mechanism=function), "") for path in results])
    # prior_sd is of one more machine: that of the spread is in it (docs/decisions/0084).
    starts = {
        "parameters": {p.name: {"value": p.mean, "unit": p.unit} for p in comparison.parameters},
        "prior": {p.name: {"sd": p.prior_sd, "unit": p.unit} for p in comparison.parameters},
    }
    remarks = (
        f"Where the next machine of this type begins: {comparison.machine}.",
        f"Learnt from {len(comparison.machines)} machines. Put this into its project file.",
        "value: mean of the machines; sd: of one more machine, lengths in m, angles in rad.",
    )
    written: dict[Path, Data] = {Path(out): document(starts, remarks)}
    if report:
        from loopcal.companions.life.pages import fleet_html

        names = ", ".join(result_path(path).parent.name for path in results)
        page = Path(out).with_suffix(".html")
        if page in written:
            raise UsageError(
                "--out is the page itself", remedy="name a .toml file; the page comes beside it"
            )
        written[page] = fleet_html(comparison, names)
    write_all(written)
    for path in results:
        note_deployed(result_path(path), FLEET, Path(out).stem, comparison.document())
    return FleetDone(comparison, tuple(written))


def fleet(results: Sequence[Result | SavedResult | str | Path]) -> Fleet:
    """Learn what machines of one type have in common, and which one is unusual.

    results: one of each machine, at least three; in memory or as folders. Each parameter of the
    machine is p_r ~ N(mean, spread^2), the spread by restricted likelihood (Patterson and Thompson
    1971) with limits by Q (Viechtbauer 2007). Placement and mounting do not count.

    Raises InputError for fewer than three results, and for machines of several types.
    """
    return learn([_measured(result_of(one), f"result {i}") for i, one in enumerate(results, 1)])


def _measured(result: Result | SavedResult, name: str) -> MeasuredMachine:
    """name: of a result in memory."""
    document = result.unjudged
    calibrated = Calibrated.of(result, name) if isinstance(result, Result) else result.calibrated
    if not result.converged:
        raise InputError(
            f"the result {calibrated.name!r} did not converge",
            code="not-converged",
            remedy="calibrate this machine again, or leave it out",
        )
    return MeasuredMachine.of(calibrated, document.data.used, updated=document.updated)
