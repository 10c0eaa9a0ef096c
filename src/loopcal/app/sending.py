"""Files of the folder sent to the browser: to save, or as a page that may reach nothing."""

from __future__ import annotations

from starlette.responses import FileResponse, PlainTextResponse, Response

from loopcal.app.session import Session
from loopcal.errors import InputError

REPORT = "report.html"


def sent(session: Session, name: str) -> Response:
    """The file of this name, or the report of the result.

    A file is only ever saved, since a page of somebody else would run with the rights of this
    one. The report runs its own programs, whose hashes it names itself, in an origin of its own.
    """
    report = name == REPORT
    try:
        path = session.folder.file(f"{session.folder.result.name}/{REPORT}" if report else name)
    except InputError as error:
        return PlainTextResponse(f"{error}\n", status_code=404)
    if report:
        policy = {"content-security-policy": "sandbox allow-scripts allow-downloads"}
        return FileResponse(path, media_type="text/html", headers=policy)
    return FileResponse(path, media_type="application/octet-stream", filename=path.name)
