"""`failstop web`: serves the operator's page, and pairs devices. Anyone may watch and stop, but only a paired device
may do more."""

from __future__ import annotations

import contextlib
import os
from argparse import ArgumentParser, Namespace

from failstop import config, extras
from failstop.api.errors import FailstopError
from failstop.api.state import StateReader
from failstop.cli.commands import add_name
from failstop.files import instance
from failstop.policy.settings import Settings
from failstop.web.source import Source

EXAMPLES = """\
failstop web                          # opens at http://127.0.0.1:8477/
failstop web --listen 0.0.0.0         # for the network, with https
failstop web pair                     # prints a code and a QR code
failstop web devices                  # which devices are paired
failstop web revoke 1a2b3c4d          # unpair this device
"""
WHAT = (
    "serve (default): serve the page; pair: print a code and a QR code with which a phone can pair; devices: list the "
    "paired devices; revoke: unpair the device with this ID"
)
"""The help text that explains the actions serve, pair, devices and revoke."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop web` to its parser."""
    add = parser.add_argument
    add("action", nargs="?", choices=tuple(ACTIONS), default="serve", help=WHAT)
    add("device", nargs="?", metavar="ID", help="with revoke: which device; `failstop web devices` lists the ids")
    add("--listen", metavar="ADDRESS", help="the address to listen at (default: the setting web.address)")
    add("--port", type=int, metavar="N", help="the port to listen at; 0: any free port (default: the setting web.port)")
    add("--config", metavar="FILE", help="TOML file with settings (default: the running service's settings)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Carry out the action that the user has named, for example `pair`. Raises FailstopError, SettingError."""
    instance.check_name(arguments.name)
    try:
        import tornado  # noqa: F401  # every action needs it
    except ImportError:
        raise FailstopError(extras.missing("the page needs tornado", "web")) from None
    return ACTIONS[arguments.action](arguments)


def _serve(arguments: Namespace) -> int:
    """Serve the page until the process is asked to end."""
    import asyncio

    from failstop.web import server

    settings, source = _settings(arguments)
    asyncio.run(server.serve(arguments.name, settings, source))
    return 0


def _settings(arguments: Namespace) -> tuple[Settings, Source]:
    """Return the page's settings, and where they come from: the file of --config, else the running service, else the
    installed settings file, else the defaults."""
    given = {"web.address": arguments.listen, "web.port": arguments.port}
    changed = {key: value for key, value in given.items() if value is not None}
    if arguments.config is None:
        with contextlib.suppress(FailstopError):
            return config.checked({**StateReader(arguments.name).settings(), **changed}), Source(running=True)
    path = config.chosen(arguments.name, arguments.config)
    return config.load(path, changed), Source(path or "")


def _pair(arguments: Namespace) -> int:
    from failstop.web import addresses, control

    found = control.ask(arguments.name, os.environ, "POST", "/pair")
    print(addresses.terminal_text(found))
    return 0


def _devices(arguments: Namespace) -> int:
    import time

    from failstop.web import control

    rows = control.ask(arguments.name, os.environ, "GET", "/devices")["devices"]
    for row in rows:
        print(f"{row['id']}  {time.strftime('%Y-%m-%d %H:%M', time.localtime(row['made']))}  {row['name']}")
    if not rows:
        print("no device is paired; next: `failstop web pair`")
    return 0


def _revoke(arguments: Namespace) -> int:
    from failstop.web import control

    if not arguments.device:
        raise FailstopError("which device should be revoked? `failstop web devices` lists them")
    name = control.ask(arguments.name, os.environ, "POST", "/devices", {"id": arguments.device})["revoked"]
    if not name:
        raise FailstopError(f"no paired device is {arguments.device!r}: `failstop web devices` lists them")
    print(f"{name} can now only watch and stop the robot")
    return 0


ACTIONS = {"serve": _serve, "pair": _pair, "devices": _devices, "revoke": _revoke}
