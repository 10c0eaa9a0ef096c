"""From a study file to its tables: the path behind `loopcal study`."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, UsageError
from loopcal.files.python_function import load_function
from loopcal.files.study_file import Study, read_study
from loopcal.files.study_parts import (
    Part,
    join_parts,
    missing_parts,
    open_folder,
    parts_of,
    write_part,
    write_summary,
)
from loopcal.files.toml_reader import read_text
from loopcal.studies.draws import Columns, run_draws
from loopcal.studies.summary import document, summary
from loopcal.studies.tables import StudyTables, tables

Progress = Callable[[int, int], None]
"""Called with how many draws are done, and how many were to be done in this run."""


@dataclass(frozen=True, eq=False)
class StudyDone:
    """A study that ran to its end: what it is, its tables, and the folder with all draws."""

    study: Study
    tables: StudyTables
    folder: Path
    text: str
    document: dict[str, Any]


@dataclass(frozen=True)
class _Source:
    """What a worker needs to read the same study: path, text, and FILE.py:NAME of the loops."""

    path: str
    text: bytes
    function: str | None

    def study(self) -> Study:
        loops = None if self.function is None else load_function(self.function)
        return read_study(self.path, text=self.text, mechanism=loops)


def run_study(
    path: str | Path,
    *,
    draws: int | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
    function: str | None = None,
    progress: Progress | None = None,
) -> StudyDone:
    """Run the draws of a study that its folder does not hold yet, and make its tables.

    draws: of each scenario, instead of the study's; workers: processes, by default one for each
    core; out: the folder, by default NAME-study beside the study NAME.toml. Neither the number of
    workers nor where a run was stopped changes any value.

    Raises InputError for a study or folder that cannot be used.
    """
    if (draws is not None and draws < 1) or (workers is not None and workers < 1):
        raise UsageError("draws and workers are counted from 1", remedy="give 1 or more")
    source = _Source(str(path), read_text(path), function)
    study = source.study()
    _check(study)
    draws = draws or study.draws
    folder = _default_folder(study) if out is None else Path(out)
    open_folder(folder, study)
    parts = parts_of(len(study.scenarios), draws)
    missing = missing_parts(folder, parts)
    methods = len(study.methods)
    total, done = sum(part.last - part.first for part in missing), 0
    for part, columns in _computed(source, study, missing, workers or _cores()):
        write_part(folder, part, columns)
        done += part.last - part.first
        if progress:
            progress(done * methods, total * methods)
    made = tables(study, draws, join_parts(folder, parts))
    text, told = summary(made), document(made)
    write_summary(folder, told, text)
    return StudyDone(study, made, folder, text, told)


def _default_folder(study: Study) -> Path:
    if study.path is None:
        return Path("loopcal-study")
    return study.path.parent / f"{study.path.stem}-study"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check(study: Study) -> None:
    """Meet here, before any work, what would stop the first draw of a scenario."""
    for i, scenario in enumerate(study.scenarios):
        try:
            run_draws(scenario, study.seed, [0])
        except InputError as error:
            raise error.at(f"{study.name}: scenarios[{i + 1}] ({scenario.name})") from None


def _computed(
    source: _Source, study: Study, missing: Sequence[Part], workers: int
) -> Iterator[tuple[Part, Columns]]:
    """The parts as they are done, in any order."""
    workers = min(workers, len(missing))
    if workers <= 1:
        for part in missing:
            yield part, _columns(study, part)
        return
    pool = ProcessPoolExecutor(
        workers,
        mp_context=get_context("spawn"),
        initializer=_begin,
        initargs=(source, study.fingerprint),
    )
    try:
        waiting = {pool.submit(_work, part): part for part in missing}
        for future in as_completed(waiting):
            yield waiting.pop(future), future.result()
    except BrokenProcessPool:
        raise InputError(
            "a worker ended before its work was done, killed or out of memory",
            place=study.name,
            remedy="run the study again, with fewer --workers: it goes on where it was",
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _columns(study: Study, part: Part) -> Columns:
    scenario = study.scenarios[part.scenario]
    try:
        return run_draws(scenario, study.seed, range(part.first, part.last))
    except InputError as error:
        raise error.at(f"{study.name}: scenarios[{part.scenario + 1}]") from None


_worker: dict[str, Study] = {}
"""The study of this worker process, read once."""


def _begin(source: _Source, fingerprint: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    study = source.study()
    if study.fingerprint != fingerprint:
        raise InputError("the mechanism of the study was changed while it ran", place=source.path)
    _worker["study"] = study


def _end_with_parent() -> None:
    """A parent that was killed can not stop its workers; they see that it is gone."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(part: Part) -> Columns:
    return _columns(_worker["study"], part)
