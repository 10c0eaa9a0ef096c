"""Rows of the catalogue on readings that share an error, which a fit takes as independent."""

from __future__ import annotations

from functools import partial

from loopcal.document.verdict import Row

_open = partial(Row, "sound", "caution")
SHARED_ERRORS = (
    _open(
        "errors-shared",
        "The targets share errors, which the stated regions take as independent: their residuals "
        "in one pose are correlated by {correlation:2}.",
        "State the sds of the joints and of the instruments. The fit then knows what they share.",
        "loopcal check {project}",
    ),
    _open(
        "repeats-share-error",
        "Repeats of a pose share an error: they scatter {ratio:2} times less than different poses "
        "({p_value:p}). This method counts each row as independent, so its sds are too small.",
        "Calibrate by the default method, which counts such repeats once, or average them.",
        "loopcal calibrate {project} --method auto",
        title="Repeats of a pose share an error.",
    ),
)
