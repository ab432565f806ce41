"""Front: what stands between a browser and the page, as a proxy or a bad network does. It may end TLS, and leave
requests of some paths without an answer for ever."""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
from types import TracebackType

AT_ONCE = 65536


class Front:
    """A context manager: passes connections on to a port of this machine, which is known when it begins or later."""

    def __init__(self, to: int = 0, *, holds: tuple[str, ...] = (), tls: ssl.SSLContext | None = None) -> None:
        """`holds`: beginnings of the paths that are never answered."""
        self.to = to
        self.holds = holds
        self.held: list[str] = []
        """The paths that wait for an answer now."""
        self._tls = tls
        self._lost: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=64)
        self._open: dict[socket.socket, tuple[socket.socket, str]] = {}
        """The browser's ends: the page's end, and the path that was asked for last."""
        self._ended = False

    @property
    def url(self) -> str:
        """As the browser has it."""
        return f"{'https' if self._tls else 'http'}://localhost:{self._listening.getsockname()[1]}/"

    def __enter__(self) -> Front:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended = True
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.cut()

    def lose(self, path: str) -> None:
        """Deliver nothing more of the connections that are open for this path, and end none, as when a phone has
        changed its network."""
        self._lost |= {near for near, (_, asked) in self._open.items() if asked == path}

    def cut(self, *paths: str) -> None:
        """End every connection that is open now, or those of some paths."""
        for near, (far, path) in tuple(self._open.items()):
            for each in (near, far) if path in paths or not paths else ():
                with contextlib.suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while not self._ended:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(near,), daemon=True).start()

    def _serve(self, near: socket.socket) -> None:
        with contextlib.suppress(OSError), contextlib.ExitStack() as opened:
            if self._tls:
                near = self._tls.wrap_socket(near, server_side=True)
            opened.enter_context(near)
            far = opened.enter_context(socket.create_connection(("127.0.0.1", self.to)))
            self._open[near] = far, ""
            back = threading.Thread(target=self._back, args=(near, far), daemon=True)
            back.start()
            self._forth(near, far)
            with contextlib.suppress(OSError):
                far.shutdown(socket.SHUT_RDWR)
            back.join()
            del self._open[near]

    def _forth(self, near: socket.socket, far: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := near.recv(AT_ONCE):
                words = data.split(b" ", 2) if data.startswith((b"GET ", b"POST ", b"HEAD ")) else []
                path = words[1].decode("ascii", "replace") if len(words) > 2 else ""
                if near in self._lost:
                    continue
                if path:
                    self._open[near] = far, path
                if path and path.startswith(self.holds):
                    self.held.append(path)
                    while near.recv(AT_ONCE):
                        pass
                    self.held.remove(path)
                    return
                far.sendall(data)

    def _back(self, near: socket.socket, far: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := far.recv(AT_ONCE):
                near.sendall(data)
        if self._open[near][1].startswith(self.holds or ("\0",)):
            return  # the page gives up what asks for nothing; the browser is to wait all the same
        with contextlib.suppress(OSError):
            near.shutdown(socket.SHUT_RDWR)
