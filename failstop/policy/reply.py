"""Reply: what becomes of a request, from whoever decides it to whoever asked."""

from __future__ import annotations

from failstop.data import Data
from failstop.messages import records
from failstop.messages.records import CAUSE
from failstop.policy import causes
from failstop.policy.causes import Cause


class Reply(Data):
    """Done, refused, or under way (records), in a text that has CAUSE where the cause's own belongs."""

    done: int
    text: str
    cause: Cause | None = None

    def __str__(self) -> str:
        return self.text.replace(CAUSE, str(self.cause))

    def pack(self, session: int, number: int) -> bytes:
        """For the request of this number, of this client's session."""
        return records.REPLY.pack(session, number, self.done, self.text, self.cause.pack() if self.cause else b"")


def asked_before(cause: Cause) -> Reply:
    """Refused: who asked before the last stop, which is for this cause, did not know of it."""
    return Reply(False, f"asked before the last stop ({CAUSE}): see to that, then ask again", cause)


def unpack(payload: bytes) -> tuple[int, int, Reply]:
    """Return (session, number, reply). Raises ValueError."""
    session, number, done, text, cause = records.REPLY.unpack(payload)
    return session, number, Reply(done, text, causes.read(cause) if cause else None)
