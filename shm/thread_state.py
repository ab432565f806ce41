"""Thread state: the kernel's state of the thread that beats for a process."""


def state_of(pid: int) -> str:
    """The letter for the state of the main thread, which is the one that beats. Raises OSError."""
    with open(f"/proc/{pid}/task/{pid}/stat", "rb", buffering=0) as file:
        # The name in parentheses may contain anything.
        return file.read(512).rpartition(b") ")[2][:1].decode("ascii", "replace")
