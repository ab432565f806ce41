"""The benchmarks beside other tools: every peer and every channel does what it is measured for, and leaves nothing; the
pty's carriers are before ordinary programs while a bench measures, and as they were afterwards."""

from __future__ import annotations

import glob
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from bench import carriers, oneway, peers, stats
from bench.carriers import Carriers, Kernel
from bench.oneway_peer import CHANNELS, FLOOR, OURS
from bench.peer import ExitHandler, Peer, PeerMissing
from bench.peer_supervisord import Supervisord
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Stopped, wait_for

MS = 1_000_000


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SimBoard]:
    with SimBoard(tmp_path / "board") as board:
        yield board


@pytest.fixture
def nothing_left() -> Iterator[None]:
    """No process that was started is left, and no shared memory of a channel."""
    before = set(psutil.Process().children(recursive=True))
    memory = set(glob.glob("/dev/shm/*oneway-*"))
    yield
    wait_for("every process to end", lambda: set(psutil.Process().children(recursive=True)) <= before)
    assert set(glob.glob("/dev/shm/*oneway-*")) <= memory


PEERS = [
    pytest.param(kind, marks=[pytest.mark.slow] * issubclass(kind, Supervisord), id=kind.__name__)
    for kind in peers.PEERS
]


@pytest.mark.parametrize("kind", PEERS)
def test_a_peer_stops_the_wheels_of_a_killed_driver(kind: type[Peer], nothing_left: None, board: SimBoard) -> None:
    try:
        peer = kind(board.link)
    except PeerMissing as reason:
        pytest.skip(str(reason))
    try:
        samples = [peers.sample(peer, board, 0.05) for _ in range(2)]
    finally:
        peer.close()
    assert all(0 < sample < peers.STOP_S * 1e9 for sample in samples)


def test_a_peer_that_is_closed_while_driving_ends_its_driver(nothing_left: None, board: SimBoard) -> None:
    peer = ExitHandler(board.link)
    pid = peer.start()
    board.wait_wheels(True, 10.0)
    peer.close()
    assert not psutil.pid_exists(pid)


@pytest.mark.parametrize(("stop_ms", "after", "moved"), [(None, 0, True), (1, 1, True), (1, 0, False)])
def test_no_stop_motion_after_it_or_wheels_at_rest_are_no_sample(stop_ms: int | None, after: int, moved: bool) -> None:
    ns = stop_ms and stop_ms * MS
    with pytest.raises(peers.PeerFailed):
        peers.checked_ns("peer", Stopped(0, ns, ns, ns, after, moved))


@pytest.mark.parametrize(("theirs_ms", "met"), [((39, 100), False), ((41, 100), True)])
def test_the_bar_is_the_fastest_peer_against_the_slower_kill(theirs_ms: tuple[int, int], met: bool) -> None:
    theirs = {f"peer {ms}": [ms * MS] for ms in theirs_ms}
    rows = peers.rows_of({"gate": [1 * MS], "port_owner": [2 * MS]}, theirs, {"absent": "not installed"})
    assert rows[-1].met is met
    assert f"peer {theirs_ms[0]}" in rows[-1].result
    assert [row.result for row in rows if row.measure == "absent"] == ["skipped: not installed"]


@pytest.mark.parametrize("name", CHANNELS)
def test_a_channel_brings_every_message(name: str, nothing_left: None) -> None:
    try:
        pair = oneway.Pair(name)
    except oneway.PairMissing as reason:
        pytest.skip(str(reason))
    with pair:
        lots = [pair.send(10), pair.send(5)]
    assert [len(lot) for lot in lots] == [10, 5]
    assert all(0 < latency_ns < 10_000 * MS for lot in lots for latency_ns in lot)


def test_a_pair_that_fails_says_why() -> None:
    with pytest.raises(oneway.PairFailed, match="no such channel"):
        oneway.Pair("no such channel")


@pytest.mark.parametrize(("ours", "met"), [(110_000, True), (112_000, False)])
def test_the_floor_is_no_peer(ours: int, met: bool) -> None:
    rows = oneway.judged({OURS: [ours], FLOOR: [50_000], "ZeroMQ": [100_000], "Unix datagrams": [200_000]})
    judged = [row for row in rows if row.met is not None]
    assert [row.met for row in judged] == [met]
    assert judged[0].numbers["best_peer"] == "ZeroMQ"


def test_cores_are_kept_awake_by_processes_that_give_way() -> None:
    before = set(psutil.Process().children())
    with oneway.awake():
        spinners = set(psutil.Process().children()) - before
        assert len(spinners) == len(os.sched_getaffinity(0))
        wait_for("them to give way", lambda: {os.sched_getscheduler(each.pid) for each in spinners} == {os.SCHED_IDLE})
    assert not any(spinner.is_running() for spinner in spinners)


def test_rows_are_those_of_the_table() -> None:
    row = oneway.row_of("ZeroMQ", [1000, 2000, 3000], oneway.AWAKE)
    assert isinstance(row, stats.Row)
    assert row.numbers == {"p50_us": 2.0, "p99_us": 3.0, "max_us": 3.0, "samples": 3}


OTHER, FIFO = os.SCHED_OTHER, os.SCHED_FIFO
NAMED_SO = "import sys, time; open('/proc/self/comm', 'w').write('kworker/u9:1'); print(flush=True); sys.stdin.read()"


class Machine(Kernel):
    """Workers and their policies, which can be without the right to change them."""

    def __init__(self) -> None:
        self.policies = {10: OTHER, 11: FIFO, 12: OTHER}
        self.allowed = True

    def workers(self) -> Iterator[int]:
        return iter(list(self.policies))

    def policy(self, pid: int) -> int:
        return self.policies[pid]

    def schedule(self, pid: int, policy: int, priority: int) -> None:
        if not self.allowed:
            raise PermissionError
        if pid not in self.policies:
            raise ProcessLookupError
        assert bool(priority) == (policy == FIFO)
        self.policies[pid] = policy


def test_they_come_first_and_are_given_back() -> None:
    machine = Machine()
    with Carriers(machine) as first:
        assert first.priority == "ordinary"
        first.first()
        assert machine.policies == {10: FIFO, 11: FIFO, 12: FIFO}
        del machine.policies[12]
        machine.policies[13] = OTHER
        first.first()
        assert machine.policies == {10: FIFO, 11: FIFO, 13: FIFO}
    assert machine.policies == {10: OTHER, 11: FIFO, 13: OTHER}, "one that was first before stays so"
    assert first.priority == "real-time"


def test_without_the_right_nothing_is_changed() -> None:
    machine = Machine()
    machine.allowed = False
    with Carriers(machine) as first:
        first.first()
    assert first.priority == "ordinary"
    assert machine.policies == Machine().policies


def test_a_program_of_such_a_name_is_none() -> None:
    with subprocess.Popen([sys.executable, "-c", NAMED_SO], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdout
        program.stdout.readline()
        assert Path(f"/proc/{program.pid}/comm").read_text() == "kworker/u9:1\n"
        assert program.pid not in set(carriers.workers())
        assert program.stdin
        program.stdin.close()
