"""`failstop web`: the operator's page, for a phone or a desk."""

from __future__ import annotations

import os

from failstop.api.errors import FailstopError
from failstop.cli.commands import add_name
from failstop.policy import config
from failstop.shm import instance

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from failstop.policy.settings import Settings

EXAMPLES = """\
failstop web                          # http://127.0.0.1:8477/
failstop web --listen 0.0.0.0         # for the network
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop web`."""
    parser.add_argument("--listen", metavar="ADDRESS", help="where to listen (default: the setting web.address)")
    parser.add_argument("--port", type=int, metavar="N", help="on which port, 0: any (default: the setting web.port)")
    parser.add_argument("--config", metavar="FILE", help="TOML file with settings (default: the installed service's)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Serve until it is ended. Raises FailstopError, SettingError."""
    instance.check_name(arguments.name)
    settings = _settings(arguments)
    try:
        import asyncio

        from failstop.web import server
    except ImportError as error:
        raise FailstopError(f"the page needs {error.name}: pip install 'failstop[web]'") from None
    try:
        asyncio.run(server.serve(arguments.name, settings))
    except OSError as error:
        where = f"{settings.text('web.address')}, port {int(settings['web.port'])}"
        raise FailstopError(f"the page can't listen at {where}: {error.strerror}") from None
    return 0


def _settings(arguments: Namespace) -> Settings:
    installed = config.installed(arguments.name)
    path = arguments.config or (installed if os.path.exists(installed) else None)
    given = {"web.address": arguments.listen, "web.port": arguments.port}
    return config.load(path, {key: value for key, value in given.items() if value is not None})
