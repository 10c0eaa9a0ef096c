"""A calibration written in the format of a controller or simulator."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loopcal.companions.robot.arms import refuse_limbs
from loopcal.companions.robot.exporting import exported
from loopcal.companions.robot.exports.format import (
    ExportFiles,
    ExportOptions,
    Format,
    PlacedFiles,
    place_files,
)
from loopcal.companions.robot.exports.geometry_json import accuracy
from loopcal.companions.robot.exports.registry import EXPORTS, format_named
from loopcal.companions.robot.exports.tables import ORIENTATIONS
from loopcal.document.exported import Exported, accuracy_lines
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Verdict
from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.machines.mechanism_writer import source_file
from loopcal.files.outputs import one_command
from loopcal.files.project.project_data import computed_joints
from loopcal.files.result.deployed import EXPORT, PREVIEW, note_deployed
from loopcal.presentation.shown import brief, with_unit
from loopcal.workflow.resolved import result_of
from loopcal.workflow.saved_result import read_result

OFFSETS = ("origin", "file")


@dataclass(frozen=True, eq=False)
class Export:
    """A calibrated machine in one format.

    format: its name; files: name -> content; machine: what was exported, SI; warnings; placed:
    where the files were written, None where they were not.
    """

    __repr__ = brief

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


@one_command
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

    result: of `calibrate` or `read_result`, or the path of its folder; to: the format, such as
    "urdf" or "json" (`loopcal export --help` lists all); out: folder in which the files are
    written, none are without it; source: the user's own file, for "urdf" the URDF that was
    calibrated; offsets: "origin", or "file" where the controller adds the zero offsets itself;
    vendor: whose orientation convention "frames" follows, such as "kuka"; counts: joint -> encoder
    counts per degree (of a slide per mm), for "zeros"; force: replace files that exist, keeping
    backups.

    Effects beyond geometry are left out and the geometry is refitted to the full model's
    predictions in the working region (`Export.machine.accuracy` states what that costs).

    Raises InputError for a format that the machine does not have, a source of another robot, and a
    file that exists with another content.
    """
    one = format_named(to)
    _check_options(one, source, offsets, vendor, counts)
    calibration = result_of(result)
    document, mechanism = calibration.document, calibration.machine
    predictor = None if document.prediction is None else calibration.predictor
    if one.needs == "chain":
        words = f"{one.name!r} holds one arm, and {mechanism.name!r} has several limbs"
        refuse_limbs(mechanism, calibration.poses, words)
    apart = offsets == "file"
    machine = exported(document, mechanism, calibration.poses, predictor, offsets_apart=apart)
    options = ExportOptions(None if source is None else Path(source), vendor, dict(counts or {}))
    done = _written(one, machine, options, source_file(mechanism))
    files = {n: c.encode() if isinstance(c, str) else c for n, c in done.files.items()}
    warnings = (
        *_verdict(document.verdict),
        *_cost(one, machine),
        *_worse(one, machine),
        *(_computed(document) if one.name == "zeros" else ()),
        *done.warnings,
    )
    placed = None if out is None else place_files(out, files)
    return Export(one.name, files, machine, (*warnings, *machine.warnings), placed)


def _computed(document: ResultDocument) -> tuple[str, ...]:
    """That the zeros are those of joints which the controller counts in another way."""
    if not (computed := computed_joints(document.inputs)):
        return ()
    return (
        f"The calibration reads {', '.join(computed)}. These zeros count as the machine's joints "
        "do: convert them before you enter them in the controller.",
    )


def run_export(
    result: str | Path, to: str, *, out: str | Path | None = None, function: str | None = None,
    limb: str | None = None, **options: Any,
) -> Export:  # fmt: skip
    """`export` of a folder, by default into its folder `export`; function: the loops, for a machine
    written in Python; limb: the body at the end of one. The report of the result shows it."""
    read = read_result(result, mechanism=function)
    done = export(
        read if limb is None else read.limb(limb),
        to,
        out=read.path.parent / "export" if out is None else out,
        **options,
    )
    if PREVIEW not in Path(out or "").parts:  # what is only looked at is not deployed
        note_deployed(read.path, EXPORT, done.format, done.document(), done.files.values())
    return done


def _check_options(
    one: Format, source: Any, offsets: str, vendor: str | None, counts: Mapping[str, float] | None
) -> None:
    """Raise InputError for options that the format does not take."""
    if offsets not in OFFSETS:
        raise InputError(
            f"offsets is {offsets!r}", code="unknown-name", remedy="give 'origin' or 'file'"
        )
    if vendor is not None and vendor not in ORIENTATIONS:
        raise unknown_name(f"there is no vendor {vendor!r}", vendor, ORIENTATIONS)
    stated = {
        "source": source is not None,
        "offsets": offsets != OFFSETS[0],
        "vendor": vendor is not None,
        "counts": bool(counts),
    }
    takes = (*one.options, *(["source"] if one.source else []))
    for option in [name for name, is_stated in stated.items() if is_stated and name not in takes]:
        others = [other.name for other in EXPORTS.values() if option in other.options]
        raise InputError(
            f"the format {one.name!r} takes no {option}",
            code="conflicting-keys",
            remedy=f"remove --{option}" + (f"; {listed(others)} take it" if others else ""),
        )


_LACKS = {
    "chain": "it is not a serial arm in space",
    "origins": "its joints are not described by origins, as those of a URDF are",
    "zeros": "it is not a serial arm in space, or nothing measures it",
    "cameras": "it has no camera",
    "eyes": "it has no camera",
    "places": "it is no serial arm in space that something measures, and has no camera",
}


def _written(
    one: Format, machine: Exported, options: ExportOptions, read_from: Path | None
) -> ExportFiles:
    """The files of a format; read_from: the file that the machine was read from.

    Raises InputError; where the format cannot hold the machine, it names those that can.
    """
    try:
        return _of_format(one, machine, options, read_from)
    except InputError as error:
        if error.code != "unsupported":
            raise
        able = []
        for other in EXPORTS.values():
            # Only the writer of a format shows whether it can hold the machine.
            with suppress(InputError):
                _of_format(other, machine, ExportOptions(), read_from)
                able.append(other.name)
        raise InputError(
            error.message,
            code=error.code,
            place=error.place,
            remedy=f"export one of these, which take this machine: {', '.join(map(repr, able))}",
        ).offering(*(["--to", "dh" if "dh" in able else able[0]] if able else [])) from None


def _of_format(
    one: Format, machine: Exported, options: ExportOptions, read_from: Path | None
) -> ExportFiles:
    """The files of a format. Raises InputError for a machine that it cannot hold, and for a lacking
    source."""
    has_cameras = any(p.role == "lens" for p in machine.parameters)
    holds = {
        "parameters": True,
        "chain": machine.chain is not None,
        "origins": bool(machine.origins),
        "zeros": bool(machine.zeros),
        "cameras": has_cameras,
        "eyes": has_cameras or bool(machine.eyes),
        "places": bool(machine.zeros) or has_cameras or bool(machine.eyes),
    }
    if not holds[one.needs]:
        raise InputError(
            f"{machine.name!r} cannot be exported as {one.name!r}: {_LACKS[one.needs]}",
            code="unsupported",
        )
    if one.described and options.source is None:
        options = replace(options, source=read_from)
    if one.source and not one.optional and options.source is None:
        raise InputError(
            f"the format {one.name!r} needs {one.source}",
            code="missing-key",
            remedy="name the file: --source FILE",
        )
    return one.write(machine, options)


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
    if not one.nominal or not alone or not nominal:
        return ()
    after, before = alone.measured, nominal.measured
    if not after or not before or after.rms <= before.rms:
        return ()
    return (
        f"Zeros and tool alone make the arm worse at the measured poses: "
        f"{with_unit(after.rms, 'm')} rms, {with_unit(before.rms, 'm')} without them. "
        "Keep the controller's zeros and correct the targets instead.",
    )
