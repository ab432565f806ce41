"""Readiness: what motion waits for, told to the gate by a word, to clients by the process table, and to people."""

from __future__ import annotations

from failstop.shm.packing import pack
from failstop.supervisor.children import RUNNING

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.cell import LatestWriter
    from failstop.supervisor.children import Child
    from failstop.supervisor.epochs import Epochs
    from failstop.supervisor.port_handover import PortHandover
    from failstop.supervisor.silence import Silence


class Readiness:
    """One publish() a turn. `ever`: the service has been ready."""

    def __init__(self, record: LatestWriter, epochs: Epochs, handover: PortHandover, silence: Silence) -> None:
        self._record = record
        self._epochs = epochs
        self._handover = handover
        self._silence = silence
        self._table = b""
        self.ever = False

    def missing(self, children: list[Child], *, stopping: bool) -> str:
        """What motion is still waiting for; empty when nothing. `stopping`: a stop is not answered yet."""
        absent = [child.row.name for child in children if child.state != RUNNING]
        if not absent and not self._handover.complete():
            return "the port"
        # A stop that the supervisor wrote itself is still to be answered: a port owner that was held up would cut into
        # motion of a later enable, with frames of an older one perhaps before that.
        carried_out = self._epochs.answered() and not stopping
        return ", ".join(absent) or ("" if carried_out else "a stop being carried out")

    def publish(self, missing: str, children: list[Child]) -> bool:
        """The process table and the ready word, when they change. True once: it is ready for the first time."""
        processes = {
            child.row.name: {
                "pid": child.pid,
                "state": child.state,
                "restarts": child.times_restarted,
                "last_exit": child.last_exit or None,
            }
            for child in children
        }
        table = pack({"waiting_for": missing or None, "starved": self._silence.as_record(), "processes": processes})
        self._epochs.ready_word.set(not missing)
        if table != self._table:
            self._table = table
            self._record.write(table)
        first = not missing and not self.ever
        self.ever |= first
        return first
