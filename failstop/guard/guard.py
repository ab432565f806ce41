"""Guard: the loop of the guard's process. In each turn it finds out which programs have the port open, reads what they
wrote, and writes the board's answers to them."""

from __future__ import annotations

from collections import deque
from time import monotonic_ns

from failstop.api import words
from failstop.api.errors import FailstopError
from failstop.api.snapshot import Block
from failstop.board.driver import language_of
from failstop.guard.news import HungUp
from failstop.guard.said import DRIVES, GUARD, REFUSED, WAITS, WITHHELD
from failstop.guard.talk import Talk
from failstop.messages import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Protocol

    from failstop.board.driver import DriverFrame
    from failstop.guard.door import Door
    from failstop.guard.news import Opener
    from failstop.guard.pty import Pty
    from failstop.guard.scale import Scale
    from failstop.guard.talk import Command
    from failstop.policy.settings import Settings

    class Board(Protocol):
        """The receiver of a driver's commands: the service (service.py), or a stand-in during a dry run (dry.py)."""

        settings: Settings | None
        scale: Scale
        source: str
        runs: int
        note: str

        def look(self, now_ns: int) -> bool: ...
        def join(self, who: str, pid: int | None) -> None: ...
        def rename(self, who: str, pid: int | None) -> None: ...
        def leave(self, *, in_order: bool) -> None: ...
        def command(self, command: Command) -> tuple[str, str]: ...
        def forward(self, frame: DriverFrame) -> None: ...
        def say(self, sees: str, wrong: str) -> None: ...
        def block(self) -> Block | None: ...
        def heard(self) -> list[tuple[int, bytes]]: ...


LISTEN_NS = 5_000_000
"""How often the board's bytes are read while a driver has the port open."""
IDLE_NS = 100_000_000
"""The longest sleep while no program has the port open. A driver may have written its first bytes at any time during
such a sleep, so the guard assumes that they are as old as the whole sleep."""
LOOK_NS = 500_000_000
"""How often the guard checks whether the service still runs and whether the link to the guard port still exists."""
SAY_NS = 2_000_000_000
"""How often the report about the driver is repeated. Without the repeats, the report would look out of date."""
PAST_NS = 4_000_000_000
"""How long bytes from the board are kept. When a driver opens the port, the guard first gives the newest of these bytes
to the driver's DriverLanguage."""
A_DRIVER = "a driver"


class Guard:
    """The guard port, and the conversation with the program that has it open."""

    def __init__(self, board: Board, pty: Pty, door: Door, tell: Callable[[str], None]) -> None:
        """`tell`: prints a line for people. Raises OSError."""
        self._board, self._pty, self._door, self._tell = board, pty, door, tell
        self._talk: Talk | None = None
        self._past: deque[tuple[int, bytes]] = deque()
        """The bytes that the board has sent lately, each with its time."""
        self._who = A_DRIVER
        """The driver's name, for people. If several programs have the port open, all of their names."""
        self._known: dict[int, Opener] = {}
        """The programs that have had the port open during this conversation, by pid."""
        self._unknown = False
        """True if a program that /proc does not show has had the port open during this conversation."""
        self._crowded = False
        """True if the port was open too many times at the last count. If one of the programs ends, this stays True
        until its end is handled."""
        self._unlinked = False
        """True after the guard has reported that it can't make its lost link again."""
        self._flooded = False
        self._early = b""
        """Bytes that were written before the guard could see which program wrote them."""
        self._next: Talk | None = None
        """The conversation with the programs that still have the port open after one has closed it."""
        self._unclean = False
        """True if the terminal still has the settings of a driver that has gone, because another program may have set
        them meanwhile."""
        self._empty_ns = monotonic_ns()
        """The last time at which no bytes from the driver were waiting to be read."""
        self._opened_ns = 0
        """When the driver was first seen."""
        self._hasty = ""
        """A text which says that the previous driver closed the port right after it wrote a motion. Empty if it did
        not."""
        self._exceeded: set[str] = set()
        """The limits that the driver has exceeded. Each of them is reported only once for each driver."""
        self._said = ("", "")
        self._said_ns = self._looked_ns = 0
        self._runs, self._note = board.runs, board.note
        self._begin()

    def turn(self) -> None:
        """Sleep until there is something to do, and do it. Raises FailstopError or OSError."""
        try:
            self._turn()
        except HungUp:
            self._begin_again()

    def _turn(self) -> None:
        ready = self._door.wait(self._wait_s(monotonic_ns()))
        now_ns = monotonic_ns()
        # Look for programs that have gone before reading what was written, because a dead driver's bytes move nothing.
        news = self._door.look(ready)
        if not self._door.count:
            self._empty_ns = now_ns
        if news.ended:
            self._end(emptied=news.emptied)
        if news.any:
            self._recount(news.orphans)
        left_bytes = self._pty.master in ready and not news.any
        if not self._door.count and (left_bytes or self._unclean):
            # The guard sees a program before the program can write. So these bytes are from one that has gone already.
            # They would keep this loop from sleeping, and the next driver would be taken for their writer.
            self._clean(shared=False)
        if now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._look(now_ns)
        self._listen()
        self._read(now_ns)
        self._report()
        # The program that wrote may have gone while the guard found out which programs have the port open.
        if not news.any:
            self._drive(now_ns)
            self._forward(now_ns)
        self._say(now_ns)

    def _wait_s(self, now_ns: int) -> float:
        due_ns = now_ns + (LISTEN_NS if self._door.count else IDLE_NS)
        # While the port is open too many times, nothing is sent, so nothing is due either.
        motion_ns = self._talk.due_ns() if self._talk and not self._door.crowded else None
        return max(0, min(due_ns, due_ns if motion_ns is None else motion_ns) - now_ns) / 1e9

    def _look(self, now_ns: int) -> None:
        """Notice a restarted service, a lost link, a hang-up, and a program that closed the port while its child has it
        open. Raises HungUp."""
        self._board.look(now_ns)
        if self._board.runs != self._runs:
            self._runs = self._board.runs
            before = self._talk
            self._begin()
            if before and self._talk:
                self._talk.resume(before)
        if self._board.note != self._note:
            self._note = self._board.note
            self._tell(self._note or "the service is running")
        self._check_link()
        self._pty.check()
        if left := self._door.abandoned():
            self._end(emptied=False)
            self._recount(left)

    def _check_link(self) -> None:
        """Make the link again if it was lost. If that fails while a program has the port open, only report it, because
        this program needs the link no more. Raises FailstopError if no program has the port open: systemd then starts
        the guard again, and makes the folder of the link."""
        if self._pty.linked():
            self._unlinked = False
            return
        try:
            self._pty.link_again()
        except FailstopError as error:
            if not self._door.count:
                raise
            if not self._unlinked:
                self._tell(f"{error}; the driver that has the port open keeps it")
            self._unlinked = True

    def _begin_again(self) -> None:
        """Open a new pseudo-terminal and begin again, because somebody has hung up the old one."""
        self._board.leave(in_order=not self._may_drive())
        openers = self._openers()
        has, it = ("has", "it") if len(openers) == 1 else ("have", "them")
        lost = f", so {' and '.join(openers)} {has} lost it: start {it} again" if self._talk and openers else ""
        self._crowded = False
        self._hang_up()
        self._tell(f"root hung up the port (vhangup){lost}; another terminal has taken its place")
        self._begin()

    # Which programs have the port open.

    def _recount(self, orphans: Sequence[Opener]) -> None:
        # A driver may ask something at once, and must get its answer while the guard finds out which program it is.
        new = self._talk is None
        if new:
            self._opened_ns = monotonic_ns()
        self._talk = self._talk or self._conversation()
        self._answer_early()
        self._flooded = False
        before = self._door.count
        self._door.recount(self._read_meanwhile)
        if before and not self._door.count:
            # The program has gone in the meantime. What it wrote must not be taken for bytes of the next one.
            self._end(emptied=True)
        if orphans and self._door.count:
            self._hang_up()
            self._tell(
                f"{orphans[0]} has let go of the port, but a child of it still had it open, so the guard hung up: open "
                "the port with O_CLOEXEC, in the process that drives"
            )
            new = True
        if new or not self._door.count:
            self._begin(self._talk)
            self._answer_early()  # a program may have been found only now
        elif self._add_openers():
            self._who = " or ".join(self._openers())
            self._board.rename(*self._shown())
        crowded, self._crowded = self._crowded, self._door.crowded
        if self._crowded and not crowded:
            self._tell(self._crowd())

    def _crowd(self) -> str:
        """Return a text which says that the port is open too many times, and what to do about it."""
        count, seen = self._door.count, list(self._door.seen.values())
        allows = f"guard.openers allows {self._door.most}"
        if len(seen) == 1 and seen[0].times == count:
            return (
                f"{seen[0]} has opened the port {count} times, and {allows}: nothing that it writes moves the robot. "
                f"Open it once, or set guard.openers = {count}"
            )
        names = " and ".join(map(str, seen)) or f"{count} programs"
        return f"{names} have the port open, and {allows}: nothing that they write moves the robot until one closes it"

    def _answer_early(self) -> None:
        """Answer the newest question in bytes that were written before the guard saw their writer. The earlier ones may
        be from a program that has gone. Motions in these bytes are not carried out. If one of them is not zero, none of
        the bytes counts."""
        if not self._door.count:
            return  # the program that wrote them may be found later
        early, self._early = self._early, b""
        if early and self._talk and (talk := self._continued(self._talk)):
            answers = talk.asked(early, monotonic_ns())
            if answers is None:
                return
            self._talk = talk
            for answer in answers[-1:]:
                self._pty.write(answer)

    def _conversation(self) -> Talk | None:
        """Create a new conversation. Returns None if no program has the port open, or if no service was found yet."""
        talk, self._next = self._next or self._new_talk(), None
        return talk if self._door.count else None

    def _continued(self, before: Talk) -> Talk | None:
        """Create a new conversation with the programs that have set up the board in the conversation `before`. Returns
        None if no service was found yet."""
        if talk := self._new_talk():
            talk.adopt(before)
        return talk

    def _new_talk(self) -> Talk | None:
        """Create a new conversation, even if no program has the port open. Returns None if no service was found yet.
        Raises FailstopError if the service's settings are not valid for a guard."""
        settings = self._board.settings
        try:
            language = language_of(settings.text("board.kind"), settings.flat()) if settings else None
        except ValueError as error:  # the service was started again with other settings
            raise FailstopError(str(error)) from None
        if settings is None or language is None:
            return None
        self._door.most = int(settings["guard.openers"]) or language.openers
        _, source_ns = settings.sources()[self._board.source]
        # A driver gets nothing that the board has sent before the driver opened the port.
        self._remember(self._board.heard())
        for t_ns, chunk in self._past:
            if monotonic_ns() - t_ns < language.past_ns:
                language.heard(chunk, t_ns)
        return Talk(language, self._board.scale.wheels, settings.ns("guard.timeout_s"), source_ns)

    def _begin(self, talk: Talk | None = None) -> None:
        """Begin a conversation with the program that has the port open, or continue the conversation `talk`. If no
        program has the port open, tell the service so."""
        self._talk = (talk if self._door.count else None) or self._conversation()
        self._exceeded.clear()
        if not self._door.count:
            self._who = A_DRIVER
            self._board.join(GUARD, None)
        else:
            self._known, self._unknown = {}, False
            self._add_openers()
            openers = self._openers()
            self._who = " or ".join(openers)
            self._tell(f"{' and '.join(openers)} {'has' if len(openers) == 1 else 'have'} the port open")
            self._board.join(*self._shown())
        self._said_ns = 0

    def _add_openers(self) -> bool:
        """Remember the programs that have the port open now. Returns True if there are more of them than before."""
        before = len(self._known), self._unknown
        self._known |= self._door.seen
        self._unknown |= self._door.count > sum(opener.times for opener in self._door.seen.values())
        return (len(self._known), self._unknown) != before

    def _openers(self) -> list[str]:
        """The programs of this conversation, for people."""
        return [*map(str, self._known.values()), *[A_DRIVER] * self._unknown]

    def _shown(self) -> tuple[str, int | None]:
        """The name and the pid under which the service shows the driver. If several programs have the port open, the
        name has all of them, because nobody can say which of them drives, and a program that lives must not be named as
        the one that has died."""
        known = list(self._known.values())
        if len(known) == 1 and not self._unknown:
            return known[0].name, known[0].pid
        names = list(dict.fromkeys([*(opener.name for opener in known), *[A_DRIVER] * self._unknown]))
        room = records.WHO_BYTES // len(names) - len(" or ")
        return " or ".join(records.cut(name, room).decode() for name in names), None

    def _end(self, *, emptied: bool) -> None:
        """End the conversation after a program has closed the port or died. The conversation ends even if other
        programs have the port open, because nothing shows which program wrote the bytes. What they have set up on the
        board stays. `emptied`: True if there was a moment in which no program had the port open."""
        shared = not emptied and self._door.count > 0
        unread, now_ns = self._clean(shared=shared), monotonic_ns()
        talk, self._talk = self._talk, None
        # The unread bytes are still to be read in the next conversation, so it begins before ended() reads them.
        self._next = self._continued(talk) if talk and shared else None
        self._hasty = ""
        if talk:
            # If several programs had the port open, nobody can say which of them drove, and the one that has gone is no
            # longer counted.
            held = talk.ended(unread, now_ns)
            drove = held or self._crowded
            self._board.leave(in_order=not drove)
            self._tell(self._ending(held=held))
            if late := talk.late(now_ns):
                late_ms, waits_ms = (ns // 1_000_000 for ns in late)
                self._tell(
                    f"before that an answer came up to {late_ms} ms late, and this driver waits {waits_ms} ms: the "
                    "computer is busy"
                )
            if held and now_ns - self._opened_ns < talk.timeout_ns:
                self._tell_hasty(talk)
        elif unread and not self._door.count and (talk := self._new_talk()) and talk.ended(unread, now_ns):
            self._tell_hasty(talk)

    def _clean(self, *, shared: bool) -> bytes:
        """Make the terminal ready for the next driver, as far as the programs that have it open allow. `shared`: True
        if one of them has had it open all the time. Returns the bytes that were not read yet.

        A program may close the port and open it again at once, as Feetech's SDK does at its start. Its first question
        may then be among these bytes."""
        opened = self._unclean = not self._door.vacant
        unread = self._pty.clean(shared=shared, opened=opened)
        self._early = unread if opened else b""
        self._door.limit()
        return unread

    def _hang_up(self) -> None:
        """Take the port away from all programs, and end the conversation with them. Raises FailstopError or OSError."""
        self._door.hang_up()
        self._talk, self._early, self._unclean = None, b"", False

    def _may_drive(self) -> bool:
        """True if the driver's own newest motion is not zero. Also True if too many programs have the port open,
        because nobody can say which program wrote the motion."""
        return self._talk is not None and (self._talk.holds or self._crowded)

    def _ending(self, *, held: bool) -> str:
        """Return a text about a program's end. `held`: True if the program's own last motion was not zero. The text
        does not say that the wheels turned, because the service may have ignored the motion."""
        seen = list(map(str, self._door.seen.values()))
        who = f"one of {' and '.join(seen)}" if len(seen) > 1 else self._who
        if held:
            return f"{who} has ended or died, and the last speed that it wrote was not zero"
        return f"{who} has ended{' or died while too many programs had the port open' if self._crowded else ''}"

    def _tell_hasty(self, talk: Talk) -> None:
        """Report that the driver closed the port right after it wrote a motion. Scripts that open the port for each
        command do this."""
        self._hasty = (
            f"{self._who} closed the port right after it wrote a motion, and a motion ends when the port is closed: "
            f"keep it open, and write the motion again within {talk.timeout_ns / 1e9:g} s"
        )
        self._tell(self._hasty)

    # What the programs write, and what they get.

    def _remember(self, heard: list[tuple[int, bytes]]) -> None:
        self._past += heard
        while self._past and self._past[-1][0] - self._past[0][0] > PAST_NS:
            self._past.popleft()

    def _listen(self) -> None:
        heard = self._board.heard()
        self._remember(heard)
        for t_ns, chunk in heard:
            for data in self._talk.heard(chunk, t_ns) if self._talk else ():
                self._pty.write(data)

    def _read_meanwhile(self) -> None:
        """Read and answer the driver's bytes during a long task. If bytes are left unread, later calls read nothing, so
        that a driver that writes without end can't hold up the guard."""
        if not self._flooded:
            self._flooded = not self._read(monotonic_ns())

    def _read(self, now_ns: int) -> bool:
        """Read what the driver has written, and answer it. Returns True if no more bytes are waiting."""
        if not self._door.count:
            return True  # the bytes are from a program that has just opened the port; the next turn handles them
        since_ns = self._empty_ns
        chunk, empty = self._pty.read()
        if empty:
            self._empty_ns = now_ns
        if not chunk or self._talk is None:
            return empty
        for answer in self._talk.wrote(chunk, now_ns, since_ns):
            self._pty.write(answer)
        if not empty and now_ns - since_ns > LOOK_NS:
            self._talk.refuse("more than the guard can read in time", "what it writes may be old, so it moves nothing")
        return empty

    def _report(self) -> None:
        """Print each command of the driver that was refused, and why."""
        if self._talk:
            for refusal in self._talk.refusals:
                self._tell(f"{self._who}: refused {refusal.what}: {refusal.why}")
            self._talk.refusals.clear()

    def _drive(self, now_ns: int) -> None:
        if self._talk is None or self._door.crowded or (command := self._talk.command(now_ns)) is None:
            return
        limit, beyond = self._board.command(command)
        if limit and limit not in self._exceeded:
            self._exceeded.add(limit)
            self._tell(f"{self._who} asks for {beyond}")
        settings = self._board.settings
        if self._talk.drives and settings and settings.on("guard.hang_up"):
            block = self._board.block()
            if block in (Block.LATCHED, Block.DISABLED):
                why = "a stop is latched" if block is Block.LATCHED else "motion is disabled"
                self._board.leave(in_order=True)
                self._hang_up()
                self._tell(f"{self._who} wants to move while {why}, so its port was closed (guard.hang_up)")
                self._begin()

    def _forward(self, now_ns: int) -> None:
        """Pass on the driver's next frame that is not motion, for example a question to the board."""
        if self._talk and not self._door.crowded and (frame := self._talk.frame(now_ns)):
            self._board.forward(frame)

    # The reports for people.

    def _say(self, now_ns: int) -> None:
        said = self._words(now_ns)
        if said != self._said or now_ns - self._said_ns >= SAY_NS:
            self._said, self._said_ns = said, now_ns
            self._board.say(*said)

    def _words(self, now_ns: int) -> tuple[str, str]:
        """The report for people, as (what the guard sees, what is wrong)."""
        if self._talk is None:
            return WAITS + self._pty.path, self._hasty
        wrong = ""
        if self._door.crowded:
            wrong = f"the port was opened {self._door.count} times, so no program drives (guard.openers)"
        elif silent_ns := self._talk.silent_ns(now_ns):
            counts_s = self._talk.timeout_ns / 1e9
            for_s = words.span(silent_ns / 1e9 + counts_s)
            wrong = f"it has written no speed for {for_s}, and a speed counts for {counts_s:g} s (guard.timeout_s)"
        elif self._talk.refused:
            wrong = REFUSED + self._talk.refused
        elif self._talk.withheld:
            wrong = WITHHELD
        return DRIVES + self._pty.path, wrong

    def close(self) -> None:
        """End the guard. A driver that is driving loses its port, and the service treats that like a driver's death."""
        self._board.leave(in_order=not self._may_drive())
        self._door.close()
