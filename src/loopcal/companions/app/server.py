"""Starts the app: a server of this machine on one folder."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

from starlette.responses import FileResponse, PlainTextResponse, Response

from loopcal.companions.app.guard import Guard, Rules
from loopcal.companions.app.session import Session
from loopcal.companions.app.worker import Command
from loopcal.errors import InputError

PORT = 8765
PATIENCE = 150.0
"""Seconds of which a browser may spend 40 % drawing before its connection counts as lost: a
figure in space without a graphics processor took 6 s beside one busy process."""
LEFT = 30.0
"""Seconds that a page is kept whose browser has gone."""


def serve(
    folder: str | Path,
    command: Command,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    function: str | None = None,
    with_loops: Collection[str] = (),
    show: bool = True,
    tell: Callable[[str], Any] = print,
) -> None:
    """Serve the app on a folder until it is interrupted.

    command: `loopcal.cli.run.main`; with_loops: the commands that take loops in Python; port: by
    default the first free one from 8765 on; show: whether a browser is opened; tell: called with
    the address. Raises InputError where the folder is none, or the port is taken.
    """
    from nicegui import app, ui

    from loopcal.companions.app.frame import SCRIPTS, build
    from loopcal.companions.app.pages import BY_KEY
    from loopcal.companions.app.project_folder import FolderLock, existing_folder
    from loopcal.companions.app.session import Session
    from loopcal.files.outputs import INSIDE

    path = existing_folder(folder)
    number = _port(host, port)
    rules = Rules.of(host, number)
    # In the environment, so that child processes refuse paths out of the folder too.
    os.environ[INSIDE] = str(path)
    session = Session(path, command, function, with_loops)
    asked = "" if rules.token is None else f"/?token={rules.token}"
    shown_host = f"[{host}]" if ":" in host else host
    session.watch()
    lock = FolderLock(path, f"http://{shown_host}:{number}")
    app.add_middleware(Guard, rules=rules)
    tell(f"http://{shown_host}:{number}{asked}")
    for address, name in SCRIPTS.items():
        script = Path(__file__).with_name("scripts") / name
        app.add_static_file(local_file=script, url_path=address)
    app.add_api_route("/file/{name:path}", lambda name: sent(session, name))
    app.add_api_route("/page/{name:path}", lambda name: shown(session, name))
    # Large files are read ahead of the first drawing, which a shorter time would cut off.
    # Its bar has no name for a screen reader; the page says itself what it waits for.
    app.config.quasar_config["loadingBar"]["skipHijack"] = True
    for address in ("/", *(f"/{key}" for key in BY_KEY)):
        page = ui.page(
            address,
            title=f"loopcal: {path.name}",
            language="en-US",
            response_timeout=60.0,
            reconnect_timeout=LEFT,
        )
        page(partial(build, session))
    app.on_shutdown(session.worker.cancel)
    ui.run(
        host=host,
        tailwind=False,  # it looks at every change of the page, and styles all of it anew
        port=number,
        dark=None,
        show=show and f"/{asked.lstrip('/')}",
        reload=False,
        reconnect_timeout=PATIENCE,
        show_welcome_message=False,
    )
    lock.release()


def _port(host: str, asked: int | None) -> int:
    """The port to listen at. Raises InputError where none is free."""
    for port in [asked] if asked is not None else range(PORT, PORT + 50):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family) as trial:
            if os.name == "posix":  # elsewhere it would take a port that is in use
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((host, port))
            except OSError as error:
                reason = error
                continue
            return port
    raise InputError(
        f"cannot listen at {host}: {reason.strerror or reason}",
        code="invalid-value",
        remedy="name another --port, or an address of this machine",
    )


# Files of the folder sent to the browser: to save, or as a page that may reach nothing.

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
    """A page that loopcal wrote. It runs only programs whose hashes it names, in a
    separate origin."""
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
