"""Exposition: gives a service's metrics to Prometheus, as text or over HTTP."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

from failstop import extras
from failstop.api.errors import FailstopError
from failstop.api.state import StateReader
from failstop.fleet import FleetError, metrics
from failstop.fleet.settings import port_number
from failstop.policy.setting import shown

TYPE_CHECKING = False
if TYPE_CHECKING:
    from prometheus_client import CollectorRegistry
    from prometheus_client.core import Metric

    from failstop.api.state import State


class Collector:
    """Reads the service's state at each scrape, also after a restart of the service. Thread-safe."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._reader: StateReader | None = None
        self._lock = threading.Lock()

    def state(self) -> State | None:
        """Return the service's present state. None if no service is running, or if its state can't be read."""
        with self._lock:
            for _ in range(2):  # if the run that was read has ended, try the next run
                try:
                    if self._reader is None or self._reader.over():
                        self._reader = StateReader(self._name)
                    return self._reader.read()
                except FailstopError:
                    self._reader = None
        return None

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics in the form that prometheus_client's registry wants."""
        from prometheus_client.core import Metric

        for family, samples in metrics.collect(self.state()):
            # The family of a counter has no `_total` in its name, but its samples have.
            found = Metric(family.name.removesuffix("_total"), family.doc, family.kind)
            for labels, value in samples:
                found.add_sample(family.name, dict(labels), value)
            yield found


def registry(name: str) -> CollectorRegistry:
    """Return a registry with only this service's metrics. Raises FleetError if prometheus_client is not installed."""
    try:
        from prometheus_client import CollectorRegistry
    except ImportError:
        raise FleetError(extras.missing("this needs prometheus-client", "fleet")) from None
    made = CollectorRegistry()
    made.register(Collector(name))
    return made


def text(name: str) -> str:
    """Return the metrics of this service in Prometheus's text format. Raises FleetError."""
    found = registry(name)
    from prometheus_client import generate_latest

    return generate_latest(found).decode()


@contextlib.contextmanager
def serving(name: str, host: str, port: int) -> Iterator[int]:
    """Make a context in which /metrics is served over HTTP. Yields the port. Raises FleetError."""
    found = registry(name)
    from prometheus_client import make_wsgi_app

    from failstop.fleet import scraped

    try:
        server = scraped.Server(host, port)
    except (OSError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) else "no such port"
        raise FleetError(f"{host}:{port} can't be listened at: {why}; choose another with --serve HOST:PORT") from None
    server.set_app(make_wsgi_app(found))
    with scraped.running(server) as bound:
        yield bound


def address(text: str) -> tuple[str, int]:
    """Split HOST:PORT, [IPv6]:PORT or :PORT into host and port. The default host is 127.0.0.1. Raises FleetError."""
    host, colon, digits = text.rpartition(":")
    port = port_number(digits)
    if not colon or port is None or port > 65535:
        raise FleetError(f"--serve {shown(text)}: HOST:PORT is expected, 127.0.0.1:9464 for one")
    host = host.strip("[]") or "127.0.0.1"
    try:
        socket.getaddrinfo(host, port)
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "no host can have this name"
        raise FleetError(f"--serve {shown(text)}: {why}") from None
    return host, port
