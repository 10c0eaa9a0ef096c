"""The command that starts the local app."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

import typer

from loopcal.cli.application import FunctionOption, app, argument, flag, option
from loopcal.cli.output import log
from loopcal.cli.registry import with_loops
from loopcal.errors import InputError


@app.command(name="app")
def serve_app(
    context: typer.Context,
    folder: Annotated[str, argument("[FOLDER]", "Folder of the project.")] = ".",
    mechanism: FunctionOption = None,
    host: Annotated[
        str,
        option("ADDRESS", "Serve other machines under this address; a token is then needed."),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        option("N", "Listen at this port [default: a free one].", min=1, max=65535),
    ] = None,
    no_browser: Annotated[
        bool, flag("--no-browser", "Open no browser; print the address only.")
    ] = False,
) -> None:
    """Serve a page on a project folder: the whole work by looking and pointing.

    Tutorial with pictures: docs/tutorials/in-the-browser.md.
    """
    if find_spec("nicegui") is None:
        error = InputError(
            "NiceGUI is not installed, which shows the app",
            code="missing-dependency",
            remedy="install the app with loopcal, then run the command again",
        )
        error.command = "pip install 'loopcal[app]'"
        raise error
    from loopcal.companions.app.server import serve

    serve(
        folder,
        context.obj,  # what runs a command line
        host=host,
        port=port,
        function=mechanism,
        with_loops=with_loops(),
        show=not no_browser,
        tell=lambda address: log(f"the app is at {address}"),
    )
