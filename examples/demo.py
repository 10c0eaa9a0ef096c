"""Calibrates the examples by both methods and prints every parameter's error beside the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from loopcal.estimation.result import Result
from loopcal.files.result.truth_file import read_truth
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import SHOWN
from loopcal.presentation.text_table import columns
from loopcal.units import from_si
from loopcal.workflow.calibration import Request, run_calibration

HERE = Path(__file__).parent
RESULTS = HERE.parent / "build" / "demo"
METHODS = {"least-squares": "least squares", "implicit-loop": "implicit loop"}


def main() -> None:
    """Runs every example that carries its truth."""
    for project in sorted(HERE.glob("*/project.toml")):
        truth = project.with_name("poses.truth.json")
        results = {}
        for method, words in METHODS.items():
            folder = RESULTS / project.parent.name / method
            asked = Request(method=method, truth=truth)
            done = run_calibration(project, asked, out=folder)
            results[words] = done.result
            title = done.result.document.title
        first = next(iter(results.values()))
        print(f"{title}: {len(first.dataset)} poses\n")
        print("\n".join(table(results, read_truth(truth, first.mechanism))))
        folder = RESULTS / project.parent.name
        print(f"\nError is true minus estimate. Results: {folder.relative_to(HERE.parent)}/\n")


def table(results: dict[str, Result], truth: Mapping[str, float]) -> list[str]:
    """One line per estimated parameter: the truth, then error and sd by each method."""
    head = [f"{words} {column}" for words in results for column in ("error", "sd")]
    rows = [["parameter", "truth", *head, "unit"]]
    first = next(iter(results.values()))
    for name in first.estimated:
        unit = SHOWN.get(first.mechanism.parameters[name].unit, "1")
        row = [name, significant(from_si(truth[name], unit), 6)]
        for result in results.values():
            error, sd = (result.errors or {})[name], result.sd[name]
            row += [significant(from_si(v, unit), 2) if v is not None else "" for v in (error, sd)]
        rows.append([*row, unit])
    lines = columns(rows)
    before, after = first.accuracy_before, [r.accuracy_after for r in results.values()]
    if before is not None and all(after):
        unit = SHOWN.get(before.unit, before.unit)
        reached = [significant(from_si(a.rms, unit), 3) for a in after if a]
        nominal = significant(from_si(before.rms, unit), 3)
        listed = ", ".join(f"{r} {unit} by {n}" for r, n in zip(reached, results, strict=True))
        lines += [
            f"\nEnd point computed minus measured, rms: {nominal} {unit} nominal, {listed}.",
            "It is predicted from noisy readings and says more of them than of the parameters.",
        ]
    return lines


if __name__ == "__main__":
    main()
