"""Clients that damage their memory, and a gate that starts again and reads what is there."""

from __future__ import annotations

from collections.abc import Callable

import msgpack
import pytest

from failstop.messages import layout, records
from tests.support.gate_scene import Client
from tests.support.stage import INCARNATION

from .client_side import Service

# Damage.


def scribble(client: Client, record: str, change: Callable[[bytes], bytes]) -> None:
    spec, view = client.segment.spec, client.segment.view
    at, size = spec.offsets[record], spec.records[record].size()
    view[at : at + size] = change(view[at : at + size])


def flip_all(found: bytes) -> bytes:
    return bytes(byte ^ 0x55 for byte in found)


def zero(found: bytes) -> bytes:
    return bytes(len(found))


@pytest.mark.parametrize("change", [flip_all, zero])
@pytest.mark.parametrize("record", ["command", "request"])
def test_a_damaged_record_is_ignored_and_a_whole_one_counts_again(
    service: Service, record: str, change: Callable[[bytes], bytes]
) -> None:
    client = service.known()
    client.command()
    client.request()
    scribble(client, record, change)
    assert [told[0] for told in service.look()] == [{"command": "request", "request": "command"}[record]]
    service.look()
    for _ in range(3):  # a writer that finds nothing whole begins at sequence 1 again
        client.command()
        client.request()
    assert sorted(str(told[0]) for told in service.look()) == ["command", "request"]


def test_a_damaged_hello_ends_the_session(service: Service) -> None:
    client = service.known()
    scribble(client, "hello", flip_all)
    client.command()
    assert service.look() == [("gone", 11)]
    assert service.sessions() == []
    client.hello(11, "back", service.pid)
    assert service.look() == [], "a session that is over does not come back"
    client.hello(12, "again", service.pid)
    client.command(session=12)
    assert service.look() == [("command", 12, 0.1)]


@pytest.mark.claim("MEMORY-1")
@pytest.mark.parametrize("record", ["hello", "command", "request"])
@pytest.mark.parametrize("payload", [b"", b"\0", bytes(7), b"\xff" * 60], ids=["empty", "1", "7", "60"])
def test_whole_records_of_any_content_raise_nothing(service: Service, record: str, payload: bytes) -> None:
    client = service.known()
    cell, spec = service.scene.load("failstop.shm.cell"), client.segment.spec
    most = 100  # a client may write more than the record is declared to hold
    seed = cell.seed(f"{spec.name}.{record}", INCARNATION)
    cell.LatestWriter(client.segment.view, spec.offsets[record], most, seed).write(payload)
    service.look()
    client.hello(12, "again", service.pid)
    client.command(session=12)
    assert ("command", 12, 0.1) in service.look()


def test_records_of_another_run_are_ignored(service: Service) -> None:
    client = service.known()
    segment = service.scene.load("failstop.shm.segment").Segment
    old = segment(client.segment.spec, INCARNATION + 1, fd=client.segment.fileno())
    old.latest_writer("command").write(records.COMMAND.pack(11, 0.2, 0.0, 0.0, False, "cmd_vel"))
    assert service.look() == []


@pytest.mark.parametrize("size", [0, 128])
def test_a_truncated_segment_is_a_client_gone(service: Service, size: int) -> None:
    client = service.join()
    client.command()
    service.look()
    service.scene.os.ftruncate(client.segment.fileno(), size)
    assert service.look() == [("gone", 11)]
    service.scene.os.ftruncate(client.segment.fileno(), client.segment.spec.size)
    assert service.look() == []


def test_names_of_the_worst_kind_leave_the_state_room(service: Service) -> None:
    """Invalid UTF-8 and wide characters grow when they are decoded; with eight of them the gate's state must still fit
    its record, or a client could end the gate."""
    hello = records.HELLO.pack(0, 0, 0, "")
    for index in range(layout.CLIENT_SLOTS):
        client = service.join(index, 1 + index)
        body = (1 + index).to_bytes(8, "little") + (2**32 - 1).to_bytes(4, "little") + bytes(8)
        room = client.segment.spec.records["hello"].capacity - len(hello)
        client.segment.latest_writer("hello").write(body + b"\xff" * room)
    service.look()
    assert service.sessions() == list(range(1, 1 + layout.CLIENT_SLOTS))
    who = service.table.active[0].who()
    latch = f"multiple cmd_vel publishers: {who}, {who}"
    state = msgpack.packb(
        {
            "enabled": False,
            "estop": latch,
            "blocked": f"estop: {latch}",
            "body_vel": (0.1, 0.1, 0.1),
            "wheels_rps": (0.1, 0.1, 0.1, 0.1),
            "epoch": 2**64 - 1,
            "clients": [
                {"slot": slot.index, "name": slot.name, "pid": slot.pid, "driving": False}
                for slot in service.table.active
            ],
        }
    )
    assert len(state) <= layout.SEGMENT_BY_NAME["gate"].records["state"].capacity


# A gate that starts again.


def test_a_successor_hears_of_what_was_there_before_it_only_the_request(service: Service) -> None:
    """Whether it has its answer already is in the gate's own record."""
    client = service.join()
    client.command()
    client.request(records.ENABLE)
    service.look()
    client.command()
    client.request(records.ENABLE)
    service.start()
    assert service.look() == [("request", 11, 2, records.ENABLE)]
    assert service.look() == []
    assert service.sessions() == [11], "the client is still there"
    client.command(0.2)
    client.request(records.DISABLE)
    assert service.look() == [("request", 11, 3, records.DISABLE), ("command", 11, 0.2)]
