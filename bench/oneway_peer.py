"""Channels: the ways to get 64 bytes from one process to another that bench/oneway.py compares.

Each is made before the processes part; `sender` and `receiver` are then called once, in one process each. They return
what sends a payload, and what blocks until the next payload is there and returns it.
"""

from __future__ import annotations

import contextlib
import glob
import importlib
import importlib.metadata
import os
import socket
from collections.abc import Callable
from time import monotonic_ns
from typing import Any, Protocol

from failstop.messages import segments
from failstop.messages.layout import SEGMENT_BY_NAME
from failstop.procs.loop import READ, Loop
from failstop.procs.port_owner.main import TICK_NS
from failstop.shm.bell import EventBell

PAYLOAD_BYTES = 64
RING_CELLS = SEGMENT_BY_NAME["gate"].records["frames"].cells
Send = Callable[[bytes], object]
Receive = Callable[[], bytes]


class ChannelMissing(Exception):
    """The channel cannot be had here; says what it needs."""


class Channel(Protocol):
    """One way from a process to another."""

    def sender(self) -> Send:
        """In the sending process: what sends one payload."""

    def receiver(self) -> Receive:
        """In the receiving process: what waits for the next payload."""

    def close(self) -> None:
        """Remove everything that outlives the processes; in the one that made the channel."""


class RingAndBell:
    """failstop's own: the gate's ring of frames and the port owner's bell, waited for as the port owner does."""

    def __init__(self, directory: str) -> None:
        self._instance = f"oneway-{os.getpid()}"
        self._created = segments.create(self._instance, "gate", 1)
        self._bell = EventBell.create()
        # The port owner waits for more than its bell: its other descriptors are in the set, and silent.
        self._silent = EventBell.create()

    def sender(self) -> Send:
        """As the gate does: put, then ring."""
        writer = segments.attach(self._instance, "gate", 1, write=True).ring_writer("frames")
        ring = self._bell.ring

        def send(payload: bytes) -> None:
            writer.put(payload)
            ring()

        return send

    def receiver(self) -> Receive:
        """As the port owner does: wait for the set until the next tick, clear the bell, drain the ring."""
        reader = segments.attach(self._instance, "gate", 1).ring_reader("frames")
        bell = self._bell
        loop = Loop()
        loop.watch(bell.fd, READ)
        loop.watch(self._silent.fd, READ)

        def receive() -> bytes:
            while True:
                if entry := reader.next():
                    return entry[2]
                if bell.fd in loop.wait(monotonic_ns() + TICK_NS):
                    bell.clear()

        return receive

    def close(self) -> None:
        """Unlink the segment."""
        self._created.close()
        segments.unlink(self._instance, "gate")
        os.close(self._bell.fd)
        os.close(self._silent.fd)


class RingAndBellAlone(RingAndBell):
    """A way of waiting for a receiver that has nothing else to wait for, as the peers' receivers have not."""

    def receiver(self) -> Receive:
        """Block in the bell's read, then take the entry."""
        reader = segments.attach(self._instance, "gate", 1).ring_reader("frames")
        fd = self._bell.fd
        os.set_blocking(fd, True)

        def receive() -> bytes:
            while True:
                if entry := reader.next():
                    return entry[2]
                os.read(fd, 8)

        return receive


class Pipe:
    """The floor: one write, one blocking read."""

    def __init__(self, directory: str) -> None:
        self._out, self._in = os.pipe()

    def sender(self) -> Send:
        """A write."""
        fd = self._in
        return lambda payload: os.write(fd, payload)

    def receiver(self) -> Receive:
        """A blocking read."""
        fd = self._out
        return lambda: os.read(fd, PAYLOAD_BYTES)

    def close(self) -> None:
        """Close both ends."""
        os.close(self._out)
        os.close(self._in)


class PosixQueue:
    """A POSIX message queue."""

    def __init__(self, directory: str) -> None:
        self._posix_ipc = posix_ipc = _import("posix_ipc", "posix-ipc")
        self._queue = posix_ipc.MessageQueue(
            f"/failstop-oneway-{os.getpid()}", posix_ipc.O_CREX, max_messages=10, max_message_size=PAYLOAD_BYTES
        )

    def sender(self) -> Send:
        """mq_send."""
        send: Send = self._queue.send
        return send

    def receiver(self) -> Receive:
        """mq_receive, with no time-out."""
        wait = self._queue.receive
        return lambda: wait()[0]

    def close(self) -> None:
        """Unlink the queue."""
        self._queue.close()
        self._queue.unlink()


class PosixQueueInLoop(PosixQueue):
    """A way of waiting for a receiver that waits for other things too, as the port owner does: behind failstop's own
    loop."""

    def receiver(self) -> Receive:
        """Wait for the set until the next tick, then mq_receive."""
        queue = self._posix_ipc.MessageQueue(self._queue.name)
        queue.block = False
        loop = Loop()
        loop.watch(queue.mqd, READ)

        def receive() -> bytes:
            while True:
                if loop.wait(monotonic_ns() + TICK_NS):
                    found: bytes = queue.receive()[0]
                    return found

        return receive


class UnixDatagrams:
    """A pair of Unix datagram sockets."""

    def __init__(self, directory: str) -> None:
        self._out, self._in = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def sender(self) -> Send:
        """send."""
        return self._in.send

    def receiver(self) -> Receive:
        """A blocking recv."""
        receive = self._out.recv
        return lambda: receive(PAYLOAD_BYTES)

    def close(self) -> None:
        """Close both sockets."""
        self._out.close()
        self._in.close()


class ZeroMq:
    """ZeroMQ, PUSH to PULL over ipc://."""

    def __init__(self, directory: str) -> None:
        self._zmq = _import("zmq", "pyzmq")
        self._address = f"ipc://{directory}/zeromq"

    def sender(self) -> Send:
        """A PUSH socket, in a context of this process."""
        push = self._zmq.Context().socket(self._zmq.PUSH)
        push.bind(self._address)
        send: Send = push.send
        return send

    def receiver(self) -> Receive:
        """A PULL socket, blocking."""
        pull = self._zmq.Context().socket(self._zmq.PULL)
        pull.connect(self._address)
        receive: Receive = pull.recv
        return receive

    def close(self) -> None:
        """Its socket file goes with the directory."""


class Iceoryx:
    """iceoryx2: publish and subscribe for the payload, an event for the wake-up."""

    def __init__(self, directory: str) -> None:
        self._iox = _import("iceoryx2", "iceoryx2")
        self._ctypes = _import("ctypes", "ctypes")
        self._prefix = f"failstop-oneway-{os.getpid()}-"
        self._directory = directory
        self._alive: list[object] = []

    def _services(self) -> tuple[Any, Any]:
        """Both services, under the directory of this measurement."""
        iox = self._iox
        iox.set_log_level(iox.LogLevel.Error)
        config = iox.config.default()
        config.global_cfg.root_path = iox.Path.new(self._directory)
        config.global_cfg.prefix = iox.FileName.new(self._prefix)
        node = iox.NodeBuilder.new().config(config).create(iox.ServiceType.Ipc)
        name = iox.ServiceName.new("oneway")
        payload = iox.Slice[self._ctypes.c_uint8]
        # As many as the ring holds: by default the third message in a row pushes out the first.
        builder = node.service_builder(name).publish_subscribe(payload).subscriber_max_buffer_size(RING_CELLS)
        payloads = builder.open_or_create()
        events = node.service_builder(name).event().open_or_create()
        self._alive += [node, payloads, events]
        return payloads, events

    def sender(self) -> Send:
        """Loan, fill, send, notify."""
        payloads, events = self._services()
        publisher = payloads.publisher_builder().initial_max_slice_len(PAYLOAD_BYTES).create()
        notify = events.notifier_builder().create().notify
        move = self._ctypes.memmove

        def send(payload: bytes) -> None:
            sample = publisher.loan_slice_uninit(PAYLOAD_BYTES)
            move(sample.payload_ptr, payload, PAYLOAD_BYTES)
            sample.assume_init().send()
            notify()

        return send

    def receiver(self) -> Receive:
        """Wait for the event, then take the sample and copy its bytes."""
        payloads, events = self._services()
        subscriber = payloads.subscriber_builder().buffer_size(RING_CELLS).create()
        wait = events.listener_builder().create().blocking_wait
        string_at = self._ctypes.string_at

        def receive() -> bytes:
            while True:
                if sample := subscriber.receive():
                    found: bytes = string_at(sample.payload_ptr, PAYLOAD_BYTES)
                    sample.delete()
                    return found
                wait()

        return receive

    def close(self) -> None:
        """Its files go with the directory; its memory stays when a process ends as the receiver does."""
        for path in glob.glob(f"/dev/shm/{self._prefix}*"):
            os.unlink(path)


class MultiprocessingQueue:
    """multiprocessing.Queue."""

    def __init__(self, directory: str) -> None:
        self._queue: Any = importlib.import_module("multiprocessing").get_context("fork").Queue()

    def sender(self) -> Send:
        """put: pickled and written by a thread of the queue's own."""
        send: Send = self._queue.put
        return send

    def receiver(self) -> Receive:
        """get."""
        receive: Receive = self._queue.get
        return receive

    def close(self) -> None:
        """Close both ends."""
        self._queue.close()
        with contextlib.suppress(Exception):
            self._queue.join_thread()


def _import(name: str, package: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ChannelMissing(f"{package} is not installed: pip install {package}") from None


OURS = "ring + bell"
OURS_ALONE = "ring + bell, blocked on the bell alone"
FLOOR = "pipe"
CHANNELS: dict[str, Callable[[str], Channel]] = {
    OURS: RingAndBell,
    OURS_ALONE: RingAndBellAlone,
    FLOOR: Pipe,
    "POSIX message queue": PosixQueue,
    "POSIX message queue in failstop's loop": PosixQueueInLoop,
    "Unix datagrams": UnixDatagrams,
    "ZeroMQ": ZeroMq,
    "iceoryx2": Iceoryx,
    "multiprocessing.Queue": MultiprocessingQueue,
}
