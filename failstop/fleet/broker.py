"""Broker: keeps a connection to the MQTT broker, and connects again when it breaks. It uses paho-mqtt without
paho-mqtt's threads."""

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
"""How long an attempt to connect may take, in seconds."""
FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 5.0
"""The longest wait between two attempts to connect, in seconds, not counting SPREAD. Each wait is twice as long as the
previous one, up to this limit."""
SPREAD = 0.2
"""The share by which each wait is made longer or shorter at random. Otherwise all robots would connect at the same
moment after a restart of the broker."""
LONGEST_PAUSE_S = (1 + SPREAD) * LONGEST_WAIT_S + CONNECT_S
"""How many seconds a client may take to connect again once it can reach the broker."""
NOT_YET = "not connected yet"
NO_REASON = "Unspecified error"
"""The reason that paho-mqtt reports if the broker closes a connection without giving a reason."""
MOST_SECRET_BYTES = 1024
BACKLOG = 200
"""How many messages of this client may wait to be sent to the broker. A small number is enough, because a new message
about the robot's state makes the older messages useless."""
MOST_READS = 16
"""How often one turn() may read from the connection, up to client.READ_BYTES each time. The limit leaves time for other
work during a flood of messages."""
CLOSE_S = 1.0
"""How many seconds to wait for the broker to end the connection after this client has sent its goodbye."""
READ_BYTES = 1 << 16
HEAR_S = 0.02
"""If a Broker hands on the newest message first (`newest_first`), one call of deliver() may take this long, in seconds.
After this time, the remaining older messages are dropped."""
ONCE = 1
"""MQTT's quality of service 1: the broker stores a message until it is delivered. It stores at most a thousand for each
client, and sends only a few of them at a time."""
ANYHOW = 0
"""MQTT's quality of service 0: messages are not acknowledged, so their number is not limited, but they are lost if the
connection breaks. All subscriptions use it, so the broker never waits for this client, even in a flood of messages."""


class Broker:
    """A connection to the broker that hands on messages. Call turn() in a loop. `problem` says why there is no
    connection, and is empty while there is one."""

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
        """`subscriptions`: the topics to read. `hear` gets each message: its topic, its payload, and True if the broker
        had stored it. `up` is called at each new connection. With `newest_first`, messages that arrive together are
        handed on newest first, for at most HEAR_S.

        Raises FleetError if paho-mqtt is missing, a file can't be read, or the settings don't fit together.
        """
        try:
            from paho.mqtt.enums import CallbackAPIVersion

            from failstop.fleet.client import Client
        except ImportError:
            raise FleetError(extras.missing("this needs paho-mqtt", "fleet")) from None
        self.where = f"{settings.text('broker.host')}:{settings.number('broker.port'):.0f}"
        self.problem = NOT_YET
        self.listening = False
        """True if the broker has answered all subscriptions. Then it sends every new message, except in the topics in
        `denied`."""
        self.denied: tuple[str, ...] = ()
        """The topics that the broker does not let this client read."""
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
        """When the present connection was made (time.monotonic(), s)."""
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
                # Python 3.13 and later refuse a certificate that lacks an extension of RFC 5280, and a private
                # authority often makes such certificates. Chain, name and dates are checked on every Python.
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
        """Set the last will: a retained message that the broker publishes if it loses this client. It takes effect with
        the next connection."""
        self.client.will_set(topic, payload, qos=ONCE, retain=True)

    def say(self, topic: str, payload: bytes, *, qos: int = ONCE, retain: bool = False) -> None:
        """Publish a message. Without a connection, this does nothing."""
        if not self.problem:
            self.client.publish(topic, payload, qos=qos, retain=retain)

    def connected_s(self) -> float:
        """Return how long the present connection has existed, s. 0 without a connection."""
        return 0.0 if self.problem else time.monotonic() - self.up_s

    def fileno(self) -> int:
        """Return the file descriptor of the connection, for poll(). -1 without a connection."""
        found = self.client.socket()
        return found.fileno() if found else -1

    def wants_write(self) -> bool:
        """Return True while bytes wait to be sent."""
        return bool(self.client.want_write())

    def turn(self, timeout_s: float) -> None:
        """Wait for the broker for at most `timeout_s`, then read and write. Without a connection, try to connect, which
        may take CONNECT_S longer."""
        if self.fileno() < 0:
            self.connect(time.monotonic())
            if self.fileno() < 0:
                time.sleep(timeout_s)
            return
        self.serve(readable=self._poll(0.0 if self.client.buffered() else timeout_s))

    def _poll(self, timeout_s: float) -> bool:
        """Wait for at most `timeout_s`. Returns True if there is something to read, or if the connection has ended."""
        if (fd := self.fileno()) < 0:
            return False
        poll = select.poll()
        poll.register(fd, select.POLLIN | (select.POLLOUT if timeout_s and self.wants_write() else 0))
        return any(event != select.POLLOUT for _, event in poll.poll(timeout_s * 1e3))

    def serve(self, *, readable: bool) -> None:
        """Read the messages that have arrived, send the bytes that wait to be sent, and keep the connection alive."""
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
        """Call `hear` with each message that was read. With `newest_first`, messages that are left after HEAR_S are
        dropped. This happens only in a flood of messages. A dropped fleet stop is not lost, because its sender repeats
        it."""
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
        """Try to connect, if it is time for the next attempt. The broker's answer arrives in a later turn()."""
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
        """Connect if needed, and wait until the broker has acknowledged every message that was published with ONCE.
        Returns False if this takes longer than `wait_s`."""
        until_s = time.monotonic() + wait_s
        self._try_at_s = 0.0
        while self.problem or self.client.waits():
            if (left_s := until_s - time.monotonic()) <= 0.0:
                return False
            self.turn(min(left_s, FIRST_WAIT_S / 10))
        return True

    def close(self) -> None:
        """Disconnect cleanly, so that the broker does not publish the last will. Waits for at most CLOSE_S.

        The broker must close the connection first. If this client closed it, later bytes from the broker would make the
        kernel reset the connection. Then the broker might miss the goodbye and report this client as lost.
        """
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
        """End the connection without a goodbye, so that the broker publishes the last will."""
        self.client.drop()

    def _on_socket(self, _client: Any, _: object, found: Any) -> None:
        """Prepare a new connection. Without TCP_NODELAY, the kernel would hold back small messages for 40 ms."""
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
    """Raise FleetError if the file can't be read. The message names the setting and the file, because the error from
    TLS names neither."""
    if not path:
        return
    try:
        os.close(durable.open_regular(path))
    except OSError as error:
        raise unreadable(key, path, error, credential) from None


def read_secret(path: str) -> str:
    """Return the first line of a file with a password. Raises FleetError if every user may read the file, or if it
    can't be read."""
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
