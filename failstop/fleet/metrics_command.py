"""`failstop metrics`: gives a service's metrics to Prometheus, once or over HTTP."""

from __future__ import annotations

import signal
import sys
from argparse import ArgumentParser, Namespace

from failstop.cli import standard
from failstop.cli.commands import add_name
from failstop.fleet import exposition

EXAMPLES = """\
failstop metrics                         # print them once
failstop metrics --serve 127.0.0.1:9464  # http://127.0.0.1:9464/metrics
cd /var/lib/node_exporter && failstop metrics > .fs && mv .fs failstop.prom
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop metrics` to its parser."""
    parser.add_argument(
        "--serve", metavar="HOST:PORT", help="serve the metrics over HTTP until Ctrl-C, instead of printing them once"
    )
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the metrics once, or serve them until a signal ends this process. Without a running service, the only
    metric is `failstop_up 0`. Raises FleetError."""
    if arguments.serve is None:
        sys.stdout.write(exposition.text(arguments.name))
        return 0
    host, port = exposition.address(arguments.serve)
    ends = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)  # the server's threads inherit this
    with exposition.serving(arguments.name, host, port) as bound:
        shown = f"[{host}]" if ":" in host else host
        standard.print_line(f"http://{shown}:{bound}/metrics serves the metrics of {arguments.name!r}")
        return 128 + signal.sigwait(ends)
