"""A calibration written in the format of a controller or simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.deployment.exporting import exported
from loopcal.document.exported import Exported, accuracy_lines
from loopcal.document.verdict import Verdict
from loopcal.errors import InputError, nearest
from loopcal.files.exports.format import VENDORS, ExportOptions, Format
from loopcal.files.exports.geometry_json import accuracy
from loopcal.files.exports.placing import PlacedFiles, place_files
from loopcal.files.exports.registry import format_named
from loopcal.files.machines.python_function import load_function
from loopcal.files.result.deployed import EXPORT, note_deployed
from loopcal.files.result.result_poses import read_result_poses
from loopcal.presentation.shown import with_unit
from loopcal.statistics.predictor import predictor, predictor_of
from loopcal.workflow.given import result_of
from loopcal.workflow.saved_result import SavedResult, read_result

OFFSETS = ("origin", "file")


@dataclass(frozen=True, eq=False)
class Export:
    """A calibrated machine in one format.

    format: its name; files: name -> content; machine: what was exported, SI; warnings; placed:
    where the files were written, None where they were not.
    """

    format: str
    files: Mapping[str, bytes]
    machine: Exported
    warnings: tuple[str, ...]
    placed: PlacedFiles | None = None

    def document(self) -> dict[str, Any]:
        """As one JSON document."""
        placed = self.placed
        return {
            "format": self.format,
            "folder": None if placed is None else str(placed.folder),
            "files": sorted(self.files),
            "written": [] if placed is None else list(placed.written),
            "unchanged": [] if placed is None else list(placed.unchanged),
            "backups": [] if placed is None else list(placed.backups),
            "accuracy": [accuracy(one) for one in self.machine.accuracy],
            "omitted": list(self.machine.omitted),
            "warnings": list(self.warnings),
        }

    def __str__(self) -> str:
        lines = []
        if self.placed is not None:
            folder = self.placed.folder
            lines += [f"written: {folder / name}" for name in self.placed.written]
            lines += [f"unchanged: {folder / name}" for name in self.placed.unchanged]
            lines += [f"backup: {folder / name}" for name in self.placed.backups]
        table = accuracy_lines(self.machine)
        lines += ["", *table] if table else []
        for warning in self.warnings:
            lines += ["", f"WARNING  {warning}"]
        return "\n".join(lines).lstrip("\n")


def export(
    result: Any,
    to: str,
    *,
    out: str | Path | None = None,
    source: str | Path | None = None,
    offsets: str = "origin",
    vendor: str | None = None,
    counts: Mapping[str, float] | None = None,
    force: bool = False,
) -> Export:
    """A calibrated machine in a format for its controller, description or simulator.

    result: of `calibrate` or `read_result`, or the path of its folder; to: "urdf", "xacro", "ur",
    "dh", "mdh", "mjcf", "sdf", "zeros", "frames" or "json"; out: folder in which the files are
    written, none are without it; source: the user's own file, for "urdf" the URDF that was
    calibrated; offsets: "origin", or "file" where the controller adds the zero offsets itself;
    vendor: "kuka", "fanuc", "yaskawa" or "abb", whose orientation convention "frames" follows;
    counts: joint -> encoder counts per degree (of a slide per mm), for "zeros"; force: replace
    files that exist, keeping backups.

    Effects beyond geometry are left out and the geometry is refitted to the full model's
    predictions in the working region (`Export.machine.accuracy` states what that costs).

    Raises InputError for a format that the machine does not have, a source of another robot, and a
    file that exists with another content.
    """
    one = format_named(to)
    _check_options(one, source, offsets, vendor)
    given = result_of(result)
    if isinstance(given, SavedResult):
        document, mechanism = given.document, given.mechanism
        poses = read_result_poses(given.path.parent, mechanism)
        known = None if document.prediction is None else predictor_of(document, mechanism)
    else:
        document, mechanism, poses = given.document, given.calibrated, given.dataset
        known = predictor(given)
    machine = exported(document, mechanism, poses, known, offsets_apart=offsets == "file")
    _check_machine(one, machine, source)
    its = ExportOptions(None if source is None else Path(source), vendor, dict(counts or {}))
    done = one.write(machine, its)
    files = {n: c.encode() if isinstance(c, str) else c for n, c in done.files.items()}
    warnings = (
        *_verdict(document.verdict),
        *_cost(one, machine),
        *_worse(one, machine),
        *done.warnings,
    )
    placed = None if out is None else place_files(out, files, force=force)
    return Export(one.name, files, machine, (*warnings, *machine.warnings), placed)


def run_export(
    result: str | Path, to: str, *, out: str | Path | None = None, function: str | None = None,
    **options: Any,
) -> Export:  # fmt: skip
    """`export` of a folder, by default into its folder `export`; function: the loops, for a machine
    written in Python. The report of the result shows it."""
    loops = None if function is None else load_function(function)
    read = read_result(result, mechanism=loops)
    done = export(read, to, out=read.path.parent / "export" if out is None else out, **options)
    note_deployed(read.path, EXPORT, done.format, done.document())
    return done


def _check_options(one: Format, source: Any, offsets: str, vendor: str | None) -> None:
    """Raise InputError for options that the format does not take."""
    if offsets not in OFFSETS:
        raise InputError(
            f"offsets is {offsets!r}", code="unknown-name", remedy="give 'origin' or 'file'"
        )
    if vendor is not None and vendor not in VENDORS:
        raise InputError(
            f"there is no vendor {vendor!r}", code="unknown-name", remedy=nearest(vendor, VENDORS)
        )
    if source is not None and not one.source:
        raise InputError(
            f"the format {one.name!r} takes no source",
            code="conflicting-keys",
            remedy="remove --source",
        )
    if offsets == "file" and one.needs != "origins":
        raise InputError(
            f"the format {one.name!r} keeps no zero offsets apart",
            code="conflicting-keys",
            remedy="remove --offsets; 'zeros' tables what to enter in the controller",
        )


_LACKS = {
    "chain": "it is not a serial arm in space",
    "origins": "its joints are not described by origins, as those of a URDF are",
    "zeros": "it is not a serial arm in space, or nothing measures it",
}


def _check_machine(one: Format, machine: Exported, source: Any) -> None:
    """Raise InputError for a machine that a format cannot hold, and for a lacking source."""
    there = {
        "parameters": True,
        "chain": machine.chain is not None,
        "origins": bool(machine.origins),
        "zeros": bool(machine.zeros),
    }
    if not there[one.needs]:
        raise InputError(
            f"{machine.name!r} cannot be exported as {one.name!r}: {_LACKS[one.needs]}",
            code="unsupported",
            remedy="export 'json': all parameters by name"
            if one.needs != "origins"
            else "export 'mjcf', 'sdf', 'dh' or 'json'",
        )
    if one.source and not one.optional and source is None:
        raise InputError(
            f"the format {one.name!r} needs {one.source}",
            code="missing-key",
            remedy="name the file: --source FILE",
        )


def _verdict(verdict: Verdict | None) -> tuple[str, ...]:
    if verdict is None or verdict.grade != "bad":
        return ()
    return (f"The verdict on this calibration: {verdict.headline}",)


def _cost(one: Format, machine: Exported) -> tuple[str, ...]:
    """What the format leaves out, and what that costs."""
    if not machine.omitted or one.nominal:
        return ()
    names = ", ".join(machine.omitted)
    geometry, full = machine.of("geometry"), machine.of("full")
    if geometry is None or geometry.from_full is None:
        return (f"Effects beyond geometry are left out: {names}.",)
    cost = with_unit(geometry.from_full.rms, "m")
    words = (
        f"Effects beyond geometry are left out: {names}. The geometry was refitted to the full "
        f"model and differs from it by {cost} rms in the working region."
    )
    if geometry.measured is not None and full is not None and full.measured is not None:
        words += (
            f" At the measured poses it is accurate to {with_unit(geometry.measured.rms, 'm')} "
            f"rms, the full model to {with_unit(full.measured.rms, 'm')}."
        )
    return (words,)


def _worse(one: Format, machine: Exported) -> tuple[str, ...]:
    """Whether zeros and tool alone would make the arm less accurate where it was measured."""
    alone, nominal = machine.of("zeros and tool"), machine.of("nominal")
    if one.needs != "zeros" or not alone or not nominal:
        return ()
    after, before = alone.measured, nominal.measured
    if not after or not before or after.rms <= before.rms:
        return ()
    return (
        f"Zeros and tool alone make the arm worse at the measured poses: "
        f"{with_unit(after.rms, 'm')} rms, {with_unit(before.rms, 'm')} without them. "
        "Keep the controller's zeros and correct the targets instead.",
    )
