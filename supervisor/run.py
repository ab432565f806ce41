"""Run: everything that one run of the service creates before it starts its first process, and how all of it is removed.

Other programs find a run by its name: a file that says which shared memory belongs to the service. The name is created
last and removed first. So if the name exists, everything that belongs to the run exists too.

Someone may remove the names of the shared memory and the pipes while the service runs. For example, with RemoveIPC=yes
in logind.conf, logind removes the shared memory's names when the service's user logs out. Running processes can still
use the memory. But no process can be restarted, no client can connect, and without the stop pipe nobody can request a
stop. A running service can't repair this, so it ends, and the next run creates new names.
"""

from __future__ import annotations

import grp
import os

from failstop.files import instance
from failstop.messages import layout, segments
from failstop.messages.packing import pack
from failstop.notify import Outbox
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings
from failstop.procs import handover
from failstop.procs.loop import Loop
from failstop.shm import bell, claim
from failstop.shm.bell import EventBell
from failstop.shm.lifeline import pid_namespace
from failstop.shm.segment import Segment
from failstop.supervisor.events import Events

GROUP = "failstop"
"""The group whose members may drive the robot. Any user may stop the robot, even without this group."""
SHARED_MEMORY = "shared memory "
A_SLOT = f"{SHARED_MEMORY}client."
"""In `Run.named`, the key of each client slot begins with this text. If the name of a client slot is removed, the
service can still go on."""
LOOK_EVERY_NS = 1_000_000_000


def client_gid() -> int:
    """The id of the group whose members may drive. Returns -1 if the group does not exist, or if this user may not use
    it. In that case, the members of the group under which the service runs may drive."""
    try:
        gid = grp.getgrnam(GROUP).gr_gid
    except KeyError:
        return -1
    return gid if os.geteuid() == 0 or gid in os.getgroups() else -1


class Run:
    """Everything that the parts of one run share: shared memory, pipes, claims, bells, control sockets, settings, loop
    and events."""

    def __init__(
        self, settings: Settings, name: str, runtime_dir: str, journal: Outbox | None = None, again: str = ""
    ) -> None:
        """Create everything except the run's name, which publish() creates. The caller must hold the instance's lock.
        Raises segments.AttachError, instance.InstanceError or OSError. Before it raises, it removes everything that it
        has created."""
        self.settings = settings
        self.name = name
        self.runtime_dir = runtime_dir
        self._again = again
        """The command line with which the same service can be started again."""
        self.incarnation = int.from_bytes(os.urandom(8), "little")
        self.memory = segments.memory(name, self.incarnation)
        """The first part of the name of every segment of this run."""
        self._refuse_living()
        self._dead = segments.dead_runs(name)
        self.left = segments.open_all(self._dead[-1]) if self._dead else {}
        """The descriptors of an earlier run's black box, if that run did not end cleanly. The names of the earlier
        run's shared memory are removed when this run has published its own name."""
        self._segments: list[Segment] = []
        self.readable: dict[str, int] = {}
        """The descriptors of the processes' segments, for the black box. They work even after the names of the segments
        are removed."""
        try:
            self._make(client_gid())
            self.own = segments.attach(self.memory, layout.SUPERVISOR, self.incarnation, write=True)
            self.views = {each: segments.attach(self.memory, each, self.incarnation) for each in layout.PROCESS_NAMES}
            self._publish_settings()
            self.loop = Loop()
        except BaseException:
            self.remove()
            raise
        self.events = Events(name, self.own.ring_writer("events"), journal)
        self._looked_ns = 0

    def _refuse_living(self) -> None:
        """Raise an InstanceError if another run of this instance is alive. This finds the other run even if someone has
        removed the lock file."""
        try:
            incarnation, _ = instance.current_run(self.runtime_dir)
        except instance.NoService:
            return
        if segments.living(segments.memory(self.name, incarnation)):
            raise instance.already_running(self.name, "unknown")

    def _make(self, gid: int) -> None:
        instance.clear(self.runtime_dir)  # remove the name of the dead run before anything under it is replaced
        # Created one by one, so that a failure leaves only known files.
        for spec in layout.SEGMENTS:
            self._segments.append(segments.create(self.memory, spec.name, self.incarnation, gid))
        self.readable = segments.open_all(self.memory)
        if missing := [process for process in layout.PROCESS_NAMES if process not in self.readable]:
            raise segments.AttachError("absent", f"shared memory {missing[0]} was there and can't be opened: try again")
        # Clients may only write. A client that reads could take away the requests of other clients.
        bell.make_pipe(instance.stop_path(self.runtime_dir), 0o622)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o620, gid)
        os.close(claim.open_claims(instance.claims_path(self.runtime_dir), create=True, mode=0o660, gid=gid))
        self.stop_pipe = bell.open_pipe(instance.stop_path(self.runtime_dir))
        self.client_bell = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self.named = {f"{SHARED_MEMORY}{made.spec.name}": made.fileno() for made in self._segments}
        """The objects that other processes find by name, as {the name for people: a descriptor of the object}. If
        fstat() of the descriptor reports no links, the name was removed."""
        self.named |= {"the stop pipe": self.stop_pipe, "the bell of the clients": self.client_bell}
        self.bells = {process: EventBell.create() for process in layout.PROCESS_NAMES}
        self.controls = {process: handover.pair() for process in (layout.PORT_OWNER, layout.STOPPER, layout.TELEMETRY)}

    def _publish_settings(self) -> None:
        """Publish in shared memory: the settings that clients need, the pid namespace of this process, and the complete
        settings."""
        rules = {
            "sources": list(self.settings.sources()),
            "interlocks": list(self.settings.interlocks()),
            "lease_ns": self.settings.ns("gate.lease_s"),
            "pid_namespace": pid_namespace(),
        }
        self.own.latest_writer("rules").write(pack(rules))
        self.own.latest_writer("settings").write(pack(self.settings.flat()))

    def publish(self, stop: str = "", usb: str = "") -> None:
        """Publish the run's name, so that clients can find the run. Call this when everything that clients read exists.
        Also saves the command line that starts the same service again, and how a command can stop the robot while no
        service runs. `stop`: the board's stop, as board/kept.py packs it. `usb`: the USB device at the port
        (finder.Device.text). Raises OSError."""
        self._port = self.settings.text("device.path"), usb
        device = os.path.abspath(self._port[0])
        kind = self.settings.text("board.kind")
        self._last = instance.Last(device, self._again, self.settings.servos(), kind, stop, usb)
        instance.remember(self.runtime_dir, self._last)
        self.published = instance.publish_run(self.runtime_dir, self.incarnation)
        self.named["the name of the run"] = self.published
        for run in self._dead:
            segments.unlink_all(run)

    def follow_port(self, path: str, usb: str) -> None:
        """Save where the board is now, if that has changed: a command that stops the robot after the death of this run
        writes to this port. `path`: its port. `usb`: the USB device at that port (finder.Device.text)."""
        if (path, usb) == self._port:
            return
        self._port = path, usb
        try:
            self._last.device, self._last.usb = os.path.abspath(path), usb
            instance.remember(self.runtime_dir, self._last)
        except OSError as error:
            text = f"the board's new port {path} could not be saved ({error.strerror})"
            step = "restart the service when the robot may stop: if all of it is killed, its stop goes to the old port"
            self.events.log("note", text, level="warning", step=step)

    def descriptors(self, process: str, port_fd: int) -> dict[str, int]:
        """Every descriptor that the process `process` may inherit. The keys are the names of the options on its command
        line."""
        found = {f"{other}_bell": found.fd for other, found in self.bells.items()}
        found |= {"bell": self.bells[process].fd, "port": port_fd}
        found |= {"stop": self.stop_pipe, "client_bell": self.client_bell}
        if process in self.controls:
            found["control"] = self.controls[process][1]
        return found

    def lost(self, now_ns: int) -> Cause | None:
        """Log each removed name that other processes need. Returns a cause if the service must end because of a removed
        name, otherwise None. Checks at most once per second."""
        if now_ns - self._looked_ns < LOOK_EVERY_NS:
            return None
        self._looked_ns = now_ns
        gone = [name for name, fd in self.named.items() if not os.fstat(fd).st_nlink]
        for name in gone:
            del self.named[name]
        if vital := [name for name in gone if not name.startswith(A_SLOT)]:
            text = f"{', '.join(vital)}: removed, so the service ends; a new start creates it again"
            step = "is RemoveIPC=yes in logind.conf? `failstop doctor` checks"
            self.events.log("note", text, level="error", step=step)
            return causes.REMOVED(vital[0])
        for name in gone:
            text = f"{name} was removed, so that client slot can't be used"
            self.events.log("note", text, level="warning", step="restart the service when the robot may stop")
        return None

    def remove(self) -> None:
        """Remove the run's name, and then all other names of the run. A process that still uses the shared memory can
        go on using it."""
        instance.clear(self.runtime_dir)
        segments.unlink_all(self.memory)
        for made in self._segments:
            made.close()
        while self.readable:
            os.close(self.readable.popitem()[1])
