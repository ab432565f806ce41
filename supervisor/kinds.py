"""The table of event kinds. Each row has the kind's level, its MESSAGE_ID, and the fields that every event of the kind
has.

systemd's journal finds the explanation of an event by its MESSAGE_ID, so the MESSAGE_ID of a kind never changes. The
explanations are in lab/failstop_lab/pages/catalog_texts.py.
"""

from __future__ import annotations

from failstop.data import Data

LEVELS = {"critical": 2, "error": 3, "warning": 4, "notice": 5, "info": 6}
"""The journal's PRIORITY number for each level."""


class EventKind(Data):
    """One row of the table of event kinds. `fields`: the names of the event's fields, separated by spaces."""

    name: str
    level: str
    message_id: str
    fields: str = ""


EVENT_KINDS = (
    EventKind("ready", "notice", "019484cdaf0545c2b4ff5e8fc487d4bb"),
    EventKind("waiting", "warning", "e12d029f8969465ebe24b87501c4fa50", "for"),
    EventKind("stop", "warning", "d64c7adf98c047808bc2802fe77d504b", "reason noticed_by written_by epoch"),
    EventKind(
        "stop_again", "warning", "2c6e64c285a7435ab4556b269c245db3", "reason noticed_by written_by epoch latched"
    ),
    EventKind("stop_also", "notice", "16e91c030a5347e792e929e9f1a13adb", "reason noticed_by"),
    EventKind("stop_outcome", "notice", "fc05c1f31f724be5bca7cd7dd6834b42", "reason link"),
    EventKind("unstill", "critical", "f71aa7ca3afa4b01a9932952acebe386", "reason"),
    EventKind("wheels_turn", "warning", "4f0a6f3c1d5b4a0e9c3f7b2d8e6a1c95", "state by"),
    EventKind("wheel_stands", "warning", "b7d2c9e84a1f4d63a05e9b7c3f8216da", "wheel told seen"),
    EventKind("servo", "warning", "c424c5a469244cf0bdea4313ae820f45", "part wrong"),
    EventKind("died", "error", "1e64f97a9f8242b9bbd9dac4d3533ca8", "process pid how"),
    EventKind("restarting", "notice", "839c001330c04363ace8f58dd80349f3", "process wait_s"),
    EventKind("down", "critical", "d425ec3582c843a999835f153362effe", "process"),
    EventKind("start_failed", "error", "136159b2497249b0a1a23e57aa59480a", "process reason"),
    EventKind("not_started", "error", "192201d8d49d43efb4ce40b1729976ac", "reason"),
    EventKind("fenced", "error", "61960dd921854ce5960e3d28f97288ee", "process pid silent_ms kill_us"),
    EventKind("starved", "warning", "3823733a664c4c1aa730d19d41555c76", "process silent_ms times"),
    EventKind("suspended", "warning", "7755f507240d40259ec70e7e2702f8f0", "silent_ms"),
    EventKind("enabled", "notice", "3bfd144a1c00461f861da553c93614d9", "who"),
    EventKind("disabled", "notice", "9ed186beffa7488bbf12bd4f6463b06f"),
    EventKind("reset", "notice", "085c02e749f54017874cb058835723df", "who"),
    EventKind("limit", "notice", "70435faa2f774175863433ae2a9e0b23", "who"),
    EventKind("refused", "notice", "e46f8afd78764309952f8428eebda5b9", "who verb reason"),
    EventKind("ignored", "warning", "b3b319d319c74c748c77923638d33b72", "who source"),
    EventKind("said", "info", "7d3f0b6e9c1a4f52a8e45b0c6d2f9137", "who sees wrong"),
    EventKind("driver_silent", "warning", "c551b8c00bd64343874e0bef0e460f9d", "who source silent_ms"),
    EventKind("driver_gone", "warning", "5c69d278e12541c884ee76082770b8f7", "who source"),
    EventKind("driver_ended", "info", "92de198a2b114a578f729782376c96f8", "who source"),
    EventKind("device_lost", "error", "ad86431d272243de804dc53ce7353048", "path"),
    EventKind("device_back", "notice", "9ccb732a9e874f2ba9495eeedcf3228f", "path"),
    EventKind("restarted", "warning", "5b0f2f0c7c7e4b0f9f0a4a1f6d1c8e33", "sign"),
    EventKind("link", "notice", "26df9cadbcba4b67963b906680e6a454", "state"),
    EventKind("rights", "warning", "a56c088a927e4d8f9106a8df85dec9c6", "what"),
    EventKind("pad", "notice", "a06ff401a7f049889d61e332ac51386f"),
    EventKind("arm", "notice", "7873e90547884f3d9adf7b087d72596e"),
    EventKind("charger", "info", "72df7bd7397a41fca08599cf028e6a11", "state battery_mv"),
    EventKind("odd", "warning", "0a7a36f2fd3a4f13bd343acb84ccd8dd", "what value"),
    EventKind("scan", "warning", "5db72888dc83420d9884c7633dd8d1f9", "state"),
    EventKind("scale", "warning", "76eedeefe3404555ba6a97353d5482f6"),
    EventKind("gyro", "info", "082c033a964f4063a2b4f6814ee960e8"),
    EventKind("disk", "warning", "9e790b1bc2634737a9047e698e7df8ff"),
    EventKind("command", "warning", "24cb47b33041490ba3a67714e953ea58", "state"),
    EventKind("left_out", "notice", "8a1febefb5a44a38a98feb2f2d38c465", "of count"),
    EventKind("note", "info", "52bb8f68c7914cb6b272bc07f6b0b35c"),
    EventKind("incident", "notice", "03354876ce0c41f98bc62f66572f716a"),
    EventKind("stopping", "notice", "59066ee0452549998781172916643259", "reason"),
    EventKind("stopped", "notice", "a9c157b26c984105a437043f1ba39f09", "link"),
)

EVENT_BY_NAME = {kind.name: kind for kind in EVENT_KINDS}
