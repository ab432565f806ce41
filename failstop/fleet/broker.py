"""Broker: one connection to it, kept up. A thin shell around paho-mqtt, without its threads."""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import ssl
import time

from failstop import extras
from failstop.files import durable
from failstop.fleet import FleetError
from failstop.fleet.settings import CERT_KEY, PASSWORD, unreadable
from failstop.fleet.wire import MqttWire

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    from failstop.fleet.client import Client
    from failstop.fleet.settings import FleetSettings

CONNECT_S = 3.0
"""How long a connection may take."""
FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 5.0
"""Between two attempts; from the first to the longest each wait is twice the one before."""
SPREAD = 0.2
"""Each wait is up to this share shorter or longer, so that a broker that comes back is not overrun by all robots at
once."""
LONGEST_PAUSE_S = (1 + SPREAD) * LONGEST_WAIT_S + CONNECT_S
"""After so long a client that can reach the broker is connected again."""
NOT_YET = "not connected yet"
NO_REASON = "Unspecified error"
"""paho-mqtt's reason for a connection that the broker closed without a word."""
MOST_SECRET_BYTES = 1024
BACKLOG = 200
"""Messages of ours that may wait for the broker; of a state the newest counts."""
MOST_READS = 16
"""Reads of up to client.READ_BYTES in one turn, so that a flood leaves time for the rest."""
CLOSE_S = 1.0
"""How long the broker may take to end a connection that is to be closed."""
READ_BYTES = 1 << 16
HEAR_S = 0.02
"""How long the messages of one turn are heard where the newest comes first: those that are left are dropped."""
ONCE = 1
"""MQTT's quality of service for what the broker keeps until it has arrived: a thousand at most for each client, of
which a few are on their way at a time."""
ANYHOW = 0
"""MQTT's quality of service for what goes out as it comes, in any number, and is lost with the connection. All
subscriptions have it: a broker waits for no acknowledgement then, whatever floods the topic."""


class Broker:
    """Connects by itself at turns. `problem` says why it is not connected; empty: it is."""

    def __init__(
        self,
        settings: FleetSettings,
        client_id: str,
        subscriptions: Sequence[str],
        hear: Callable[[str, bytes, bool], None],
        up: Callable[[], None] = lambda: None,
        *,
        newest_first: bool = False,
    ) -> None:
        """`subscriptions`: topics; `hear`: is given topic, payload, and whether it was retained; `up`: is called at
        each connection; `newest_first`: of what has come at once the newest is heard first, for HEAR_S. Raises
        FleetError: no paho-mqtt, a file that can't be read."""
        try:
            from paho.mqtt.enums import CallbackAPIVersion

            from failstop.fleet.client import Client
        except ImportError:
            raise FleetError(extras.missing("this needs paho-mqtt", "fleet")) from None
        self.where = f"{settings.text('broker.host')}:{settings.number('broker.port'):.0f}"
        self.problem = NOT_YET
        self.listening = False
        """The broker has answered every subscription: from then on nothing is missed."""
        self.denied: tuple[str, ...] = ()
        """Topics that the broker does not let this client hear."""
        self._unconfirmed: dict[int | None, str] = {}
        self._settings = settings
        self._subscriptions = subscriptions
        self._hear = hear
        self._up = up
        self._newest_first = newest_first
        self._wait_s = FIRST_WAIT_S
        self._try_at_s = 0.0
        self._closing = False
        self.up_s = 0.0
        """When the connection was made, monotonic."""
        self.client: Client = Client(
            CallbackAPIVersion.VERSION2, client_id=client_id, clean_session=True, reconnect_on_failure=False
        )
        self.client.connect_timeout = CONNECT_S
        self.client.max_queued_messages_set(BACKLOG)
        self.client.on_connect = self._on_connect
        self.client.on_disconnect = self._on_disconnect
        self.client.on_subscribe = self._on_subscribe
        self.client.on_socket_open = self._on_socket
        self._secure()

    def _secure(self) -> None:
        settings = self._settings
        path = settings.secret("broker.password_file", PASSWORD)
        if user := settings.text("broker.user"):
            self.client.username_pw_set(user, read_secret(path) if path else None)
        elif path:
            raise FleetError(f"{path} holds a password, but broker.user is not set: set the user name too")
        if not settings.on("broker.tls"):
            return
        authority, certificate = settings.text("broker.ca_file"), settings.text("broker.cert_file")
        key = settings.secret("broker.cert_key_file", CERT_KEY)
        _check_readable("broker.ca_file", authority, "")
        _check_readable("broker.cert_file", certificate, "")
        _check_readable("broker.cert_key_file", key if certificate else "", CERT_KEY)
        try:
            context = ssl.create_default_context(cafile=authority or None)
            if authority:
                # From Python 3.13 on, certificates without every extension of RFC 5280 would be refused, which an
                # authority of one's own often makes. Chain, name and dates count on every Python.
                context.verify_flags &= ~ssl.VERIFY_X509_STRICT
        except (OSError, ssl.SSLError) as error:
            raise FleetError(f"broker.ca_file {authority}: {error}") from None
        try:
            if certificate:
                context.load_cert_chain(certificate, key or None)
        except (OSError, ssl.SSLError) as error:
            raise FleetError(f"broker.cert_file {certificate}, broker.cert_key_file {key}: {error}") from None
        self.client.tls_set_context(context)

    def will(self, topic: str, payload: bytes) -> None:
        """Set the broker's retained message for when this client is lost; counts from the next connection on."""
        self.client.will_set(topic, payload, qos=ONCE, retain=True)

    def say(self, topic: str, payload: bytes, *, qos: int = ONCE, retain: bool = False) -> None:
        """Publish; nothing happens while there is no connection."""
        if not self.problem:
            self.client.publish(topic, payload, qos=qos, retain=retain)

    def connected_s(self) -> float:
        """How long this connection has lasted; 0 while there is none."""
        return 0.0 if self.problem else time.monotonic() - self.up_s

    def fileno(self) -> int:
        """The descriptor to wait for; -1 while there is no connection."""
        found = self.client.socket()
        return found.fileno() if found else -1

    def wants_write(self) -> bool:
        """True while something waits to be sent."""
        return bool(self.client.want_write())

    def turn(self, timeout_s: float) -> None:
        """Wait for the broker at most so long, and do what there is to do."""
        if self.fileno() < 0:
            self.connect(time.monotonic())
            if self.fileno() < 0:
                time.sleep(timeout_s)
            return
        self.serve(readable=self._poll(0.0 if self.client.buffered() else timeout_s))

    def _poll(self, timeout_s: float) -> bool:
        """Wait at most so long; True when something is there to be read, or the connection has ended."""
        if (fd := self.fileno()) < 0:
            return False
        poll = select.poll()
        poll.register(fd, select.POLLIN | (select.POLLOUT if timeout_s and self.wants_write() else 0))
        return any(event != select.POLLOUT for _, event in poll.poll(timeout_s * 1e3))

    def serve(self, *, readable: bool) -> None:
        """Read what has come, write what waits, keep the connection alive."""
        for _ in range(MOST_READS):
            if not (readable or self.client.buffered()):
                break
            self.client.loop_read()
            readable = self._poll(0.0)
        self.deliver()
        if self.wants_write():
            self.client.loop_write()
        self.client.loop_misc()

    def deliver(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Hand on the messages that were read. Where the newest comes first, a flood's older ones are dropped: the
        sender of a genuine one repeats it."""
        messages = self.client.wire.messages()
        if not self._newest_first:
            for message in messages:
                self._hear(*message)
            return
        until_s = clock_s() + HEAR_S
        for message in reversed(messages):
            self._hear(*message)
            if clock_s() > until_s:
                return

    def connect(self, now_s: float) -> None:
        """Try to, if it is time; the broker's answer comes in a turn."""
        if now_s < self._try_at_s:
            return
        self._try_at_s = now_s + self._wait_s * random.uniform(1 - SPREAD, 1 + SPREAD)
        self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)
        settings = self._settings
        try:
            self.client.connect(
                settings.text("broker.host"),
                int(settings.number("broker.port")),
                int(settings.number("broker.keepalive_s")),
            )
        except (OSError, ValueError) as error:
            self.problem = f"no broker at {self.where}: {getattr(error, 'strerror', None) or error}"

    def confirmed(self, wait_s: float) -> bool:
        """Wait at most so long until the broker is connected and has acknowledged every message that went out ONCE."""
        until_s = time.monotonic() + wait_s
        self._try_at_s = 0.0
        while self.problem or self.client.waits():
            if (left_s := until_s - time.monotonic()) <= 0.0:
                return False
            self.turn(min(left_s, FIRST_WAIT_S / 10))
        return True

    def close(self) -> None:
        """Disconnect cleanly, so that the broker does not publish the last will. The connection stays open until the
        broker has ended it, or for CLOSE_S: bytes that come to a closed one reset it, and a broker that meets the reset
        before it has read the end takes the client for lost."""
        self._closing = True
        if (fd := self.fileno()) < 0:
            return
        until_s = time.monotonic() + CLOSE_S
        with contextlib.suppress(OSError, ValueError), socket.socket(fileno=os.dup(fd)) as kept:
            self.client.disconnect()
            while (left_s := until_s - time.monotonic()) > 0.0:
                kept.settimeout(left_s)
                if not kept.recv(READ_BYTES):
                    break

    def drop(self) -> None:
        """End the connection without a word: the broker says the last will."""
        self.client.drop()

    def _on_socket(self, _client: Any, _: object, found: Any) -> None:
        """A new connection. Small messages leave at once: waiting for more to send costs 40 ms each time."""
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.client.wire = MqttWire()

    def _on_connect(self, client: Any, _: object, _flags: object, reason: object, _properties: object) -> None:
        if getattr(reason, "is_failure", False):
            self.problem = f"the broker at {self.where} refuses: {reason}"
            return
        self.problem = ""
        self.up_s = time.monotonic()
        self._wait_s = FIRST_WAIT_S
        self.denied = ()
        self._unconfirmed = {client.subscribe(topic, qos=ANYHOW)[1]: topic for topic in self._subscriptions}
        self._up()

    def _on_subscribe(self, _client: Any, _: object, number: int, reasons: Any, _properties: object) -> None:
        topic = self._unconfirmed.pop(number, "")
        if topic and any(reason.is_failure for reason in reasons):
            self.denied = (*self.denied, topic)
        self.listening = not self._unconfirmed

    def _on_disconnect(self, _client: Any, _: object, _flags: object, reason: object, _properties: object) -> None:
        self.listening = False
        if self.problem in ("", NOT_YET) and not self._closing:
            why = "" if str(reason) == NO_REASON else f": {reason}"
            self.problem = f"the broker at {self.where} closed the connection{why}"


def _check_readable(key: str, path: str, credential: str) -> None:
    """Raises FleetError, which names the setting and the file: the errors of TLS name neither."""
    if not path:
        return
    try:
        os.close(durable.open_regular(path))
    except OSError as error:
        raise unreadable(key, path, error, credential) from None


def read_secret(path: str) -> str:
    """The first line of a file that nobody else may read. Raises FleetError."""
    try:
        fd = durable.open_regular(path)
        try:
            found, text = os.fstat(fd), os.read(fd, MOST_SECRET_BYTES)
        finally:
            os.close(fd)
        line = text.decode().partition("\n")[0].rstrip("\r")
    except OSError as error:
        raise unreadable("broker.password_file", path, error, PASSWORD) from None
    except UnicodeError as error:
        raise FleetError(f"broker.password_file {path}: {error}") from None
    if found.st_mode & 0o007:
        raise FleetError(f"everybody may read broker.password_file {path}: chmod 600 {path}")
    return line
