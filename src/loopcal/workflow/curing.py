"""The poses that would raise the verdict of a check."""

from __future__ import annotations

from contextlib import suppress

from loopcal.errors import InputError
from loopcal.planning.cure import Cure, cure
from loopcal.workflow.checking import Checked


def cure_of(checked: Checked) -> Cure | None:
    """The poses that would raise the verdict of a check.

    None where it is good, and where nothing says where poses may be.
    """
    if checked.check.verdict == "good" or checked.noise is None:
        return None
    project = checked.project
    with suppress(InputError):
        return cure(project.mechanism, checked.data, checked.noise, project.plan)
    return None
