"""Users: whose the files of the simulated machine are, and who may do what with them."""

from __future__ import annotations

import errno
import os
from typing import TypeVar

from failstop_lab.machine.files import Directory, Node
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.process import Process

MAY_READ, MAY_WRITE, MAY_PASS = 4, 2, 1
STICKY = 0o1000
Made = TypeVar("Made", bound=Node)


def made(process: Process, node: Made) -> Made:
    """Give a node that a process has just made to its user, without the rights that it masks."""
    node.uid, node.gid = process.uid, process.gid
    node.mode &= ~process.umask
    return node


def check_rights(process: Process, node: Node, wanted: int, path: object = None) -> None:
    """Raises PermissionError where this process may not."""
    shift = 6 if node.uid == process.uid else 3 if node.gid == process.gid else 0
    if process.uid and wanted & ~(node.mode >> shift):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)


def check_drop(process: Process, above: Directory, node: Node, path: object = None) -> None:
    """May this process take the name of that node away? Raises PermissionError."""
    check_rights(process, above, MAY_WRITE, path)
    if above.mode & STICKY and process.uid not in (0, node.uid, above.uid):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), path)


def check_owner(process: Process, node: Node, gid: int = -1, uid: int = -1) -> None:
    """May this process give a file another mode, or this group and user? Raises PermissionError."""
    if process.uid and (process.uid != node.uid or gid not in (-1, process.gid) or uid not in (-1, node.uid)):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))


def wanted(flags: int) -> int:
    """The rights that an open with these flags takes."""
    if flags & os.O_PATH:
        return 0
    return {os.O_RDONLY: MAY_READ, os.O_WRONLY: MAY_WRITE, os.O_RDWR: MAY_READ | MAY_WRITE}[flags & 3]


class SymbolicLink(Node):
    """A symbolic link."""

    kind = 0o120000

    def __init__(self, target: str) -> None:
        super().__init__(0o777)
        self.target = target


class ProcessFolder(Directory):
    """/proc: a folder for each process, with its threads."""

    def __init__(self, machine: Machine) -> None:
        super().__init__(0o555, machine.root)
        self._machine = machine

    def found(self) -> dict[str, Node]:
        """The present content."""
        folders: dict[str, Node] = {}
        for pid, process in self._machine.processes.items():
            if not process.reaped and (process.code is None or process.parent):
                folders[str(pid)] = folder = Directory(0o555, self)
                folder.put("task", tasks := Directory(0o555, folder))
                for thread in process.threads:
                    tasks.put(str(thread.number), Directory(0o555, tasks))
        return folders
