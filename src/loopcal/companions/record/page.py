"""The calibration record as one page for print; what the project does not state is "not stated"."""

from __future__ import annotations

from loopcal.companions.record.budget import Budget
from loopcal.companions.record.content import (
    FIELDS,
    OPTIONAL,
    PEOPLE,
    RULE,
    UNSTATED,
    RecordContent,
    expanded,
)
from loopcal.companions.record.record_file import OPEN, manifest, sealed
from loopcal.document.fit import ParameterEntry
from loopcal.files.versions import version
from loopcal.presentation.shown import NONE, Table, by_sd, enumerated, percent, size, unit_shown
from loopcal.report.templates import environment, part
from loopcal.report.top import accuracy_bars, readings


def record_page(content: RecordContent) -> str:
    """The page of a record, sealed with its SHA-256; nothing in it is asked of any network."""
    texts = content.texts
    fields = {
        section: {
            label: texts.get(key, UNSTATED)
            for key, label in labels.items()
            if key not in OPTIONAL or key in texts
        }
        for section, labels in FIELDS.items()
    }
    html = (
        environment()
        .get_template("record.html")
        .render(
            content=content,
            document=content.document,
            verdict=content.verdict,
            fields=fields,
            people=PEOPLE,
            unstated=UNSTATED,
            readings=readings(content.document),
            rule=RULE,
            drawn=accuracy_bars(content.document),
            accuracy=_accuracy(content),
            parameters=_parameters(content),
            budgets=[_budget(one) for one in content.budgets],
            held=_held(content),
            manifest=manifest(content.files),
            seal=OPEN,
            version=version(),
            style=part("style.css") + part("record.css"),
        )
    )
    return sealed(html)


def _accuracy(content: RecordContent) -> Table | None:
    """Distances before and after, with the 95 % interval of the distance that 95 % keep."""
    accuracy = content.document.accuracy
    if accuracy is None:
        return None
    unit = accuracy.unit
    rows = []
    for stage in content.stages:
        distances, band = stage.distances, stage.band
        within = NONE if band is None else f"{size(band.low, unit)} to {size(band.high, unit)}"
        shown = [size(value, unit) for value in (distances.mean, distances.rms, distances.p95)]
        rows.append((stage.name, str(stage.poses), *shown, within, size(distances.max, unit)))
    if accuracy.noise_floor is not None:
        floor = size(accuracy.noise_floor, unit)
        rows.append(("noise of the readings", NONE, NONE, floor, *[NONE] * 3))
    head = ("", "poses", "mean", "rms", "95 % of poses", "its 95 % interval", "largest")
    caption = f"Distance between computed and measured position [{unit_shown(unit)}]"
    return Table(caption, head, tuple(rows))


def _budget(budget: Budget) -> tuple[Table, Table]:
    """What contributes at the measured poses, and U there and in the working region."""
    unit, at = budget.unit, budget.places[0]
    rows = [
        (
            one.name,
            one.source,
            NONE if one.sd is None else size(one.sd, unit, 3),
            NONE if (share := budget.share(one)) is None else percent(share, 1),
        )
        for one in budget.contributions
    ]
    rows.append(
        ("combined", "root of the sum of squares", size(at.combined, unit, 3), percent(1.0))
    )
    of = f", {budget.instrument}" if budget.instrument else ""
    head = ("contribution", "source", f"sd [{unit_shown(unit)}]", "share")
    places = tuple(
        (
            p.name,
            p.source,
            *(size(v, unit, 3) for v in (p.stated, p.combined, p.U)),
            f"{budget.k:.2f}",
        )
        for p in budget.places
    )
    shown = unit_shown(unit)
    where = (
        "where",
        "stated by",
        f"sd stated [{shown}]",
        f"combined [{shown}]",
        f"U [{shown}]",
        "k",
    )
    return (
        Table(f"Uncertainty budget of predicted positions{of}: measured poses", head, tuple(rows)),
        Table(f"Expanded uncertainty of predicted positions{of}", where, places),
    )


def _held(content: RecordContent) -> str:
    """Which parameters are held, and what depends on that choice."""
    if not content.held:
        return "No parameter of the machine is held."
    return (
        f"Held at their nominal values: {enumerated(content.held)}. The values of the others, and "
        "their U, depend on which are held. Where a held parameter is redundant, predicted "
        "positions do not."
    )


def _parameters(content: RecordContent) -> Table:
    """Every parameter before and after, its expanded uncertainty U = k sd, and k."""
    rows = [_parameter(entry) for entry in content.parameters]
    head = ("parameter", "unit", "before", "after", "U", "k")
    caption = "Parameters before (nominal) and after calibration"
    return Table(caption, head, tuple(rows))


def _parameter(entry: ParameterEntry) -> tuple[str, ...]:
    before = by_sd(entry.nominal, entry.sd, entry.unit)
    unit, wide = unit_shown(entry.unit), expanded(entry)
    if wide is None:
        after = (entry.same and entry.held) or "held" if entry.fixed else "not determined"
        return (entry.name, unit, before, after, NONE, NONE)
    after = by_sd(entry.value, entry.sd, entry.unit)
    return (entry.name, unit, before, after, size(wide.u, entry.unit, 2), f"{wide.k:.2f}")
