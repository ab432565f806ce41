"""One pair of processes and one channel between them: `python -m bench.oneway_pair CHANNEL`, for bench/oneway.py.

The first process sends at 1 kHz and the second, its child, blocks in the receive. Both are under SCHED_FIFO where that
is allowed, with every thread that their channel starts, and each has a core of its own where there are two: which of
them a scheduler would choose must not be what is compared.

One byte on standard output says that both are there. Each line of standard input is a number of messages to send. Their
latencies go to standard output as u64: how many arrived (fewer, when a receiver that was held up lost some), then each
in ns. The end of standard input ends both. Exit code 3: the channel is missing here, and standard error says why.
"""

from __future__ import annotations

import array
import contextlib
import gc
import os
import struct
import sys
import tempfile
import time

from bench.oneway_peer import CHANNELS, PAYLOAD_BYTES, Channel, ChannelMissing, Send
from failstop.procs import rights

PRIORITY = 30
PERIOD_NS = 1_000_000
MISSING = 3
READY = b"x"
COUNT_BYTES = 8
_MESSAGE = struct.Struct(f"<QQ{PAYLOAD_BYTES - 16}x")
"""When it was sent, and how many follow it."""
_LAST = (1 << 64) - 1


def _pin_to_core(core: int) -> None:
    """Without SCHED_RESET_ON_FORK: threads that a library starts are to have what their process has."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[core % len(cores)]})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    gc.collect()
    gc.freeze()
    gc.disable()


def _receive(channel: Channel, ready: int) -> None:
    """Write the latencies of every lot, from just before the send to the return of the receive."""
    receive = channel.receiver()
    now = time.monotonic_ns
    taken = array.array("Q")
    os.write(ready, READY)
    while True:
        payload = receive()
        arrived_ns = now()
        sent_ns, follow = _MESSAGE.unpack(payload)
        if follow == _LAST:
            return
        taken.append(arrived_ns - sent_ns)
        if follow == 0:
            os.write(1, len(taken).to_bytes(COUNT_BYTES, "little") + taken.tobytes())
            del taken[:]


def _send(channel: Channel, ready: int) -> None:
    """Send lots of messages at 1 kHz, as standard input asks for them."""
    send = channel.sender()
    os.read(ready, 1)
    os.write(1, READY)
    for line in sys.stdin:
        _send_lot(send, int(line))
    send(_MESSAGE.pack(0, _LAST))


def _send_lot(send: Send, messages: int) -> None:
    now = time.monotonic_ns
    pack = _MESSAGE.pack
    next_ns = now() + PERIOD_NS
    for follow in range(messages - 1, -1, -1):
        time.sleep(max(0, next_ns - now()) * 1e-9)
        send(pack(now(), follow))
        # A sender that was held up does not catch up: the messages must find the receiver asleep.
        next_ns = max(next_ns + PERIOD_NS, now() + PERIOD_NS // 2)


def main(name: str) -> int:
    """Serve one channel."""
    with tempfile.TemporaryDirectory(prefix="failstop-oneway-") as directory:
        try:
            channel = CHANNELS[name](directory)
        except ChannelMissing as reason:
            print(reason, file=sys.stderr)
            return MISSING
        try:
            return _pair(channel)
        finally:
            channel.close()


def _pair(channel: Channel) -> int:
    ready, tell = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            rights.die_with_parent(parent)
            _pin_to_core(1)
            _receive(channel, tell)
            code = 0
        except BaseException as error:
            print(f"receiver: {type(error).__name__}: {error}", file=sys.stderr)
        finally:
            os._exit(code)
    os.close(tell)
    _pin_to_core(0)
    _send(channel, ready)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
