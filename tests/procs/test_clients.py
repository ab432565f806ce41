"""The gate's table of clients: who is there, what is new, who has gone, who damages memory; and a gate that starts
again and reads what is there."""

from __future__ import annotations

from collections.abc import Callable
from math import isnan, nan

import msgpack
import pytest

from failstop.messages import layout, records
from failstop.procs.gate.remarks import MOST_AT_ONCE, SelfReports
from tests.support.gate_scene import NAMESPACE, Client
from tests.support.stage import INCARNATION, Dummy

from .client_side import NOW, Service

S = 1_000_000_000


def test_a_client_with_claim_and_hello_is_there(service: Service) -> None:
    assert (service.look(), service.sessions()) == ([], [])
    service.join(3, 42, name="a\nb\x1b[31mc\0d")
    assert (service.look(b"\x03"), service.sessions()) == ([], [42])
    slot = service.table.active[0]
    assert (slot.index, slot.name, slot.pid) == (3, "a?b?[31mc?d", service.pid), "made printable"
    assert slot.who() == f"a?b?[31mc?d (pid {service.pid})"
    client = service.join(session=0)  # which is the gamepad's, and no client's
    client.command()
    client.request()
    assert (service.look(), service.sessions(), service.held) == ([], [42], {})
    client.hello(5, "late", 1)
    service.join(1, 6).leave()
    assert (service.look(), service.sessions()) == ([], [42, 5]), "a hello and no claim is nobody"


def test_a_client_that_shows_another_name_stays_the_same_client(service: Service) -> None:
    client = service.known(name="reader")
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    client.hello(11, "reader or driver", 7)
    assert (service.look(), service.sessions()) == ([], [11])
    assert service.held == {"renamed": ("reader or driver (pid 7)",)}
    assert (service.look(), service.held) == ([], {}), "once"
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    assert service.commanded.who == "reader or driver (pid 7)"
    client.leave()
    assert service.tick() == [("gone", 11)], "it is watched as before"


@pytest.mark.parametrize("pid", [-1, 0, 2**32 - 1, 2**22 + 5])
def test_the_newest_command_arrives_once_whatever_pid_is_said(service: Service, pid: int) -> None:
    client = service.join(name="teleop", pid=pid)
    for vx in (0.1, 0.15):
        client.command(vx, t_ns=NOW - 7)
    assert [service.look(), service.look()] == [[("command", 11, 0.15)], []]
    command = service.commanded
    assert (command.t_ns, command.velocity, command.manual) == (NOW - 7, (0.15, 0.0, 0.0), False)
    assert pid >= 0 or command.who == f"teleop (pid {service.pid})"
    client.command(nan)
    service.look()
    assert isnan(service.commanded.velocity[0]), "passed on for the gate to judge"
    for session in (12, 0):
        client.command(session=session)
        client.request(session=session)
        assert service.look() == [], "another session's"
    client.command()
    assert service.tick() == [("command", 11, 0.1)], "a ring that was lost"
    client.command()
    client.leave()
    assert service.tick() == [("gone", 11)], "before a last command"
    assert (service.look(), service.sessions()) == ([], [])


def test_a_request_arrives_once_and_before_a_command_and_again_when_asked_again(service: Service) -> None:
    client = service.join()
    client.command()
    number = client.request(records.RESET)
    assert service.look() == [("request", 11, number, records.RESET), ("command", 11, 0.1)]
    assert service.look() == []
    assert client.request() != client.request()
    assert len(service.look()) == 1, "only the newest: a client waits for its answer"


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
    assert [(slot.session, slot.name) for slot in service.table.active] == [(52, "test"), (22, "second")]
    second.command(0.3)
    assert service.look() == [("command", 22, 0.3)]
    second.hello(32, "again", service.pid)
    assert (service.look(), service.sessions()) == ([("gone", 22)], [52, 32]), "under the same claim too"
    second.command(session=22)
    assert service.look() == []


def test_a_process_s_death_counts_though_a_child_of_it_holds_the_claim(service: Service) -> None:
    driver = Dummy(service.scene.machine, "driver")
    client = service.known(pid=driver.pid)
    life = service.table.active[0].life
    assert service.loop.wait(0) == {}
    driver.kill()
    ready = service.loop.wait(0)
    assert list(ready) == [life.fd]
    assert service.ended({service.claims_fd: 1}) == [], "no lifeline"
    assert service.ended(ready) == [("gone", 11)]
    assert service.loop.wait(0) == {}, "its descriptor is no longer watched"
    client.command()
    client.request()
    assert service.look() == [], "nor does what it left behind count"
    client.hello(12, "heir", service.pid)
    client.command(session=12)
    assert service.look() == [("command", 12, 0.1)]


@pytest.mark.parametrize("namespace", [0, 1, None])
def test_the_number_of_another_namespace_is_nobody_s_here(service: Service, namespace: int | None) -> None:
    """A client in a container: here another process has its number, and that one's end is none of its own."""
    other = Dummy(service.scene.machine, "other")
    if namespace is None:  # and nobody knows the own one
        service.scene.os.unlink(NAMESPACE)
        service.start()
    client = service.known(pid=other.pid, namespace=namespace or 0)
    assert service.table.active[0].life.pid == 0
    other.kill()
    assert service.loop.wait(0) == {}
    client.command()
    assert service.look() == [("command", 11, 0.1)]
    client.leave()
    assert service.tick() == [("gone", 11)], "its claim tells of its own end"


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


def test_clients_that_come_and_go_use_no_descriptors_up(service: Service) -> None:
    before = service.scene.open_fds()
    for session in range(1, 10):
        client = service.known(4, session)
        client.leave()
        service.look()
    assert service.scene.open_fds() == before


def test_a_hint_looks_at_its_slot_alone_and_garbage_for_one_at_all(service: Service) -> None:
    service.join(0, 61)
    service.join(7, 67)
    service.look(b"\x07\x07\x07")
    assert service.sessions() == [67]
    assert (service.look(b""), service.tick(), service.sessions()) == ([], [], [67]), "the ring was taken, or lost"
    assert list(service.table.look(service.table.slots)) == []
    assert sorted(service.sessions()) == [61, 67], "now and then all are looked at"
    for session, hints in enumerate((b"\x08", b"\xff", b"\x00\xff", b"garbage", b"0123"), 70):
        client = service.join(3, session)
        service.look(hints)
        assert session in service.sessions()
        client.leave()
        service.look()


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


def test_words_are_told_once_when_they_change_and_when_their_client_goes() -> None:
    said = SelfReports(0)
    assert said.update([], 0) is None
    for t_ns, wrong, told in (
        (5, "", [("nav (pid 7): all well", "")]),
        (5, "", None),
        (6, "", []),  # only said again: a new time, no news
        (7, "no map", [("nav (pid 7): no map", "warning")]),
        (8, "", [("nav (pid 7): all well", "")]),
    ):
        news = said.update([(11, 0, "nav (pid 7)", t_ns, "all well", wrong)], S)
        assert (None if news is None else [(note.text, note.level) for note in news]) == told
        assert said.table() == [(0, t_ns, "all well", wrong)]
    assert [note.text for note in said.update([], S) or []] == ["nav (pid 7) has gone"]
    assert said.table() == []
    said = SelfReports(0)
    each = [said.update([(11, 0, "nav", turn, str(turn), "")], 0) or [] for turn in range(200)]
    assert sum(map(len, each)) == MOST_AT_ONCE, "ever new things are told of now and then"
    assert said.table() == [(0, 199, "199", "")]


@pytest.mark.parametrize(
    ("parted", "wrong", "told"),
    [
        (False, "", ["nav (pid 7) has gone"]),
        (False, "no map", ["nav (pid 7) has gone"]),
        (True, "", []),
        (True, "no map", ["nav (pid 7) no longer reports: no map"]),
    ],
)
def test_a_goodbye_is_not_logged_as_a_death(parted: bool, wrong: str, told: list[str]) -> None:
    """The guard gives back its own slot when a driver comes, and goes on running."""
    said = SelfReports(0)
    said.update([(11, 0, "nav (pid 7)", 5, "all well", wrong)], S)
    if parted:
        said.part(11)
    assert [note.text for note in said.update([], S) or []] == told
    said.update([(11, 0, "nav (pid 7)", 6, "all well", "")], 2 * S)
    assert [note.text for note in said.update([], 2 * S) or []] == ["nav (pid 7) has gone"], "a goodbye counts once"


def test_a_report_that_only_grows_older_is_no_news() -> None:
    """As the guard's about a driver that hangs, which would be logged five times a second."""
    said = SelfReports(0)
    told = []
    ages = ("0.4 s", "0.6 s", "12 s", "2 min", "2 h 5 min", "3 days")
    for turn, age in enumerate(ages):
        wrong = f"it has written no speed for {age}, and a speed counts for 0.3 s"
        told += said.update([(11, 0, "nav", turn, "uses the port", wrong)], turn * S) or []
        assert said.table() == [(0, turn, "uses the port", wrong)], "screens show its age"
    for wrong in ("servo 3 is silent for 2 s", "servo 4 is silent for 2 s", ""):
        told += said.update([(11, 0, "nav", 99, "uses the port", wrong)], 99 * S) or []
    assert [note.text for note in told] == [
        "nav: it has written no speed for 0.4 s, and a speed counts for 0.3 s",
        "nav: servo 3 is silent for 2 s",
        "nav: servo 4 is silent for 2 s",
        "nav: uses the port",
    ]


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


def scribble(client: Client, record: str, change: Callable[[bytes], bytes]) -> None:
    spec, view = client.segment.spec, client.segment.view
    at, size = spec.offsets[record], spec.records[record].size()
    view[at : at + size] = change(view[at : at + size])


def flip_all(found: bytes) -> bytes:
    return bytes(byte ^ 0x55 for byte in found)


@pytest.mark.parametrize("change", [flip_all, lambda found: bytes(len(found))])
@pytest.mark.parametrize(("record", "other"), [("command", "request"), ("request", "command")])
def test_a_damaged_record_is_ignored_and_a_whole_one_counts_again(
    service: Service, record: str, other: str, change: Callable[[bytes], bytes]
) -> None:
    client = service.known()
    client.command()
    client.request()
    scribble(client, record, change)
    assert [told[0] for told in service.look()] == [other]
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
    cell.LatestWriter(client.segment.view, spec.offsets[record], most, 2, seed).write(payload)
    service.look()
    client.hello(12, "again", service.pid)
    client.command(session=12)
    assert ("command", 12, 0.1) in service.look()


@pytest.mark.parametrize("size", [0, 128])
def test_a_truncated_segment_is_a_client_gone_and_another_run_s_ignored(service: Service, size: int) -> None:
    client = service.known()
    segment = service.scene.load("failstop.shm.segment").Segment
    old = segment(client.segment.spec, INCARNATION + 1, fd=client.segment.fileno())
    old.latest_writer("command").write(records.COMMAND.pack(11, 0.2, 0.0, 0.0, False, "cmd_vel"))
    assert service.look() == []
    for to, told in ((size, [("gone", 11)]), (client.segment.spec.size, [])):
        service.scene.os.ftruncate(client.segment.fileno(), to)
        assert service.look() == told


def test_names_of_the_worst_kind_leave_the_state_room(service: Service) -> None:
    """Invalid UTF-8 and wide characters grow when they are decoded; with eight of them the gate's state must still fit
    its record, or a client could end the gate."""
    for index in range(layout.CLIENT_SLOTS):
        client = service.join(index, 1 + index)
        body = (1 + index).to_bytes(8, "little") + (2**32 - 1).to_bytes(4, "little") + bytes(8)
        room = client.segment.spec.records["hello"].capacity - len(records.HELLO.pack(0, 0, 0, ""))
        client.write("hello", body + b"\xff" * room)
    service.look()
    slots = service.table.active
    assert service.sessions() == list(range(1, 1 + layout.CLIENT_SLOTS))
    latch = f"multiple cmd_vel publishers: {slots[0].who()}, {slots[0].who()}"
    state = {"enabled": False, "estop": latch, "blocked": f"estop: {latch}", "epoch": 2**64 - 1}
    state |= {"body_vel": (0.1,) * 3, "wheels_rps": (0.1,) * 4}
    state["clients"] = [{"slot": it.index, "name": it.name, "pid": it.pid, "driving": False} for it in slots]
    assert len(msgpack.packb(state)) <= layout.SEGMENT_BY_NAME["gate"].records["state"].capacity


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
