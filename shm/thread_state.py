"""Thread state: the state of a process's main thread, as the kernel reports it. The main thread writes the
heartbeat."""


def state_of(pid: int) -> str:
    """The letter for the state of a process's main thread, for example R (runnable) or S (sleeping). Raises OSError."""
    with open(f"/proc/{pid}/task/{pid}/stat", "rb", buffering=0) as file:
        # The process's name, in parentheses, may contain any characters.
        return file.read(512).rpartition(b") ")[2][:1].decode("ascii", "replace")
