"""The gate's table of clients, over real segments, claims and processes of a temporary instance."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from math import isnan, nan
from pathlib import Path

import msgpack
import pytest

from failstop.procs.gate.clients import ClientTable, Slot
from failstop.procs.gate.core import Command
from failstop.procs.loop import Loop
from failstop.shm import claim, layout, records, segment
from failstop.shm.segment import Segment

from .parts import open_fds, until

INCARNATION = 0x1234_5678_9ABC
NOW = 77_000_000_000
ALL = bytes(range(layout.CLIENT_SLOTS))
_numbers = itertools.count()


class Client:
    """A client of another process, as far as memory and claims go."""

    def __init__(
        self, service: Service, index: int, session: int, *, name: str = "test", pid: int | None = None
    ) -> None:
        self.index = index
        self.session = session
        self.number = 0
        self._claims = claim.open_claims(str(service.claims))
        self.segment = segment.attach_client_slot(service.name, index, INCARNATION)
        assert claim.take(self._claims, index)
        self.hello(session, name, os.getpid() if pid is None else pid)

    def hello(self, session: int, name: str, pid: int) -> None:
        self.segment.latest_writer("hello").write(records.pack_hello(session, pid, name))

    def command(self, vx: float = 0.1, *, session: int | None = None, t_ns: int = NOW) -> None:
        payload = records.pack_command(self.session if session is None else session, vx, 0.0, 0.0, False)
        self.segment.latest_writer("command").write(payload, t_ns)

    def request(self, verb: int = records.ENABLE, *, session: int | None = None) -> int:
        self.number += 1
        whose = self.session if session is None else session
        self.segment.latest_writer("request").write(records.pack_request(whose, self.number, verb))
        return self.number

    def leave(self) -> None:
        """The process dies: its claim goes, its memory stays."""
        os.close(self._claims)
        self.segment.close()
        self._claims = -1

    def close(self) -> None:
        if self._claims >= 0:
            self.leave()


class Service:
    """The service's side: eight client segments, the claims file, the table, and what it was told."""

    def __init__(self, directory: Path) -> None:
        self.name = f"c{os.getpid()}x{next(_numbers)}"
        self.claims = directory / "claims"
        os.close(claim.open_claims(str(self.claims), create=True))
        for index in range(layout.CLIENT_SLOTS):
            segment.create(self.name, f"client.{index}", INCARNATION).close()
        self.claims_fd = os.open(self.claims, os.O_RDONLY)
        self.loop = Loop()
        self.clients: list[Client] = []
        self._read: list[Segment] = []
        self.start()

    def start(self) -> None:
        """A gate starts, or starts again after its death."""
        slots = [segment.read_client_slot(self.name, i, INCARNATION) for i in range(layout.CLIENT_SLOTS)]
        self._read += slots
        self.table = ClientTable(slots, self.claims_fd, self.loop, self)
        self.told: list[tuple[object, ...]] = []

    def join(self, index: int = 0, session: int = 11, *, name: str = "test", pid: int | None = None) -> Client:
        self.clients.append(Client(self, index, session, name=name, pid=pid))
        return self.clients[-1]

    def client_command(self, command: Command, now_ns: int) -> None:
        self.told.append(("command", command.session, command.velocity[0]))
        self.commanded = command

    def client_request(self, slot: Slot, number: int, verb: int, now_ns: int) -> None:
        self.told.append(("request", slot.session, number, verb))

    def client_gone(self, slot: Slot, now_ns: int) -> None:
        self.told.append(("gone", slot.session))

    def look(self, hints: bytes = ALL) -> list[tuple[object, ...]]:
        """Ring the bell; returns what the listener was told."""
        self.told.clear()
        self.table.rung(hints, NOW)
        return list(self.told)

    def sessions(self) -> list[int]:
        return [slot.session for slot in self.table.active]

    def close(self) -> None:
        for client in self.clients:
            client.close()
        for slot in self.table.slots:
            if slot.life:
                slot.life.close()
        for read in self._read:
            read.close()
        os.close(self.claims_fd)
        segment.unlink_all(self.name)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    made = Service(tmp_path)
    yield made
    made.close()


# New clients.


def test_nobody_at_first(service: Service) -> None:
    assert service.look() == []
    assert service.sessions() == []


def test_a_client_with_claim_and_hello_is_there(service: Service) -> None:
    service.join(3, 42, name="teleop")
    assert service.look(b"\x03") == []
    assert service.sessions() == [42]
    slot = service.table.active[0]
    assert (slot.index, slot.name, slot.pid) == (3, "teleop", os.getpid())
    assert slot.who() == f"teleop (pid {os.getpid()})"


def test_no_claim_no_client(service: Service) -> None:
    client = service.join()
    client.leave()
    assert service.look() == []
    assert service.sessions() == []


def test_a_claim_without_a_hello_is_no_client_yet(service: Service) -> None:
    client = service.join(session=0)
    assert service.look() == []
    assert service.sessions() == []
    client.hello(5, "late", 1)
    service.look()
    assert service.sessions() == [5]


def test_eight_clients_at_once(service: Service) -> None:
    for index in range(layout.CLIENT_SLOTS):
        service.join(index, 100 + index)
    service.look()
    assert service.sessions() == list(range(100, 108))


@pytest.mark.parametrize("pid", [0, 2**32 - 1, 2**22 + 5])
def test_a_pid_that_is_a_lie_does_no_harm(service: Service, pid: int) -> None:
    client = service.join(pid=pid)
    service.look()
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    client.leave()
    assert service.look() == [("gone", 11)]


def test_names_are_made_printable(service: Service) -> None:
    service.join(name="a\nb\x1b[31mc\0d")
    service.look()
    assert service.table.active[0].name == "a?b?[31mc?d"


# Commands and requests.


def test_a_command_arrives_once(service: Service) -> None:
    client = service.join(name="teleop")
    client.command(0.15, t_ns=NOW - 7)
    assert service.look() == [("command", 11, 0.15)]
    assert service.look() == []
    command = service.commanded
    assert (command.t_ns, command.velocity, command.manual) == (NOW - 7, (0.15, 0.0, 0.0), False)
    assert command.who == f"teleop (pid {os.getpid()})"


def test_the_newest_command_wins(service: Service) -> None:
    client = service.join()
    for vx in (0.1, 0.2, 0.3):
        client.command(vx)
    assert service.look() == [("command", 11, 0.3)]


def test_what_is_not_finite_is_passed_on_for_the_gate_to_judge(service: Service) -> None:
    client = service.join()
    client.command(nan)
    service.look()
    assert isnan(service.commanded.velocity[0])


def test_a_request_arrives_once_and_before_a_command(service: Service) -> None:
    client = service.join()
    client.command()
    number = client.request(records.RESET)
    assert service.look() == [("request", 11, number, records.RESET), ("command", 11, 0.1)]
    assert service.look() == []


def test_the_same_request_again_is_a_new_one(service: Service) -> None:
    client = service.join()
    assert client.request() != client.request()
    assert len(service.look()) == 1, "only the newest: a client waits for its answer"
    client.request()
    assert len(service.look()) == 1


def test_another_session_s_records_are_ignored(service: Service) -> None:
    client = service.join(session=11)
    client.command(session=12)
    client.request(session=12)
    assert service.look() == []
    client.command(session=0)
    assert service.look() == []
    client.command()
    assert service.look() == [("command", 11, 0.1)]


# Who has gone.


def test_a_claim_that_has_gone_is_noticed_at_the_next_look(service: Service) -> None:
    client = service.join()
    service.look()
    client.leave()
    assert service.look(b"\x00") == [("gone", 11)]
    assert service.sessions() == []
    assert service.look() == []


def test_a_tick_notices_a_claim_that_has_gone(service: Service) -> None:
    client = service.join()
    service.look()
    client.leave()
    service.table.look_at_active(NOW)
    assert service.told == [("gone", 11)]


def test_a_tick_finds_news_whose_ring_was_lost(service: Service) -> None:
    client = service.join()
    service.look()
    client.command()
    service.table.look_at_active(NOW)
    assert service.told == [("command", 11, 0.1)]


def test_a_new_client_whose_ring_was_lost_is_found_now_and_then(service: Service) -> None:
    service.join(7)
    service.table.look_at_active(NOW)
    assert service.sessions() == []
    service.table.look_at_all(NOW)
    assert service.sessions() == [11]


def test_commands_written_before_the_death_do_not_count_after_it(service: Service) -> None:
    client = service.join()
    service.look()
    client.command()
    client.leave()
    assert service.look() == [("gone", 11)]


def test_a_slot_is_used_again_by_another_session(service: Service) -> None:
    first = service.join(2, 21, name="first")
    first.command(0.1)
    first.request()
    service.look()
    first.command(0.2)
    first.leave()
    second = service.join(2, 22, name="second")
    assert service.look() == [("gone", 21)], "the first's last command is not the second's"
    assert service.sessions() == [22]
    assert service.table.active[0].name == "second"
    second.command(0.3)
    assert service.look() == [("command", 22, 0.3)]


def test_a_new_hello_under_the_same_claim_is_a_new_client(service: Service) -> None:
    client = service.join(session=31)
    service.look()
    client.hello(32, "again", os.getpid())
    assert service.look() == [("gone", 31)]
    assert service.sessions() == [32]
    client.command(session=31)
    assert service.look() == []


def test_one_leaving_leaves_the_others(service: Service) -> None:
    first, second = service.join(0, 51), service.join(1, 52)
    service.look()
    first.leave()
    second.command()
    assert service.look() == [("gone", 51), ("command", 52, 0.1)]
    assert service.sessions() == [52]


def test_a_process_s_death_is_noticed_through_its_lifeline(service: Service) -> None:
    go, wait = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(wait)
        os.read(go, 1)
        os._exit(0)
    os.close(go)
    client = service.join(pid=pid)
    service.look()
    life = service.table.active[0].life
    assert life is not None
    assert service.loop.wait(0) == {}
    client.leave()
    os.close(wait)
    until(lambda: service.loop.wait(0), "the lifeline")
    os.waitpid(pid, 0)
    ready = service.loop.wait(0)
    assert list(ready) == [life.fd]
    service.told.clear()
    service.table.life_ended(next(iter(ready)), NOW)
    assert service.told == [("gone", 11)]
    assert service.loop.wait(0) == {}, "its descriptor is no longer watched"


def test_a_lifeline_that_ends_while_the_claim_is_held_leaves_the_client(service: Service) -> None:
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    client = service.join(pid=pid)
    service.look()
    life = service.table.active[0].life
    assert life is not None
    until(lambda: service.loop.wait(0), "the lifeline")
    service.table.life_ended(life.fd, NOW)
    os.waitpid(pid, 0)
    assert service.loop.wait(0) == {}
    client.command()
    assert service.look() == [("command", 11, 0.1)]


def test_descriptors_that_are_no_lifeline_are_ignored(service: Service) -> None:
    service.join()
    service.look()
    service.table.life_ended(service.claims_fd, NOW)
    assert service.told == []
    assert service.sessions() == [11]


def test_coming_and_going_uses_nothing_up(service: Service) -> None:
    before = open_fds()
    for session in range(1, 50):
        client = service.join(4, session)
        service.look()
        client.leave()
        service.look()
    assert open_fds() == before


# Hints.


def test_a_hint_looks_at_its_slot_alone(service: Service) -> None:
    service.join(0, 61)
    service.join(1, 62)
    service.look(b"\x01\x01\x01")
    assert service.sessions() == [62]


@pytest.mark.parametrize("hints", [b"\x08", b"\xff", b"\x00\xff", b"garbage", b"0123"])
def test_garbage_for_a_hint_looks_at_all(service: Service, hints: bytes) -> None:
    service.join(0, 61)
    service.join(7, 67)
    service.look(hints)
    assert service.sessions() == [61, 67]


def test_a_ring_that_was_taken_by_an_earlier_wake_up_is_nothing(service: Service) -> None:
    service.join()
    assert service.look(b"") == []
    assert service.sessions() == []


# Damage.


def scribble(client: Client, record: str, change: Callable[[bytearray], None]) -> None:
    spec = client.segment.spec
    at, size = spec.offsets[record], spec.records[record].size()
    view = client.segment.view
    found = bytearray(view[at : at + size])
    change(found)
    view[at : at + size] = bytes(found)


def flip_all(found: bytearray) -> None:
    found[:] = bytes(byte ^ 0x55 for byte in found)


def zero(found: bytearray) -> None:
    found[:] = bytes(len(found))


@pytest.mark.parametrize("change", [flip_all, zero])
@pytest.mark.parametrize("record", ["command", "request"])
def test_a_damaged_record_is_ignored_and_a_whole_one_counts_again(
    service: Service, record: str, change: Callable[[bytearray], None]
) -> None:
    client = service.join()
    service.look()
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
    client = service.join()
    service.look()
    scribble(client, "hello", flip_all)
    client.command()
    assert service.look() == [("gone", 11)]
    assert service.sessions() == []
    client.hello(11, "back", os.getpid())
    assert service.look() == [("command", 11, 0.1)]


@pytest.mark.parametrize("record", ["hello", "command", "request"])
@pytest.mark.parametrize("payload", [b"", b"\0", bytes(7), b"\xff" * 60], ids=["empty", "1", "7", "60"])
def test_whole_records_of_any_content_raise_nothing(service: Service, record: str, payload: bytes) -> None:
    client = service.join()
    service.look()
    client.segment.latest_writer(record).write(payload)
    service.look()
    client.hello(11, "again", os.getpid())
    client.command()
    assert ("command", 11, 0.1) in service.look()


def test_records_of_another_run_are_ignored(service: Service) -> None:
    client = service.join()
    service.look()
    old = Segment(client.segment.spec, INCARNATION + 1, client.segment.view, None, -1)
    old.latest_writer("command").write(records.pack_command(11, 0.2, 0.0, 0.0, False))
    assert service.look() == []


@pytest.mark.parametrize("size", [0, 1, 128, 300])
def test_a_truncated_segment_is_a_client_gone(service: Service, size: int) -> None:
    client = service.join()
    client.command()
    service.look()
    os.ftruncate(client.segment.view.fd, size)  # type: ignore[attr-defined]
    assert service.look() == [("gone", 11)]
    os.ftruncate(client.segment.view.fd, client.segment.spec.size)  # type: ignore[attr-defined]
    assert service.look() == []


def test_names_of_the_worst_kind_leave_the_state_room(service: Service) -> None:
    """Invalid UTF-8 and wide characters grow when they are decoded; with eight of them the gate's state must still fit
    its record, or a client could end the gate."""
    hello = records.pack_hello(0, 0, "")
    for index in range(layout.CLIENT_SLOTS):
        client = service.join(index, 1 + index)
        body = (1 + index).to_bytes(8, "little") + (2**32 - 1).to_bytes(4, "little")
        room = client.segment.spec.records["hello"].capacity - len(hello)
        client.segment.latest_writer("hello").write(body + b"\xff" * room)
    service.look()
    assert len(service.sessions()) == layout.CLIENT_SLOTS
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
    assert len(state) <= layout.BY_NAME["gate"].records["state"].capacity


# A gate that starts again.


def test_a_successor_does_not_replay_what_it_finds(service: Service) -> None:
    client = service.join()
    client.command()
    client.request(records.ENABLE)
    service.look()
    service.start()
    assert service.look() == []
    assert service.sessions() == [11], "the client is still there"
    client.command(0.2)
    assert service.look() == [("command", 11, 0.2)]


def test_a_successor_does_not_act_on_what_its_predecessor_never_saw(service: Service) -> None:
    client = service.join()
    service.look()
    client.command()
    client.request(records.ENABLE)
    service.start()
    assert service.look() == []
    client.request(records.DISABLE)
    assert service.look() == [("request", 11, 2, records.DISABLE)]
