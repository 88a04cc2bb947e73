"""``platform-ctrl serve``: the designer's page for a job, in the browser."""

from __future__ import annotations

import json
import os
import sys
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from platform_ctrl.cli.exits import interruptible, noted
from platform_ctrl.cli.job_arguments import Controllers, JobFile, Json, Quiet, job_of
from platform_ctrl.common.processes import collect_often
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.app.server import PageServer


Host = Annotated[
    str,
    typer.Option(
        "--host", metavar="ADDRESS", help="Address to listen on; another than this machine's own needs --allow."
    ),
]
Port = Annotated[
    int | None,
    typer.Option(
        "--port",
        metavar="PORT",
        min=0,
        max=65535,
        help="Port to listen on; 0: any free one. Default: 5006, or a free one after it.",
    ),
]
Allow = Annotated[
    list[str] | None,
    typer.Option(
        "--allow",
        metavar="NAME",
        help="Name or address by which browsers may ask for this machine; may be given several times.",
    ),
]
Browser = Annotated[
    bool | None,
    typer.Option(
        "--open/--no-browser",
        help="Open the page in a browser, or do not. Default: open it where there is a terminal and a screen.",
    ),
]


def serve(
    job: JobFile,
    controllers: Controllers = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    allow: Allow = None,
    browser: Browser = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Shape the loops of a job by hand, on a page in the browser.

    Every option of a design has a slider, and Bode, Nichols, root locus, responses, margins and requirements follow.
    What is saved there is a job that check accepts. Only this machine reaches the page, by the link that is printed;
    Ctrl-C ends it. Needs the extra designer.

    \b
    platform-ctrl serve job.toml
        opens the page in a browser
    platform-ctrl serve job.toml --controllers result.json
        with the controllers of a design to compare with
    platform-ctrl serve job.toml --port 8000 --no-browser
        at a port of its own
    platform-ctrl serve job.toml --json
        the address as JSON, for another program
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}"):
        name = _checked(job, controllers)
        try:
            import tomlkit  # noqa: F401 - what is saved is written with it

            from platform_ctrl.app.backend import Backend
            from platform_ctrl.app.server import AllowedHosts, PageServer
            from platform_ctrl.app.session import Pages
        except ModuleNotFoundError as error:
            raise InputError(
                f"the page needs {error.name}, which is not installed: pip install 'platform_ctrl[designer]'"
            ) from None
        AllowedHosts.of(host, allow or ())  # no work for what would be refused
        backend = Backend(job, controllers)
        collect_often()  # every move leaves megabytes of curves
        pages = Pages(backend)
        server = PageServer(pages.fill, host=host, allow=allow or (), port=port)

    def ready() -> None:
        # While the browser starts.
        threading.Thread(target=pages.prepare, daemon=True).start()
        shown = _opens_browser(browser, as_json)
        _announce(server, name, as_json, port)
        if shown:
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()

    # The third Ctrl-C is raised at once, should the server not react.
    with interruptible(deferred=2) as check, warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="bokeh")  # about nonsense that others send
        try:
            server.run(ready, check)
        finally:
            backend.close()


def _checked(job: Path, controllers: Path | None) -> str:
    """Return the job's name; an error where job or controllers cannot be shown."""
    read = job_of(job)
    from platform_ctrl.app.saving import controllers_beside
    from platform_ctrl.verification.controllers import differing_origin, read_controllers

    if controllers is not None:
        read_controllers(controllers, read)
    elif (beside := controllers_beside(job)).is_file() and (wrong := differing_origin(beside, read)):
        noted(f"{beside}: {wrong}; its controllers are not shown, unless it is named with --controllers")
    return read.name


def _announce(server: PageServer, name: str, as_json: bool, port: int | None) -> None:
    """Print where the page is."""
    from platform_ctrl.app.server import PORT, is_loopback

    if as_json:
        typer.echo(json.dumps({"schema": 1, "job": name, "address": server.address, "port": server.port}))
    else:
        if port is None and server.port != PORT:
            typer.echo(f"port {PORT} is taken: another one is used", err=True)
        typer.echo(f"{name}: {server.address} (Ctrl-C ends it)")
    if not is_loopback(server.hosts.listening):
        names = ", ".join(sorted(server.hosts.names))
        words = f"anybody who has the link and reaches this machine on port {server.port} as {names} can see this job"
        more = "keep its processors busy and write files where the page saves"
        typer.echo(f"listening on {server.hosts.listening}: {words}, {more}", err=True)
    sys.stdout.flush()


def _opens_browser(browser: bool | None, as_json: bool) -> bool:
    """Return whether to open a browser: as requested, else where there is a screen."""
    if browser is not None:
        return browser
    screen = sys.platform in ("win32", "darwin") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return screen and not as_json and sys.stdout.isatty()
