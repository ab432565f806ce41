"""Reasons: what a cause means in plain words, and what to see to before it is reset. Pure."""

from __future__ import annotations

from failstop.board.decoder import BUTTONS
from failstop.policy.causes import filled
from failstop.policy.processes import ROLES

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


def explain(cause: Cause) -> tuple[str, str]:
    """What happened and what to see to, two texts that continue a sentence."""
    given = cause.named()
    given["role"] = ROLES.get(str(given.get("process")), "")
    given["names"] = _buttons(int(given.get("buttons", 0)))
    return filled(cause.kind.what, given), cause.kind.remedy


def _buttons(pressed: int) -> str:
    """Names of the pressed buttons, the bits that have none by number."""
    names = [name for name, bit in BUTTONS.items() if pressed & bit]
    names += [f"0x{1 << bit:04X}" for bit in range(16) if pressed & 1 << bit and 1 << bit not in BUTTONS.values()]
    return " and ".join(names)
