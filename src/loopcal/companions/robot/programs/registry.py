"""All dialects of robot programs, and which of them a file is in."""

from __future__ import annotations

from loopcal.companions.robot.programs import fanuc, krl, rapid, table, urscript, yaskawa
from loopcal.companions.robot.programs.dialect import ProgramDialect

_MODULES = (table, rapid, krl, fanuc, yaskawa, urscript)
DIALECTS: dict[str, ProgramDialect] = {one.DIALECT.kind: one.DIALECT for one in _MODULES}
BY_ENDING = {ending: one for one in DIALECTS.values() for ending in one.endings}
WRITTEN = {one.endings[0]: one for one in DIALECTS.values() if one.drive is not None}
"""Those in which poses are driven to, by the ending of their files."""
