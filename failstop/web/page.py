"""Page: everything that the handlers of one service's page share."""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tornado.ioloop import PeriodicCallback

from failstop.api.errors import FailstopError, NoService
from failstop.web import assets, devices, guard, stopping, storage
from failstop.web.attending import Attending
from failstop.web.connections import Places
from failstop.web.driving import Driving
from failstop.web.incidents import Incidents
from failstop.web.limits import Limit
from failstop.web.watcher import PERIOD_S, Watcher
from failstop.web.workers import Workers

TYPE_CHECKING = False
if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from tornado.iostream import IOStream

    from failstop.policy.settings import Settings
    from failstop.web.lease import Lease
    from failstop.web.source import Source
    from failstop.web.viewer import Closing, Viewer

ID_BYTES = 4
REVOKED = 1008
"""The code that closes the websocket of a device that was unpaired. RFC 6455 calls it "policy violation"."""
MOST_STOPS = 64
"""How many STOP websockets may be open. A page without a STOP websocket sends its STOP as an HTTP request."""


class Page:
    """Everything that the handlers of the page share."""

    def __init__(self, name: str, settings: Settings, source: Source) -> None:
        """`source`: where the settings come from. Raises FailstopError."""
        self.name, self.source = name, source
        self.address = settings.text("web.address")
        self.port = int(settings["web.port"])
        self.assets = assets.load()
        self.origin = guard.origin_of(settings.text("web.origin"))
        self.scheme = self.origin.partition(":")[0]
        self.names = guard.names(socket.gethostname(), settings.text("web.hosts"), self.origin)
        self.watcher = Watcher(name)
        self.viewers: list[Viewer] = []
        self.stops: Places[Closing] = Places(MOST_STOPS)
        self.let_in: Callable[[IOStream], None] = lambda stream: None
        self.pairing_on = settings.on("web.pairing")
        self.pairing = devices.Pairing()
        self.pair_limit = Limit(0.2, 5)
        self.verb_limit = Limit(2.0, 6)
        self.story_limit = Limit(10.0, 60)
        self.defect_limit = Limit(1 / 60, 2)
        self.stop_pipe = stopping.Pipe(name)
        self.asked = stopping.Asked(self.stop_pipe)
        self.workers = Workers(name)
        self.driving = Driving(name, settings)
        self.attending = Attending(name, self.driving.end)
        self._lease_s = float(settings["attend.lease_s"])
        self.incidents = Incidents(name)
        self._storage = storage.Storage(storage.folder(name, os.environ))
        self.devices = self._storage.devices() if self.pairing_on else devices.Devices()
        self._saving = asyncio.Lock()
        """Held while a list of devices is saved. So no other list is saved with a device that is removed again because
        saving it failed."""
        self._disk = ThreadPoolExecutor(1, "disk")
        """Saves the devices, one list after the other. A slow disk can hold up a write for seconds, and no STOP may
        wait for it."""
        self.tls = self._tls(settings.text("web.tls"))
        self.fingerprint = self._storage.fingerprint() if self.tls else ""
        self.control_path = self._storage.path(storage.CONTROL)
        self._timer = PeriodicCallback(self._tick, PERIOD_S * 1e3)

    def _tls(self, wanted: str) -> ssl.SSLContext | None:
        if wanted == "off" or (wanted == "auto" and guard.only_here(self.address)):
            return None
        return self._storage.tls(sorted(self.names))

    def addresses(self) -> dict[str, Any]:
        """Return the scheme, address and port at which the page listens, the fingerprint of its certificate (or ""),
        and its origin behind a proxy (or "")."""
        scheme = "https" if self.tls else "http"
        where = {"scheme": scheme, "address": self.address, "port": self.port, "fingerprint": self.fingerprint}
        return {**where, "origin": self.origin}

    def look(self) -> None:
        """Read the robot's state now."""
        self.watcher.look(time.monotonic(), time.time())

    async def stopped(self, request: stopping.Request) -> tuple[int, dict[str, Any]]:
        """Wait up to WRITTEN_S until a requested stop is written. Returns the HTTP status and the answer for the
        page."""
        if request.error:
            return 503 if isinstance(request.error, NoService) else 500, {"error": str(request.error)}
        written = await stopping.written(self.name, request.asked_ns)
        self.stop_pipe.prepare()
        self.look()
        return 200, {"asked": request.unix_s, "written": written, "view": self.watcher.shown}

    def newest_stop(self) -> int:
        """Return the present epoch, which identifies the newest stop. 0 if no service is running."""
        self.look()
        return self.watcher.state.epoch if self.watcher.state else 0

    def limit(self) -> int:
        """Return the present speed limit, in percent of the highest speeds in the settings. 0 if no service is
        running."""
        self.look()
        return round(100 * self.watcher.state.speed_limit) if self.watcher.state else 0

    def counts(self, held: Lease) -> bool:
        """Return True if the operator whose device has proved this lease counts as present: the newest proof is new
        enough, and the gate counts an operator. Only the newest proof of all operators is reported to the gate, so the
        gate need not know the name of this one."""
        state = self.watcher.state
        passed_s = (time.monotonic_ns() - held.proven_ns) / 1e9
        return state is not None and state.attended_by != () and held.proven_ns > 0 and passed_s <= self._lease_s

    async def pair(self, code: str, name: str) -> str:
        """Pair a new device, and return its token. Raises NotPaired if the code is not valid or there are too many
        devices, and FailstopError if saving fails."""
        self.pairing.redeem(code, time.monotonic())
        token = secrets.token_urlsafe(devices.TOKEN_BYTES)
        async with self._saving:
            made = devices.Device(
                secrets.token_hex(ID_BYTES), self.devices.free_name(name), devices.digest_of(token), round(time.time())
            )
            self.devices.add(made)
            try:
                await self._save(self._storage.keep)
            except Exception:
                self.devices.revoke(made.id)
                raise
        return token

    async def _save(self, how: Callable[[devices.Devices], None]) -> None:
        """Save the present devices in a thread, by one of the storage's methods. Call it with `_saving` held. Raises
        FailstopError."""
        present = devices.Devices(tuple(self.devices.all()))
        await asyncio.get_running_loop().run_in_executor(self._disk, how, present)

    async def revoke(self, identity: str) -> str:
        """Unpair the device with this id at once, then save the list of devices. Returns the device's name, or "" if
        the id is unknown. Raises FailstopError if the new list of devices can't be saved. In that case, the device is
        unpaired only until the page is restarted."""
        its = [viewer for viewer in self.viewers if (device := viewer.device()) and device.id == identity]
        found = self.devices.revoke(identity)
        if found is None:
            return ""
        for viewer in its:
            self.attending.end(viewer)
            # The device connects again, and then learns what it may still do.
            viewer.close(REVOKED, "this device is not paired any more")
        try:
            async with self._saving:
                await self._save(self._storage.keep_fewer)
        except FailstopError as error:
            raise FailstopError(f"{found.name} is revoked, and back after a restart of the page: {error}") from None
        return found.name

    def join(self, viewer: Viewer) -> None:
        """Add a viewer, and send it the state. The first viewer starts the timer that reads the robot's state."""
        self.viewers.append(viewer)
        if not self._timer.is_running():
            self._timer.start()
        self.look()
        viewer.show(time.monotonic(), time.time())

    def leave(self, viewer: Viewer) -> None:
        """Remove a viewer, and end its operator's attendance. If no viewer is left, stop reading the robot's state."""
        self.attending.end(viewer)
        if viewer in self.viewers:
            self.viewers.remove(viewer)
        if not self.viewers:
            self._timer.stop()

    def _tick(self) -> None:
        now_s, unix_s = time.monotonic(), time.time()
        self.watcher.look(now_s, unix_s)
        for viewer in tuple(self.viewers):
            viewer.show(now_s, unix_s)

    def close(self) -> None:
        """Close everything that the page has open."""
        self._timer.stop()
        self.stop_pipe.close()
        self.attending.close()
        self.driving.close()
        self.workers.close()
        self.incidents.close()
        self._disk.shutdown(cancel_futures=True)  # a write that has begun ends before another page may lock the folder
        self._storage.close()
