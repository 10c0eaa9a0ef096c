"""Rows of the catalogue on two calibrations: are their machines the same?"""

from __future__ import annotations

from functools import partial

from loopcal.document.verdict import Row

_not_consistent = partial(Row, "consistent", "refuse")
_consistent_open = partial(Row, "consistent", "caution")
_consistent = partial(Row, "consistent", "info")
_remark = partial(Row, None, "info")
# The order counts, as in the catalogue.
TWO_MACHINES = (
    _consistent_open(
        "nothing-common",
        "Both calibrations determine nothing that could differ.",
        "Measure both in the same region, or learn the model error of both.",
        shared="undecided",
    ),
    _consistent_open(
        "undecided",
        "Undecided: the two machines differ by more than noise explains ({where}{p_value:p}), "
        "but they were measured in different regions, where an unmodelled error differs too.",
        "Measure both in the same region, or learn the model error of both "
        '(model_error = "structured").',
    ),
    _consistent(
        "machines-agree",
        "The two machines agree within their stated uncertainty: {where}{p_value:p}.",
    ),
    _not_consistent(
        "machines-differ",
        "The two machines differ by more than their stated uncertainty explains: "
        "{where}{p_value:p}.",
        detail="{blame}",
    ),
    _remark(
        "poses-scatter",
        "The poses scatter {times:2} times as much as their sds allow along what is compared: the "
        "machine model lacks something.",
        detail="The sds of the differences are those of this scatter.",
    ),
    _remark(
        "not-aligned",
        "The parameters are compared without alignment: differences include any move of the "
        "instrument in between.",
    ),
    _remark(
        "same-readings",
        "Both come from the same readings and share their errors: the sds of the differences, "
        "computed as if independent, are too large and p is too close to 1.",
    ),
    _remark(
        "sds-rejected",
        "Chi-squared rejects the sds of {place.files} itself: they count {times:2} times as large "
        "here, as its residuals are.",
    ),
)
