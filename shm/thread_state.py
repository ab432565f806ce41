"""Thread state: the kernel's word on the thread of a process that beats."""


def state_of(pid: int) -> str:
    """The letter of the main thread's state, which is the one that beats. Raises OSError."""
    with open(f"/proc/{pid}/task/{pid}/stat", "rb", buffering=0) as file:
        # The name in parentheses may hold anything.
        return file.read(512).rpartition(b") ")[2][:1].decode("ascii", "replace")
