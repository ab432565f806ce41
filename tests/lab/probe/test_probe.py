"""The probe against simulated boards: its card says what the board did, and its death leaves no wheel turning."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import random
import shlex
import signal
import subprocess
import threading
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from failstop.api.errors import FailstopError
from failstop.board.kinds import board_of
from failstop.cli import style
from failstop.cli.missing import INCOMPLETE
from failstop.policy.halted import CONFIRMED
from failstop_lab.boards.live import DIAMETER_M
from failstop_lab.commands import probe as probe_command
from failstop_lab.probe import judge
from failstop_lab.probe.card import FORMATS, Card, Row
from failstop_lab.probe.guard_port import GuardProbe
from failstop_lab.probe.serial import ROWS, UNDATED, SerialProbe, check_kind, frame_of
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.support.amounts import LONG, amount
from tests.support.boards import own_folder
from tests.support.commands import FAILSTOP, failstop
from tests.support.pages import ROOT, blocks
from tests.support.typist import Typist

T13 = b'{"T":13,"X":0.1,"Z":0}\n'
ALONE = [name for name in ROWS if name != "plug"]
BASES = {
    "hoverboard": None,
    "ugv": None,
    "arduino": None,
    "feetech": None,
    "vesc": None,
    "damiao": None,
    "rrc": None,
    "ugv by T:13": T13,
}
"""Each kind of board, and what its driver sends where that is not the usual frame."""
ENDLESS = ("feetech", "rrc", "ugv by T:13")
"""These have no watchdog, or one that this frame neither feeds nor arms (docs/boards.md)."""
NEAR_S = 0.05
ON_THE_WAY_S = 0.02
"""A report is older than its arrival. Where a card is not as exact as that, it says so: the machine was busy."""
TELLS_S = 0.1
"""For a terminal to bring a key."""
MOVES_S, STOPS_S, ENDS_S = 40.0, 40.0, 60.0
KILLED_WITHIN_S = 20.0
"""From its start: it is killed at the latest then."""
WAYS = {signal.SIGKILL: amount(1, 100), signal.SIGSTOP: amount(0, 10)}
MOMENTS = [pytest.param(how, draw, id=f"{how.name}-{draw}") for how, draws in WAYS.items() for draw in range(draws)]


class Watched:
    """When the wheels of a simulated board came to rest, by its own word, while a block runs."""

    def __init__(self, board: SimBoard) -> None:
        self._board, self._over = board, threading.Event()
        self.rests: list[tuple[int, int]] = []
        """Of each rest, when they turned last, and when they were first seen to stand."""
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Watched:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        turned_ns = 0
        while not self._over.wait(0.003):
            before_ns = time.monotonic_ns()
            if any(self._board.wheels()):
                turned_ns = before_ns
            elif turned_ns:
                self.rests.append((turned_ns, time.monotonic_ns()))
                turned_ns = 0

    def after_s(self, cause_ns: int) -> tuple[float, float]:
        """From a cause to the first rest, at least and at most."""
        return next(((one - cause_ns) / 1e9, (two - cause_ns) / 1e9) for one, two in self.rests if two >= cause_ns)


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES if LONG else ["hoverboard"])
def test_the_card_says_what_the_board_did(base: str, tmp_path: Path) -> None:
    kind, sent = base.split()[0], BASES[base]
    with SimBoard(tmp_path / "b", board=kind) as board, Watched(board) as watched:
        language = board_of(kind, DIAMETER_M, 0.0)
        frame = sent or frame_of(language)
        with SerialProbe(board.link, kind, language, frame, by_key=False, say=pytest.fail) as probe:
            probe.character()
            rows = [probe.run_row(name) for name in (ALONE if LONG else ["silence"])]
        board.wait_wheels(False, STOPS_S)
    for row in rows:
        least_s, most_s = watched.after_s(row.cause_ns)
        found = f"{row.stands_s or math.inf:.3f} s, give or take {row.within_s:.3f}"
        print(f"{base}, {row.name}: {found}; really {least_s:.3f} to {most_s:.3f}")
        assert (row.stands_s is None) is (base in ENDLESS)
        if row.stands_s is None:
            assert least_s >= judge.NEVER_S
        else:
            near_s = max(NEAR_S, ON_THE_WAY_S + row.within_s)
            assert least_s - near_s <= row.stands_s <= most_s + near_s


@pytest.mark.slow
@pytest.mark.parametrize("failure", ["sigkill", "plug"])
def test_wheels_that_were_not_turning_were_not_stopped_by_the_failure(failure: str, tmp_path: Path) -> None:
    """Somebody has switched off the motors' power: the board reports wheels at rest, also while its driver drives."""
    with SimBoard(tmp_path / "b", board="hoverboard") as board:
        language = board_of("hoverboard", DIAMETER_M, 0.0)
        frame = frame_of(language)
        with SerialProbe(board.link, "hoverboard", language, frame, by_key=False, say=pytest.fail) as probe:
            probe.character()
            board.deaf(True)
            row = probe.run_row(failure)
    assert (row.stands_s, row.never, row.unjudged) == (None, False, judge.NOT_TURNING)


@pytest.mark.slow
def test_wheels_that_somebody_stopped_before_a_failure_were_not_stopped_by_the_guard_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    language = board_of("hoverboard", DIAMETER_M, 0.0)
    turns = GuardProbe._turns

    def turn_and_be_stopped(probe: GuardProbe) -> bool:
        if found := turns(probe):
            probe._robot.disable()
        return found

    monkeypatch.setattr(GuardProbe, "_turns", turn_and_be_stopped)
    with SimBoard(tmp_path / "b", board="hoverboard") as board:
        frame = frame_of(language)
        with GuardProbe(board.link, "hoverboard", 0, language, frame, None, pytest.fail) as column:
            row = column.run_row("sigkill")
    assert (row.stands_s, row.never, row.unjudged) == (None, False, judge.NOT_TURNING)


def test_a_rest_before_the_failure_is_one_that_has_lasted() -> None:
    """A slow wheel may say the same place twice."""
    turning = [(at * 10**8, (0.1,), (float(at),)) for at in range(5)]
    rest = [(at * 10**8, (0.0,), (4.0,)) for at in range(5, 9)]
    for count in range(5):
        samples = [*turning, *rest[:count]]
        assert judge.rested(samples, judge.rest_ns(samples)) is (count > 2), count
    assert not judge.rested([], None)


PAGE = ROOT / "docs/does-your-robot-stop.md"
COMMANDS = [line for block in blocks(PAGE) for line in block.text.splitlines() if "probe serial" in line]


@pytest.mark.slow
@pytest.mark.skipif(not LONG, reason="make campaigns runs the commands of the page")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_makes_a_card(command: str, tmp_path: Path) -> None:
    words = shlex.split(command)[1:]
    words[words.index("--port") + 1] = str(tmp_path / "b")
    with SimBoard(tmp_path / "b", board="ugv"):
        done = failstop(*words, "--rows", "silence,plug", "--yes", "--json", "--out", str(tmp_path / "card"))
    silence, plug = json.loads(done.stdout)["rows"]
    assert silence["never"] is ("--frame" in words)
    assert plug["skipped"] == "nobody to pull it"
    assert done.returncode == int(silence["never"])


@pytest.mark.slow
@pytest.mark.skipif(not LONG, reason="ten seconds of a processor")
def test_a_person_pulls_the_plug_and_says_when_the_wheels_stand(tmp_path: Path) -> None:
    port, out = str(tmp_path / "b"), str(tmp_path / "card")
    words = ["probe", "serial", "--board", "ugv", "--port", port, "--yes", "--rows", "plug", "--out", out]
    with SimBoard(port, board="ugv") as board, Typist.failstop(*words) as person:
        person.wait("PULL THE BOARD'S PLUG NOW", MOVES_S)
        board.unplug()
        pulled_ns = time.monotonic_ns()
        # By its own watchdog, which is no frame that could be waited for.
        wait_for("the wheels to stand", lambda: not any(board.wheels()), STOPS_S)
        really_s = (person.type(b"\n") - pulled_ns) / 1e9
        person.wait("Plug the board in again.", MOVES_S)
        board.replug()
        assert person.end(ENDS_S) == 0
    (row,) = json.loads(Path(f"{out}.json").read_text())["rows"]
    print(f"plug: {row['stands_s']}, really {really_s:.3f}")
    assert row["stands_s"] == pytest.approx(really_s, abs=NEAR_S + TELLS_S)


@dataclasses.dataclass
class Person:
    """Pulls the board's end of the cable, so that the port stays; presses Enter as soon as `stands` is true."""

    board: SimBoard
    stands: Callable[[], bool]
    pulls: bool = True
    says: list[str] = dataclasses.field(default_factory=list)
    """What the probe has said to this person."""
    pulled_ns: int = 0

    def hears(self, text: str) -> None:
        self.says.append(text)
        out = text.startswith("PULL")
        if self.pulls:
            self.board.deaf(out)
            self.board.silent(out)
        self.pulled_ns = self.pulled_ns or time.monotonic_ns()

    def plug_row(self, monkeypatch: pytest.MonkeyPatch) -> Row:
        """The row `plug` of this person's probe of a hoverboard."""
        monkeypatch.setattr(judge, "key_pressed", lambda: bool(self.says) and self.stands())
        language = board_of("hoverboard", DIAMETER_M, 0.0)
        frame = frame_of(language)
        with SerialProbe(self.board.link, "hoverboard", language, frame, by_key=False, say=self.hears) as probe:
            row = probe.run_row("plug")
        self.board.wait_wheels(False, STOPS_S)
        return row


@pytest.mark.slow
def test_a_plug_that_is_pulled_at_the_board_s_end_shows_by_the_end_of_the_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with serial pins: the port stays."""
    with SimBoard(tmp_path / "b", board="hoverboard") as board, Watched(board) as watched:
        person = Person(board, lambda: bool(watched.rests))
        row = person.plug_row(monkeypatch)
    _, rests_ns = watched.rests[0]
    assert row.stands_s == pytest.approx((rests_ns - person.pulled_ns) / 1e9, abs=NEAR_S + TELLS_S)
    assert person.says[1:] == ["Plug the board in again."]


@pytest.mark.slow
def test_a_plug_whose_moment_nothing_shows_is_not_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The port stays, and the board had reported nothing before either."""
    with SimBoard(tmp_path / "b", board="hoverboard") as board:
        board.silent(True)
        person = Person(board, lambda: not any(board.wheels()))
        row = person.plug_row(monkeypatch)
    assert (row.stands_s, row.skipped, row.unjudged) == (None, "", UNDATED)
    assert person.says[1:] == ["Plug the board in again, then press Enter."]


@pytest.mark.slow
def test_a_plug_that_stays_in_is_not_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The person presses Enter, and the reports go on."""
    with SimBoard(tmp_path / "b", board="hoverboard") as board:
        row = Person(board, lambda: True, pulls=False).plug_row(monkeypatch)
    assert row.skipped == "nobody pulled it"


def wait_for_its_end(port: Path) -> None:
    """Wait for every process of a probe that is dead: nobody of it is left then who could drive, or stop."""
    found = {each: each.info["cmdline"] or [] for each in psutil.process_iter(["cmdline"])}
    left = [each for each, words in found.items() if str(port) in words and "failstop_lab.sim" not in words]
    assert not psutil.wait_procs(left, ENDS_S)[1]


@pytest.mark.slow
@pytest.mark.parametrize(("how", "draw"), MOMENTS)
def test_a_probe_that_is_killed_leaves_no_wheel_turning(how: signal.Signals, draw: int, tmp_path: Path) -> None:
    """The board is one that keeps its last speed forever: nobody else stops it."""
    port = tmp_path / "b"
    words = ["probe", "serial", "--board", "rrc", "--port", str(port), "--yes", "--rows", "silence,sigkill"]
    with SimBoard(port) as board, open(tmp_path / "log", "w") as log:
        begun_s = time.monotonic()
        probe = subprocess.Popen(
            [*FAILSTOP, *words, "--out", str(tmp_path / "card")], stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        if draw:  # at any moment
            with contextlib.suppress(subprocess.TimeoutExpired):
                probe.wait(random.Random(draw).uniform(0.0, KILLED_WITHIN_S))
        else:
            board.wait_wheels(True, MOVES_S)
        turned = any(board.wheels())
        killed_ns = time.monotonic_ns()
        probe.send_signal(how)
        if how == signal.SIGKILL:
            probe.wait()
            wait_for_its_end(port)
        elif turned:
            board.wait_wheels(False, STOPS_S)
        stands = [event.executed_ns for event in board.events() if event.is_stop and event.executed_ns > killed_ns]
        after_s = (killed_ns - begun_s * 1e9) / 1e9
        print(f"{how.name} after {after_s:.2f} s, turning {turned}: {[(ns - killed_ns) / 1e9 for ns in stands[:1]]}")
        assert not any(board.wheels())
        probe.kill()
        probe.wait()
        wait_for_its_end(port)
        assert not any(board.wheels())


@pytest.mark.slow
def test_a_watcher_that_is_killed_is_missed(tmp_path: Path) -> None:
    language = board_of("rrc", DIAMETER_M, 0.0)
    with SimBoard(tmp_path / "b") as board:
        probe = SerialProbe(board.link, "rrc", language, frame_of(language), by_key=False, say=pytest.fail)

        def kill() -> None:
            board.wait_wheels(True, MOVES_S)
            os.kill(probe.watcher_pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        with pytest.raises(FailstopError, match="the probe's watcher process has ended"), probe:
            probe.run_row("silence")
        killer.join()
        assert not any(board.wheels())
        assert probe.outcome
        assert probe.outcome.sentence() == CONFIRMED


@pytest.mark.slow
def test_what_nobody_could_judge_is_not_measured(tmp_path: Path) -> None:
    """Neither the board says anything of its wheels, nor is there a terminal for a person's key."""
    words = ("probe", "serial", "--board", "ugv", "--port", str(tmp_path / "b"), "--yes", "--json")
    with SimBoard(tmp_path / "b", board="ugv") as board:
        board.silent(True)
        done = failstop(*words, "--rows", "silence,sigkill", "--out", str(tmp_path / "card"))
        board.wait_wheels(False, STOPS_S)
    card = json.loads(done.stdout)
    assert card["verdict"] == "Not measured: nobody judged whether the wheels stopped."
    assert [(row["stands_s"], row["never"], row["judged_by"]) for row in card["rows"]] == [(None, False, "")] * 2
    assert {row["not_measured"] for row in card["rows"]} == {judge.NO_JUDGE}
    assert done.returncode == 1
    assert "NOT stop" not in (tmp_path / "card.txt").read_text()


@pytest.mark.parametrize(("by", "unjudged"), [(judge.GYRO, judge.NO_JUDGE), (judge.PERSON, "")])
def test_the_guard_port_is_not_judged_by_what_could_not_judge_the_bare_board(by: str, unjudged: str) -> None:
    card = Card("a tank", "rrc", "1.0", "a node", [Row("sigkill", ROWS["sigkill"], unjudged=unjudged)])
    probe = SimpleNamespace(by=by, unjudged=unjudged)
    assert probe_command._guarded(None, None, b"", probe, card) == 1  # type: ignore[arg-type]
    assert "the guard port was not measured" in card.ended
    assert card.rows[0].guarded is None


def test_a_key_is_read_at_a_terminal_alone() -> None:
    done = failstop("probe", "serial", "--port", "/nowhere", "--board", "ugv", "--key", "--yes")
    assert done.returncode == 1
    assert "--key needs a terminal" in done.stderr


def test_reports_that_ended_say_nothing_of_the_end() -> None:
    turning = [(at * 10**9, (0.1,), (float(at),)) for at in range(5)]
    assert not judge.silent(turning, 5 * 10**9)
    assert judge.silent(turning, 11 * 10**9)
    assert judge.silent([], 0)


@pytest.mark.parametrize(
    ("said", "why"), [("yes\n", ""), ("Y\n", ""), ("no\n", judge.NO_WORD), ("", judge.NO_WORD), (None, judge.NO_WORD)]
)
def test_never_is_a_person_s_word_and_not_the_lack_of_a_key(
    said: str | None, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None: nobody is at a terminal."""
    master, slave = os.openpty()
    if said:
        os.write(master, said.encode())
    with open(slave if said is not None else os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert judge.turned_on(lambda _: None, lambda _, found: found()) == why
    os.close(master)


def test_the_judge_dates_a_rest_by_its_first_report() -> None:
    turning = [(at, (0.1, 0.1), (float(at), float(at))) for at in range(5)]
    rests = [(at, (0.0, 0.0), (4.0, 4.0)) for at in range(5, 9)]
    assert judge.rest_ns([*turning, *rests]) == 5
    assert judge.rest_ns(turning) is None
    assert judge.rest_ns([(at, (), (float(at // 3),)) for at in range(9)]) == 6
    assert judge.rest_ns([]) is None
    nowhere, confused = (math.nan, 0.0), [(0, (0.1,), (0.0, 0.0)), (1, (math.nan,), (math.nan, 0.0))]
    assert judge.rest_ns([*confused, *((at, (0.0,), nowhere) for at in range(2, 9))]) == 2
    late = [(at * 10**7, (0.1,), ()) for at in range(5)] + [(at * 10**7, (0.0,), ()) for at in range(10, 15)]
    assert judge.dated(late, 0, 10**8) == pytest.approx((0.07, 0.03))


@pytest.mark.parametrize("end", FORMATS)
def test_a_card_replaces_an_older_one_but_follows_no_link(tmp_path: Path, end: str) -> None:
    """Its usual name can be guessed, and root may probe in a folder where others can write."""
    victim = tmp_path / "victim"
    victim.write_text("theirs")
    card = Card("a robot", "ugv", "", "mine", [Row("sigkill", ROWS["sigkill"], 0.8, judge.PERSON)])
    base = str(tmp_path / "card")
    assert card.save(base) == card.save(base)
    kept = {path: path.read_text() for path in tmp_path.iterdir()}
    Path(base + end).unlink()
    Path(base + end).symlink_to(victim)
    with pytest.raises(OSError, match="a link, not a regular file"):
        card.save(base)
    assert victim.read_text() == "theirs"
    assert {path: path.read_text() for path in tmp_path.iterdir()} == {**kept, Path(base + end): "theirs"}


def test_a_card_is_a_text_of_80_columns_a_picture_and_json(tmp_path: Path) -> None:
    rows = [Row("sigkill", ROWS["sigkill"], None, judge.OWN_WORD), Row("silence", ROWS["silence"], 0.8, judge.PERSON)]
    card = Card("a <robot> & more " * 9, "ugv", "", "mine", [*rows, Row("plug", ROWS["plug"], skipped="nobody")])
    texts, data, picture = (Path(path) for path in card.save(str(tmp_path / "card")))
    assert tuple(path.suffix for path in (texts, data, picture)) == FORMATS
    assert {len(line) for line in texts.read_text().splitlines()} == {80}
    assert "NOT stop in 1 of 2" in card.verdict
    assert "never" in picture.read_text()
    ElementTree.fromstring(picture.read_text())
    assert [row["never"] for row in json.loads(data.read_text())["rows"]] == [True, False, False]
    unjudged = Row("close", ROWS["close"], unjudged=judge.NO_WORD)
    card = dataclasses.replace(card, rows=[*rows[1:], unjudged])
    assert card.verdict == "It stops: within 0.80 s of the one failure measured. 1 not measured."
    assert f"not measured  nobody{' ' * 12}" in card.text()
    assert judge.NO_WORD in card.text()
    assert judge.NO_WORD in card.svg()


def test_a_card_that_ended_early_says_why_in_each_form(tmp_path: Path) -> None:
    why = "the probe's watcher process has ended, so the probe ended too: " + "repeat it " * 10
    card = Card(
        "\u673a\u5668\u4eba", "ugv", "", "mine", [Row("sigkill", ROWS["sigkill"], 0.2, judge.OWN_WORD)], ended=why
    )
    lines = card.text().splitlines()
    assert {style.cells(line) for line in lines} == {80}
    assert why.strip() in " ".join("".join(line.strip("|") for line in lines).split())
    assert "Ended early: the probe's watcher process has ended" in card.svg()
    assert "Ended early" not in dataclasses.replace(card, ended="").svg()


@pytest.mark.parametrize("word", ["\x1b[2J", "a\nb", "\x00", "\u202e", "\ufffe", "\udcff"])
def test_no_word_of_a_card_controls_a_terminal_or_spoils_the_picture(word: str, tmp_path: Path) -> None:
    row = Row("sigkill", ROWS["sigkill"], 0.2, by=f"by {word}", skipped="")
    other = Row("close", ROWS["close"], unjudged=f"because {word}")
    card = Card(word, f"behind {word}", word, word, [row, other], ended=f"it said {word}")
    texts, data, picture = (Path(path).read_text("utf-8") for path in card.save(str(tmp_path / "card")))
    for text in (texts, data, picture):
        assert text.replace("\n", "").isprintable()
    assert {style.cells(line) for line in texts.splitlines()} == {80}
    drawn = "".join(ElementTree.fromstring(picture).itertext())
    assert drawn.count(word.encode("unicode_escape").decode()) == 7


@pytest.mark.slow
def test_a_board_of_another_kind_is_told_before_a_wheel_turns(tmp_path: Path) -> None:
    words = ("probe", "serial", "--port", str(tmp_path / "b"), "--yes", "--out", str(tmp_path / "card"))
    with SimBoard(tmp_path / "b", board="ugv") as board:
        done = failstop(*words, "--board", "rrc")
        assert done.returncode == 1
        assert "the board that answers is ugv, not rrc: give --board ugv" in " ".join(done.stderr.split())
        assert not list(tmp_path.glob("card*"))
        assert not any(any(event.speeds) for event in board.events() if event.is_motor)
        assert check_kind(board.link, "ugv") == ""
        board.deaf(True)
        assert "it may hear nothing" in check_kind(board.link, "ugv")


def test_wrong_options_are_told() -> None:
    done = failstop("probe", "serial", "--port", "/nowhere", "--board", "ugv")
    assert done.returncode == 1
    assert "no port /nowhere: plug the board in" in done.stderr
    for pid in ("-1", "0", str(2**22 + 1)):
        done = failstop("probe", "ros2", "--yes", "--driver-pid", pid)
        assert done.returncode == 1
        assert f"no process has the pid {pid}; " in done.stderr
    assert "no row 'nap'" in failstop("probe", "serial", "--port", "/nowhere", "--board", "ugv", "--rows", "nap").stderr


def test_without_ros_a_probe_of_ros_says_so_and_makes_no_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rclpy.py").write_text("raise ImportError('none here')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    done = failstop("probe", "ros2", "--yes", "--out", str(tmp_path / "card"))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (INCOMPLETE, "", 1), done.stderr
    assert not list(tmp_path.glob("card*"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["arduino", "rrc"])
def test_the_same_driver_fails_at_the_bare_board_and_at_the_guard_port(kind: str, tmp_path: Path) -> None:
    """Two columns of one card; by the board's own word the wheels stand at the end, and no service is left."""
    words = ("probe", "serial", "--board", kind, "--port", str(tmp_path / "b"), "--yes", "--json", "--guard")
    with SimBoard(tmp_path / "b", board=kind) as board:
        done = failstop(*words, "--rows", "silence,plug", "--out", str(tmp_path / "card"))
        assert not any(board.wheels())
    card = json.loads(done.stdout)
    assert card["ended"] == "", done.stderr
    silence, plug = card["rows"]
    assert silence["never"] is (kind == "rrc")
    assert not silence["guard_port"]["never"]
    assert silence["guard_port"]["stands_s"] < (silence["stands_s"] or math.inf)
    assert plug["guard_port"]["skipped"]
    assert done.returncode == 0, "through the guard port it stops"
    assert "guard port" in Path(tmp_path / "card.txt").read_text()
    left = [each.info["cmdline"] for each in psutil.process_iter(["cmdline"]) if str(tmp_path) in str(each.info)]
    assert left == []


def test_a_card_with_two_columns_fits_a_terminal_and_says_both() -> None:
    guarded = Row("sigkill", ROWS["sigkill"], 0.03, judge.OWN_WORD)
    bare = Row("sigkill", ROWS["sigkill"], None, judge.OWN_WORD, guarded=guarded)
    card = Card("a tank", "ugv", "1.0", "a node", [bare])
    text = card.text()
    assert {len(line) for line in text.splitlines()} == {80}
    assert " never       0.03 s " in text
    assert "Through the guard port it stops: within 0.03 s of each of 1." in text
    assert ElementTree.fromstring(card.svg()).tag.endswith("svg")
    assert ">0.03 s<" in card.svg()
    late = dataclasses.replace(bare, guarded=dataclasses.replace(guarded, stands_s=None))
    card.rows[:] = [late]
    assert "Through the guard port it does NOT stop in 1 of 1 failures." in card.text()
    unseen = dataclasses.replace(bare, guarded=dataclasses.replace(guarded, stands_s=None, unjudged="silent"))
    left_out = dataclasses.replace(bare, guarded=dataclasses.replace(guarded, stands_s=None, skipped="held"))
    card.rows[:] = [bare, unseen, left_out]
    said = " ".join(card.text().split()).replace("| ", "").replace(" |", "")
    assert "within 0.03 s of each of 1. 1 not measured." in said


def test_the_guard_port_is_not_offered_where_nobody_could_judge_or_speak_it(tmp_path: Path) -> None:
    (tmp_path / "b").touch()
    words = ("probe", "serial", "--port", str(tmp_path / "b"), "--yes", "--guard")
    kind = own_folder(tmp_path / "tank")
    wire = tmp_path / "tank" / "wire.py"
    wire.write_text(wire.read_text().replace("    driver=_driver,\n", ""))
    done = failstop(*words, "--board", kind)
    assert done.returncode == 1
    assert f"--guard: {kind} does not say what a driver may write to it" in done.stderr
