"""StopTracker: logs each stop, and collects the proof of one stop at a time from the board's answers and the verdict
about the wheels. It also watches the link to the board.

This file reads the facts from shared memory. The files stops.py and proof.py decide what they prove.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from time import monotonic_ns, time

from failstop.board.interface import Board
from failstop.messages import layout, records
from failstop.messages.packing import pack
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.proofs import (
    ACKNOWLEDGED_BY,
    LINK_ALIVE,
    LINK_DEAF,
    LINK_SILENT,
    LINK_UNASKED,
    LINK_UNHEARD,
    LINK_UNPROVEN,
    NOT_CONNECTED,
    NOT_SENT,
    UNMOVED,
    observer,
)
from failstop.procs.loop import MS
from failstop.procs.wheel_servos import WheelServos
from failstop.shm.words import Barrier
from failstop.supervisor import starter
from failstop.supervisor.latch import Latch
from failstop.supervisor.proof import WHEELS_UNSTILL, Link, Proof
from failstop.supervisor.run import Run
from failstop.supervisor.stops import BY_SUPERVISOR, Stop

SENTENCES_KEPT = 64
STOPS_FOR = {LINK_DEAF: causes.DEAF, LINK_SILENT: causes.BOARD_SILENT}
UNCONNECTED = {
    LINK_DEAF: "the board no longer hears: use the POWER SWITCH, then check its cable",
    LINK_SILENT: "the board has stopped reporting. It lost power, or it hangs, or the wire from it is broken; failstop "
    "can't tell which: use the POWER SWITCH, then check its cable",
}
"""For each bad state of the link, a text for people: what has happened, and what to do."""


class StopTracker:
    """Logs stops, tracks a stop until its proof is complete, and watches the link to the board. Call poll() once per
    turn. `heard` is (sent_ns, answered_ns) of the newest bytes that the board has acknowledged."""

    def __init__(
        self, run: Run, latch: Latch, board: Board, holds: Callable[[], bool], moves: Callable[[], bool]
    ) -> None:
        """`holds`: returns True while bytes for the board are still in the kernel. `moves`: returns True while motion
        is enabled, and also while the newest frame on the port is motion."""
        self._run = run
        self._holds, self._moves = holds, moves
        port_owner, telemetry = run.views[layout.PORT_OWNER], run.views[layout.TELEMETRY]
        self._record = run.own.latest_writer("stop")
        self._link_record = run.own.latest_writer("link")
        self._asked = port_owner.word("asked_ns")
        self._answered, self._proved = telemetry.latest_reader("answered"), telemetry.latest_reader("proved")
        self._by = board.acknowledged_by, observer(board.observed_by, imu=run.settings.on("board.imu"))
        self._still = telemetry.word("still_ns")
        self._judged = telemetry.word("judged_ns")
        self._barrier = Barrier()
        self._latch = latch
        self._after_ns = run.settings.ns("still.after_s")
        self._command = run.settings.text("still.command")
        self._command_pids: list[int] = []
        """The pids of the user's commands (still.command) that are still running, oldest first."""
        self._command_ran = False
        self.wheel_servos = WheelServos(run.settings, telemetry.latest_reader("health"))
        self._seen_answer = self._seen_proof = 0
        self.heard = (0, 0)
        self._unheeded, self._said_word = telemetry.word("unheeded_ns"), telemetry.word("said_ns")
        self._patience = telemetry.word("patience_ns")
        self.link = Link(run.settings.ns("link.deaf_s"), asked=bool(board.pings), echo_ns=board.echo_ns)
        self._published = ""
        self._stopped_for = ""
        """The name of the cause of the newest stop for a bad link. Empty if there was no such stop, and again after
        motion has ended or the link has become good."""
        self._verdict = (0, 0)
        """The newest verdict about the wheels, as (still_ns, judged_ns) of Proof.judged(). Zeros before the first."""
        self._last: Proof | None = None
        self._said: set[Cause] = set()
        """The causes that have been logged since the latched stop was latched."""

    def latched(self, stop: Stop) -> None:
        """Record that a stop was latched. Other causes that were logged before the stop may then be logged again."""
        self._said = {stop.cause}

    def _news_of(self, cause: Cause) -> bool:
        """True if this cause has not been logged since the stop was latched. Several processes may notice the same
        cause. Only SENTENCES_KEPT causes are remembered, so a cause may be logged twice."""
        if cause in self._said:
            return False
        if len(self._said) >= SENTENCES_KEPT:
            self._said.clear()
        self._said.add(cause)
        return True

    def also(self, stop: Stop) -> None:
        """Log a stop that came together with another stop, or while another stop was not answered yet. One burst serves
        both stops."""
        if self._news_of(stop.cause):
            fields = {**stop.fields(), "noticed_by": stop.noticed_by}
            self._run.events.log("stop_also", f"also: {stop.cause.alarm()}", fields)

    def answered(self, stop: Stop, *, ending: bool) -> None:
        """Log a stop. Call this as soon as it is known which process wrote the stop, or that it could not be written.
        `ending`: True if the stop was written because the service ends."""
        self._track(stop)
        # The kernel holds every burst for a moment. But a burst that queues behind bytes which the board has not taken
        # for a long time never gets out.
        held = causes.STUCK in (stop.cause.kind, (stop.behind or stop).cause.kind) and self._holds()
        written_us = max(0, stop.written_ns - stop.t_ns) / 1000
        how = f"by the {stop.by} after {written_us:.0f} us"
        if not stop.written_ns:
            wrote, level = "stop frame NOT written", "critical"
        elif held:
            wrote, level = f"stop frame handed over {how}, {NOT_SENT}", "critical"
        else:
            wrote, level = f"stop frame written {how}", ""
        fields = {
            **stop.fields(),
            "noticed_by": stop.noticed_by,
            "written_by": stop.by if stop.written_ns else "nobody",
            "latency_us": round(written_us, 1) if stop.written_ns else None,
            "epoch": stop.epoch,
        }
        if ending:
            self._run.events.log("stopping", f"{stop.cause}; {wrote}", fields, level=level)
        elif stop.behind is None:
            todo = f"{self._run.events.command('reset')}, then {self._run.events.command('enable')}"
            text = f"STOP latched: {stop.cause.alarm()}; {wrote}"
            self._run.events.log("stop", text, fields, level=level, step=todo)
        elif self._news_of(stop.cause):
            text = f"stopped again: {stop.cause.alarm()}; {wrote}; the latched cause is still: {stop.behind.cause}"
            if stop.behind.cause == stop.cause:
                text = f"more is known about the latched cause: {stop.cause}"
                if self._last:
                    self._publish(self._last)
            self._run.events.log("stop_again", text, {**fields, "latched": str(stop.behind.cause)}, level=level)

    def _track(self, stop: Stop) -> None:
        """Begin to track the proof of this stop. If there was no reset since the tracked stop, the tracked stop stays,
        because people still look at it. If it could not be written, this stop's burst may be the first that was."""
        last = self._last
        if last and self._latch.reset_epoch < last.stop.epoch:
            if last.stop.written_ns:
                return
            if stop.behind is last.stop:
                if stop.written_ns > last.stop.t_ns:  # an older burst does not answer the tracked stop
                    self._written_at_last(last, stop.written_ns, stop.by)
                return
        if last and not last.logged:
            self._log_outcome(last)  # with everything known so far
        self._look()
        self._last = Proof(stop, self._after_ns, monotonic_ns(), time(), self._by, self._verdict)
        self._last.believed = self.link.believed
        self._publish(self._last)

    def poll(self, now_ns: int, *, listening: bool, held_up: bool = False) -> list[Stop]:
        """Look for new proof of the tracked stop, and check the link. Returns the stops that must be written because of
        the result. `listening`: False if a missing answer must not count against the board, for example because
        telemetry does not run. `held_up`: True if the machine holds up the port owner, telemetry or the supervisor."""
        self._read_answer()
        if self._last and self.link.believed and not self._last.believed:
            self._last.believed = True
            self._publish(self._last)
        if held_up:
            self.link.held_up(now_ns)
        self._check_link(now_ns, listening=listening)
        stops = self._stops_for_link(now_ns)
        self._reap_command()
        seen = self._look()
        if self._last and self._unstill(self._last, seen, now_ns):
            stops.append(Stop(now_ns, layout.SUPERVISOR, causes.UNSTILL()))
        if self._last and self._last.complete(now_ns):
            self._log_outcome(self._last)
        if self.link.state != self._published:
            self._log_link(self._published, self.link.state)
            self._published = self.link.state
            self._link_record.write(self._published.encode())
        return stops

    def _check_link(self, now_ns: int, *, listening: bool) -> None:
        """Check whether the board still hears, and whether it still sends reports. `listening`: see poll()."""
        link, newest_ns = self.link, self._asked.get()
        if not self._latch.stop:
            link.cleared()
        said_ns = self._said_word.get()
        self._barrier()
        link.said(said_ns, newest_ns)
        if not listening:
            link.listen(newest_ns, now_ns)
            return
        if self.wheel_servos.waited_for():
            link.answered_in_part(newest_ns, now_ns)
        link.check_silence(self._patience.get(), now_ns)
        link.check_echo(self._unheeded.get())
        link.gone_deaf(newest_ns, now_ns)
        if link.missed(now_ns):
            text = "nothing has answered since the port came back, so it may not be the board: use the POWER SWITCH"
            self._run.events.log("link", text, {"state": LINK_UNHEARD}, level="critical")

    def _stops_for_link(self, now_ns: int) -> list[Stop]:
        """Return a list with one stop if motion is enabled although the board is deaf or silent, otherwise an empty
        list. While the state stays the same, the stop is returned again only after motion was disabled.

        A stop is also returned if motion is enabled and the board seemed silent only because the machine held up the
        service. In that case, nobody knows which commands the board has heard.
        """
        kind, unheard_ns = STOPS_FOR.get(self.link.state), self.link.pop_unheard()
        if unheard_ns and self._moves():
            return [Stop(now_ns, layout.SUPERVISOR, causes.NOT_HEARD(unheard_ns // MS))]
        if kind is None or not self._moves():
            self._stopped_for = ""
            return []
        if self._stopped_for == kind.name:
            return []
        self._stopped_for = kind.name
        return [Stop(now_ns, layout.SUPERVISOR, kind())]

    def opened(self, written_ns: int, now_ns: int, *, sure: bool) -> None:
        """Record that the lost port was opened again. The device may be a different board. `written_ns`: when the
        supervisor wrote the burst to this port. `sure`: True if the device is certainly the board."""
        last, before = self._last, self.link.state
        self.link.opened(now_ns, sure=sure)
        if last is None or written_ns <= last.stop.t_ns:
            return
        if not last.stop.written_ns or (before == LINK_UNHEARD and not last.believed):  # sent to another device
            self._written_at_last(last, written_ns, BY_SUPERVISOR)

    def _written_at_last(self, last: Proof, written_ns: int, by: str) -> None:
        """Record that the tracked stop `last` was written only now."""
        last.written_at_last(written_ns, by)
        last.believed = self.link.believed
        self._publish(last)

    def _read_answer(self) -> None:
        """Read from telemetry which of the written bytes the board has handled (board/handled.py). The record
        `answered` proves only that the link works. Only the record `proved` acknowledges a stop, because some boards
        must also report that they obey zeros."""
        answered, proved = self._answered.read(), self._proved.read()
        if answered and answered[0] != self._seen_answer:
            self._seen_answer = answered[0]
            self.link.answered(records.PROVED.unpack(answered[2])[0])
        if proved and proved[0] != self._seen_proof:
            self._seen_proof = proved[0]
            self._acknowledge(*records.PROVED.unpack(proved[2]))

    def _acknowledge(self, sent_ns: int, arrival_ns: int) -> None:
        """Record that the board has answered or obeyed the bytes that were written at `sent_ns`."""
        self.heard = max(self.heard, (sent_ns, arrival_ns))
        if self._last and self._last.ponged(sent_ns, arrival_ns):
            self._publish(self._last)

    def _look(self) -> tuple[int, int] | None:
        """Read telemetry's present verdict about the wheels, as (still_ns, judged_ns) of Proof.judged(). Returns None
        if telemetry has made a new one meanwhile, which is then read in the next turn."""
        judged_ns = self._judged.get()
        self._barrier()
        still_ns = self._still.get()
        self._barrier()
        if self._judged.get() != judged_ns:
            return None
        if judged_ns:
            self._verdict = still_ns, judged_ns
        return still_ns, judged_ns

    def _unstill(self, last: Proof, seen: tuple[int, int] | None, now_ns: int) -> bool:
        """True if the wheels still move after the stop `last`, so that the stop must be written again. Always False
        after a reset, because a person has taken over. `seen`: what _look() has returned."""
        stop = last.stop
        if self._latch.reset_epoch >= stop.epoch:
            self._command_ran = False
            return False
        if seen is None:
            return False
        known = last.observed_ns is not None
        unstill = last.judged(*seen, now_ns)
        if last.observed_ns is not None and not known:
            self._command_ran = False
            self._publish(last)
        if unstill:
            text = f"CRITICAL: {causes.UNSTILL().alarm()} ({stop.cause}; {(now_ns - stop.t_ns) / 1e9:.1f} s ago)"
            self._run.events.log("unstill", text, {"reason": str(stop.cause), "epoch": stop.epoch})
            if self._command and not self._command_ran:
                self._run_command()
        return unstill

    def _run_command(self) -> None:
        """Run the user's command (still.command) because the wheels still move after a stop. First kills commands that
        still run since an earlier stop. The caller runs the command again only after the wheels were seen still, or
        after a reset."""
        for pid in self._command_pids:
            try:
                os.kill(-pid, signal.SIGKILL)
                how = "killed"
            except OSError as error:  # it has another user's rights, for example through sudo
                how = f"cannot be killed ({error.strerror})"
            text = f"still.command (pid {pid}) has not ended since an earlier stop: {how}, and run again"
            self._log_command(text, "hangs", pid=pid)
        self._command_ran = True
        try:
            pid = starter.spawn(["/bin/sh", "-c", self._command], os.environ)
        except OSError as error:
            self._log_command(f"cannot run still.command ({self._command}): {error}", "failed", reason=str(error))
        else:
            self._command_pids.append(pid)
            self._log_command(f"still.command runs (pid {pid}): {self._command}", "runs", pid=pid)

    def _reap_command(self) -> None:
        for pid in tuple(self._command_pids):
            if (code := starter.reap(pid)) is not None:
                self._command_pids.remove(pid)
                self._log_command(f"still.command (pid {pid}) ended with code {code}", "ended", pid=pid, code=code)

    def _log_command(self, text: str, state: str, **fields: str | int) -> None:
        level = "error" if state in ("hangs", "failed") else ""
        self._run.events.log("command", text, {"state": state, **fields}, level=level)

    def _log_outcome(self, proof: Proof) -> None:
        link = self.link.state
        proof.held = proof.stop.written_ns > 0 and proof.acknowledged_ns is None and self._holds()
        if proof.held:
            self._publish(proof)
        level = "error" if proof.held or proof.wheels == WHEELS_UNSTILL else ""
        self._run.events.log("stop_outcome", proof.outcome(link), proof.fields(link), level=level)

    def ended(self, heard_ns: int, link: str, *, written: bool, sent: bool) -> None:
        """Log the end of the service, which writes two stops. `heard_ns`: how long after the first stop the board
        acknowledged it; 0 if it did not. `link`: the state of the link (proof.py). `written`: True if the kernel
        accepted the second stop. `sent`: True if the bytes of the second stop have also left the kernel."""
        told = "the stop was written twice" if sent else "the second stop could NOT be written"
        if written and not sent:
            told = f"the second stop was handed over, {NOT_SENT}"
        fields = {"link": link, "acknowledged_us": round(heard_ns / 1e3, 1) if heard_ns else None}
        # If an earlier stop is still latched, it has already ended all motion.
        unheeded = self._last and self._last.stop.cause.kind is causes.STOPPING and self._last.unheeded
        if heard_ns:
            heard, level = f"acknowledged by {ACKNOWLEDGED_BY[self._by[0]]} after {heard_ns / 1e6:.1f} ms", ""
        elif link == LINK_UNASKED and self._by[0] and not unheeded:
            heard, level = UNMOVED, ""
        elif link == LINK_UNPROVEN:
            heard, level = "nobody knows whether the board hears (link unproven)", "warning"
        elif link == LINK_UNASKED and not self._by[0]:
            heard, level = "this board never acknowledges a stop (link unasked)", ""
        else:
            heard, level = (
                f"NOT acknowledged by the board (link {link}); if the wheels turn, use the POWER SWITCH",
                "critical",
            )
        self._run.events.log("stopped", f"stopped; {told}, {heard}", fields, level=level if sent else "critical")

    def _log_link(self, before: str, state: str) -> None:
        if state in UNCONNECTED:
            self._run.events.log("link", UNCONNECTED[state], {"state": state}, level="critical")
        elif state == LINK_ALIVE:
            again = " again" if before in NOT_CONNECTED else ""
            self._run.events.log("link", f"the board answers{again}", {"state": state})
        elif before == LINK_SILENT:
            self._run.events.log("link", "the board reports again", {"state": state})
        elif before and state in (LINK_UNPROVEN, LINK_UNHEARD):
            text = "nobody knows whether the board hears until it answers"
            self._run.events.log("link", text, {"state": state}, level="info")

    def _publish(self, proof: Proof) -> None:
        self._record.write(pack(proof.as_record()))
