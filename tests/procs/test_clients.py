"""The gate's table of clients: who is there, what is new, who has gone."""

from __future__ import annotations

from math import isnan, nan

import pytest

from failstop.messages import records
from failstop.procs.gate.remarks import MOST_AT_ONCE, SelfReports
from tests.support.gate_scene import NAMESPACE
from tests.support.stage import Dummy

from .client_side import NOW, Service

S = 1_000_000_000

# New clients.


def test_a_client_with_claim_and_hello_is_there(service: Service) -> None:
    assert service.look() == []
    assert service.sessions() == []
    service.join(3, 42, name="a\nb\x1b[31mc\0d")
    assert service.look(b"\x03") == []
    assert service.sessions() == [42]
    slot = service.table.active[0]
    assert (slot.index, slot.name, slot.pid) == (3, "a?b?[31mc?d", service.pid), "made printable"
    assert slot.who() == f"a?b?[31mc?d (pid {service.pid})"


def test_a_client_needs_a_claim_and_a_hello(service: Service) -> None:
    client = service.join(session=0)
    assert service.look() == []
    assert service.sessions() == []
    client.hello(5, "late", 1)
    service.look()
    assert service.sessions() == [5]
    service.join(1, 6).leave()
    assert service.look() == []
    assert service.sessions() == [5]


def test_a_claimed_slot_without_a_hello_commands_nothing(service: Service) -> None:
    """Session 0 is no client's: it is the gamepad's."""
    client = service.join(session=0)
    client.command()
    client.request()
    assert service.look() == []
    assert service.held == {}


@pytest.mark.parametrize("pid", [0, 2**32 - 1, 2**22 + 5])
def test_a_pid_that_is_a_lie_does_no_harm(service: Service, pid: int) -> None:
    client = service.known(pid=pid)
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    client.leave()
    assert service.look() == [("gone", 11)]


# Commands and requests.


def test_the_newest_command_arrives_once(service: Service) -> None:
    client = service.join(name="teleop")
    for vx in (0.1, 0.15):
        client.command(vx, t_ns=NOW - 7)
    assert service.look() == [("command", 11, 0.15)]
    assert service.look() == []
    command = service.commanded
    assert (command.t_ns, command.velocity, command.manual) == (NOW - 7, (0.15, 0.0, 0.0), False)
    assert command.who == f"teleop (pid {service.pid})"
    client.command(nan)
    service.look()
    assert isnan(service.commanded.velocity[0]), "passed on for the gate to judge"


def test_a_request_arrives_once_and_before_a_command_and_again_when_asked_again(service: Service) -> None:
    client = service.join()
    client.command()
    number = client.request(records.RESET)
    assert service.look() == [("request", 11, number, records.RESET), ("command", 11, 0.1)]
    assert service.look() == []
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


def test_a_claim_that_has_gone_is_noticed_before_a_last_command(service: Service) -> None:
    client = service.known()
    client.command()
    client.leave()
    assert service.look(b"\x00") == [("gone", 11)]
    assert service.sessions() == []
    assert service.look() == []


def test_a_tick_finds_news_whose_ring_was_lost_and_a_claim_that_has_gone(service: Service) -> None:
    client = service.known()
    client.command()
    assert service.tick() == [("command", 11, 0.1)]
    client.leave()
    assert service.tick() == [("gone", 11)]


def test_a_new_client_whose_ring_was_lost_is_found_now_and_then(service: Service) -> None:
    service.join(7)
    service.tick()
    assert service.sessions() == []
    assert list(service.table.look(service.table.slots)) == []
    assert service.sessions() == [11]


@pytest.mark.parametrize("seen_by", ["the claim", "the slot"])
def test_a_goodbye_is_told_from_a_death(service: Service, seen_by: str) -> None:
    for parted in (True, False):
        client = service.known(session=21 + parted)
        if parted:
            client.goodbye()
        if seen_by == "the claim":
            client.leave()
        else:
            client.segment.wipe()
        assert service.look() == [("gone", 21 + parted)]
        assert service.parted is parted
        if seen_by == "the slot":
            client.leave()
        service.look()


def test_a_slot_is_used_again_by_another_session(service: Service) -> None:
    other, first = service.join(1, 52), service.join(2, 21, name="first")
    first.command(0.1)
    first.request()
    service.look()
    first.command(0.2)
    first.leave()
    other.command()
    second = service.join(2, 22, name="second")
    assert service.look() == [("command", 52, 0.1), ("gone", 21)], "the first's last command is not the second's"
    assert service.sessions() == [52, 22]
    assert service.table.active[1].name == "second"
    second.command(0.3)
    assert service.look() == [("command", 22, 0.3)]


def test_a_new_hello_under_the_same_claim_is_a_new_client(service: Service) -> None:
    client = service.known(session=31)
    client.hello(32, "again", service.pid)
    assert service.look() == [("gone", 31)]
    assert service.sessions() == [32]
    client.command(session=31)
    assert service.look() == []


def test_a_process_s_death_is_noticed_through_its_lifeline(service: Service) -> None:
    driver = Dummy(service.scene.machine, "driver")
    client = service.known(pid=driver.pid)
    life = service.table.active[0].life
    assert service.loop.wait(0) == {}
    client.leave()
    driver.kill()
    ready = service.loop.wait(0)
    assert list(ready) == [life.fd]
    assert service.ended({service.claims_fd: 1}) == [], "no lifeline"
    assert service.ended(ready) == [("gone", 11)]
    assert service.loop.wait(0) == {}, "its descriptor is no longer watched"


@pytest.mark.parametrize("namespace", [0, 1])
def test_the_number_of_another_namespace_is_nobody_s_here(service: Service, namespace: int) -> None:
    """A client in a container: here another process has its number, and that one's end is none of its own."""
    other = Dummy(service.scene.machine, "other")
    client = service.known(pid=other.pid, namespace=namespace)
    assert service.table.active[0].life.pid == 0
    other.kill()
    assert service.loop.wait(0) == {}
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    client.leave()
    assert service.tick() == [("gone", 11)], "its claim tells of its own end"


def test_nobody_is_watched_where_the_own_namespace_is_not_known(service: Service) -> None:
    service.scene.os.unlink(NAMESPACE)
    service.start()
    service.known(namespace=0)
    assert service.sessions() == [11]
    assert service.table.active[0].life.pid == 0


@pytest.mark.parametrize("namespace", [None, 1])
def test_the_futex_tells_of_a_death_whatever_the_number_is(service: Service, namespace: int | None) -> None:
    """The thread that holds it ends; the process, and with it pidfd and claim, is there as before."""
    machine = service.scene.machine
    client = service.join(namespace=namespace)
    word = client.segment.futex("held", write=True)
    kept: list[object] = []

    def hold() -> None:
        kept.append(word.hold())
        machine.block()

    thread = machine.thread(machine.processes[service.pid], hold)
    service.scene.clock.now_ns += 1
    assert word.held()
    service.look()
    life = service.table.active[0].life
    service.scene.clock.now_ns += 1
    assert not life.marked
    machine.wake(thread)
    service.scene.clock.now_ns += 1
    assert life.marked
    assert service.ended({service.early.bell.fd: 1}) == [("gone", 11)]
    word.close()


def test_a_process_s_death_counts_though_a_child_of_it_holds_the_claim(service: Service) -> None:
    """A child of the driver inherits its claim; the driver has gone all the same."""
    driver = Dummy(service.scene.machine, "driver")
    client = service.known(pid=driver.pid)
    driver.kill()
    assert service.ended(service.loop.wait(0)) == [("gone", 11)]
    assert service.loop.wait(0) == {}
    client.command()
    client.request()
    assert service.look() == [], "nor does what it left behind count"
    client.hello(12, "heir", service.pid)
    client.command(session=12)
    assert service.look() == [("command", 12, 0.1)]


def test_clients_that_come_and_go_use_no_descriptors_up(service: Service) -> None:
    before = service.scene.open_fds()
    for session in range(1, 10):
        client = service.known(4, session)
        client.leave()
        service.look()
    assert service.scene.open_fds() == before


# Hints.


def test_a_hint_looks_at_its_slot_alone(service: Service) -> None:
    service.join(0, 61)
    service.join(1, 62)
    service.look(b"\x01\x01\x01")
    assert service.sessions() == [62]
    assert service.look(b"") == [], "an earlier wake-up has taken the ring"
    assert service.sessions() == [62]


@pytest.mark.parametrize("hints", [b"\x08", b"\xff", b"\x00\xff", b"garbage", b"0123"])
def test_garbage_for_a_hint_looks_at_all(service: Service, hints: bytes) -> None:
    service.join(0, 61)
    service.join(7, 67)
    service.look(hints)
    assert service.sessions() == [61, 67]


def test_the_assertions_of_a_session_are_read_with_their_time(service: Service) -> None:
    client = service.known()
    assert service.held == {}
    client.segment.latest_writer("sensed").write(records.ASSERTED.pack(11, []), 1234)
    client.segment.latest_writer("interlocks").write(records.ASSERTED.pack(11, ["arm", "lid"]), 5678)
    service.look()
    assert service.held == {"sensed": (1234, []), "interlocks": (5678, ["arm", "lid"])}
    client.segment.latest_writer("sensed").write(records.ASSERTED.pack(12, []), 9999)
    client.segment.latest_writer("interlocks").write(b"\xff")
    service.look()
    assert service.held == {}, "another session's word, and damage"


# What clients say of themselves: passed on, told of when it changes, bounded, and of the one that holds the slot.


def test_words_are_told_once_when_they_change_and_when_their_client_goes() -> None:
    said = SelfReports(0)
    assert said.follow([], 0) is None
    for t_ns, wrong, told in (
        (5, "", [("nav (pid 7) says: all well", "")]),
        (5, "", None),
        (6, "", []),  # only said again: a new time, no news
        (7, "no map", [("nav (pid 7) says: no map", "warning")]),
        (8, "", [("nav (pid 7) says: all well", "")]),
    ):
        news = said.follow([(11, 0, "nav (pid 7)", t_ns, "all well", wrong)], S)
        assert (None if news is None else [(note.text, note.level) for note in news]) == told
        assert said.table() == [(0, t_ns, "all well", wrong)]
    news = said.follow([], S)
    assert news is not None
    assert [note.text for note in news] == ["nav (pid 7) has gone"]
    assert said.table() == []


def test_a_client_that_says_ever_new_things_is_told_of_now_and_then() -> None:
    said = SelfReports(0)
    told = [said.follow([(11, 0, "nav", turn, str(turn), "")], 0) or [] for turn in range(200)]
    assert sum(map(len, told)) == MOST_AT_ONCE
    assert said.table() == [(0, 199, "199", "")]


def test_words_are_bounded_and_printable(service: Service) -> None:
    client = service.known()
    assert service.table.active[0].said() is None
    for t_ns, (sees, wrong, read) in enumerate(
        [
            ("all well", "", ("all well", "")),
            ("two\nlines", "also\ntwo", ("two lines", "also two")),
            ("\x1b[31mred", "", ("?[31mred", "")),
            ("ä" * 500, "", ("ä" * 95, "")),
        ],
        42,
    ):
        client.segment.latest_writer("said").write(records.SAID.pack(11, sees, wrong), t_ns)
        assert service.table.active[0].said() == (t_ns, *read)
    for payload in (b"", b"short", records.SAID.pack(12, "of another session", "")):
        client.segment.latest_writer("said").write(payload)
        assert service.table.active[0].said() is None
