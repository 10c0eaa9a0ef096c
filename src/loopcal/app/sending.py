"""Files of the folder sent to the browser: to save, or as a page that may reach nothing."""

from __future__ import annotations

from pathlib import Path

from starlette.responses import FileResponse, PlainTextResponse, Response

from loopcal.app.session import Session
from loopcal.errors import InputError

PAGES = ("report.html", "record.html", "plan.html", "machine.history.html")
"""Names of pages that loopcal writes."""


def sent(session: Session, name: str) -> Response:
    """The file of this name, to be saved: shown, a page of somebody else would run with the
    rights of this one."""
    path = _path(session, name)
    if isinstance(path, Response):
        return path
    return FileResponse(path, media_type="application/octet-stream", filename=path.name)


def shown(session: Session, name: str) -> Response:
    """A page that loopcal wrote. It runs its own programs, whose hashes it names itself, in an
    origin of its own."""
    if name.rsplit("/", 1)[-1] not in PAGES:
        return PlainTextResponse("there is no such page\n", status_code=404)
    path = _path(session, name)
    if isinstance(path, Response):
        return path
    policy = {"content-security-policy": "sandbox allow-scripts allow-downloads allow-modals"}
    return FileResponse(path, media_type="text/html", headers=policy)


def _path(session: Session, name: str) -> Path | Response:
    try:
        return session.folder.file(name)
    except InputError as error:
        return PlainTextResponse(f"{error}\n", status_code=404)
