"""Hazards: what can go wrong around a robot that failstop stops; what stopping adds, and the tool itself, are among
them."""

from __future__ import annotations

import dataclasses

SOFTWARE = "software fails"
OUTSIDE = "what no software here can stop"
OF_STOPPING = "stopping itself"
PEOPLE = "people and settings"
HAZARD_CLASSES = (SOFTWARE, OUTSIDE, OF_STOPPING, PEOPLE)

NOTHING_HELPS = "nothing helps here"
"""The answer to a hazard that no claim covers begins with this."""


@dataclasses.dataclass(frozen=True)
class Hazard:
    """One row."""

    name: str
    kind: str
    """One of HAZARD_CLASSES."""
    what: str
    how: str
    """The way in which it comes about."""
    does: str
    """The answer of failstop; begins with NOTHING_HELPS where no claim carries the hazard."""
    remains: str
    helps: str
    """Hardware or a way of working that helps."""
    claims: tuple[str, ...] = ()


HAZARDS = (
    Hazard(
        "H-DIES", SOFTWARE, "The robot drives on when a program dies",
        "a crash, a kill, a failed allocation in the driving program or in a process of the service",
        "stops, within milliseconds of the death", "the way that the robot rolls in this time and while it brakes",
        "lower limits", ("DEATH-1", "SEVERAL-1", "CLIENT-1"),
    ),
    Hazard(
        "H-HANGS", SOFTWARE, "The robot drives on when a program hangs",
        "an endless loop, a lock, a debugger, a machine that swaps", "stops when the deadline of the process is over",
        "the way until the deadline; a program that wakes up drives on (but for gate.driver_silence)",
        "lower limits; shorter timeouts",
        ("HANG-1", "CLIENT-1", "SEVERAL-1"),
    ),
    Hazard(
        "H-RUNS-ON", SOFTWARE, "The wheels turn again behind a stop",
        "a frame that was on its way, a process that is restarted, a reset by a program",
        "refuses motion of the epoch before; a start, a reset and a return enable nothing",
        "one frame that was past its last look, answered by the next stop", "a relay that a person closes again",
        ("MOVE-1", "MOVE-2", "START-1", "END-1"),
    ),
    Hazard(
        "H-FAST", SOFTWARE, "The robot drives faster than anybody wants",
        "a program that commands too much, or no number; a wheel that runs away",
        "limits speed and acceleration; a command that is no number stops, and so does a wheel that is reported faster"
        " than it is told",
        "a motor without its encoder, and a board that reports nothing",
        "limits at which an impact is acceptable", ("LIMIT-1", "CLIENT-1", "RUNAWAY-1"),
    ),
    Hazard(
        "H-BLIND", SOFTWARE, "A program drives without its obstacle sensor", "a sensor, its driver or its cable fails",
        "blocks what programs drive until the sensor delivers", "a sensor that delivers and sees nothing", "bumpers",
        ("SENSOR-1",),
    ),
    Hazard(
        "H-STARVED", SOFTWARE, "The stop comes late", "a busy machine, a lack of rights, memory or disk, a sleep",
        "runs with real-time rights, prepares what a stop needs, and says what it lacks",
        "a program of higher priority that takes every core; a sleep that nobody announces",
        "`failstop doctor`; a machine with nothing else to do", ("ASK-2", "TIME-1", "HANG-1"),
    ),
    Hazard(
        "H-DRIVER", SOFTWARE, "A driver of the bare board drives on by what it wrote before it died",
        "a program that knows nothing of failstop dies, hangs or starts again at the guard port",
        "plays the board for it: takes what the board would take, answers in step, drops what a dead driver wrote, and"
        " lets it drive only after an enable",
        "a driver that adds up its error while it is refused starts with a jump (`guard.hang_up`); a child that keeps"
        " the port hides the death where /proc does not show the driver",
        "run the guard as the user who runs the driver", ("GUARD-1", "CLIENT-1"),
    ),
    Hazard(
        "H-HOSTILE", SOFTWARE, "Somebody else on the machine drives, or keeps the stop away",
        "another user, a broken client, memory that is written over",
        "lets everybody stop and the group alone drive; trusts no memory of others",
        "a member of the group can pose as another client, within the limits; root can do anything",
        "few members of the group", ("ACCESS-1", "MEMORY-1", "ASK-1"),
    ),
    Hazard(
        "H-CABLE", OUTSIDE, "The cable is out and the wheels turn on", "a plug that shakes loose, a hub without power",
        "stops the moment the board is back, and arms the board's own watchdog where it has one",
        "the robot drives until somebody stops it, where the board has no watchdog",
        "a relay that needs a living signal; a watchdog in the firmware; the power switch", ("PORT-1", "WATCHDOG-1"),
    ),
    Hazard(
        "H-DEAF", OUTSIDE, "The board is deaf, full or does not obey",
        "a firmware that hangs, a broken driver or encoder",
        "tells of it within a second where the board can answer, repeats the stop, runs `still.command`",
        "the wheels turn until power is cut", "the power switch; a relay by `still.command`",
        ("BOARD-1", "SILENCE-1", "BOARD-2", "PROOF-1"),
    ),
    Hazard(
        "H-FROZEN", OUTSIDE, "The machine is frozen or its kernel is dead", "a panic, a hypervisor, overheating",
        "arms the board's own watchdog where it has one; stops when it runs again",
        "the robot drives until somebody stops it, where the board has no watchdog",
        "a relay that needs a living signal; a hardware watchdog of the machine", ("WATCHDOG-1", "TIME-1"),
    ),
    Hazard(
        "H-BYPASS", OUTSIDE, "The board drives by itself",
        "a gamepad or Bluetooth at the board, another host on its bus",
        "names who else commands each board (`failstop doctor`), and writes zero again and again while it is stopped",
        "motion between two zeros", "switch it off in the firmware", ("BOARD-1",),
    ),
    Hazard(
        "H-SLOPE", OF_STOPPING, "The robot rolls after a stop", "a slope, a push, a board that lets its motors coast",
        f"{NOTHING_HELPS}: wheels that are told zero do not hold a robot whose board does not brake",
        "the robot rolls", "brakes; a gear that locks itself; no slopes",
    ),
    Hazard(
        "H-COASTS", OF_STOPPING, "The robot stops later than its times say",
        "a board that coasts instead of braking, a load",
        "shows the stopping distance that follows from limits, times and a deceleration",
        "the distance is as right as the deceleration that was measured", "lower limits; measure with the load on",
        ("DISTANCE-1",),
    ),
    Hazard(
        "H-DROPS", OF_STOPPING, "The arm drops what it holds", "a stop that takes the torque away; a supply that fails",
        "keeps the torque on at a stop and holds the joints where they are",
        "the power switch and a relay take the torque away",
        "a brake or spring in the arm; power for the arm by itself",
        ("ARM-1",),
    ),
    Hazard(
        "H-PLACE", OF_STOPPING, "The robot stops where it must not stand",
        "a stop in a doorway, in a lift, under a load, on a road",
        f"{NOTHING_HELPS}: a stop takes no account of the place", "the robot stands there until a person moves it",
        "a way to move it by hand; plan routes for it",
    ),
    Hazard(
        "H-BEHIND", OF_STOPPING, "The robot behind does not stop", "robots in a row, a person who walks behind",
        "stops every robot of a fleet when a person asks for it, each as soon as the network has brought that",
        "what follows has to keep its own distance",
        "distance; a light that shows a stop", ("ASK-1",),
    ),
    Hazard(
        "H-TIPS", OF_STOPPING, "The robot tips over, or its load slides, as it stops",
        "a high centre of mass, a fast drive",
        f"{NOTHING_HELPS}: a stop is as hard as the board makes it", "the robot tips over",
        "lower limits; a low and fixed load",
    ),
    Hazard(
        "H-OFTEN", OF_STOPPING, "It stops so often that people work around it",
        "false alarms of deadlines on a busy machine",
        "tells each cause with what to do; deadlines are longer than what a busy machine takes away",
        "people who enable without looking, or pull failstop out", "a machine with fewer things to do", ("CAUSE-1",),
    ),
    Hazard(
        "H-TRUST", PEOPLE, "A person trusts the screen and goes near", "a page that says STOPPED of a wheel that turns",
        "tells what is proved: written, acknowledged, observed; shows what is seen of the wheels now, and says when "
        "nobody sees them or a picture is old",
        "the wheels may turn although a stop is acknowledged", "look at the robot; the power switch", ("PROOF-1",
        "BOARD-1"),
    ),
    Hazard(
        "H-UNHEARD", PEOPLE, "A person's STOP does not reach the robot",
        "a phone without network, a page in the background, a gamepad out of reach",
        "says on the page that the robot is not heard; stops without its operator where `attend.required` is on",
        "where none is required, the robot does what its program wants", "the power switch; `attend.required`",
        ("ATTEND-1",),
    ),
    Hazard(
        "H-RESET", PEOPLE, "The wrong person resets", "somebody who does not see the robot clears its stop",
        "moves nothing at a reset; a reset that a newer stop came before is refused; an enable is a second decision",
        "a person who resets and enables without seeing the robot", "give the group and pairings to few", ("MOVE-2",
        "ACCESS-1"),
    ),
    Hazard(
        "H-SETTINGS", PEOPLE, "The settings are wrong", "signs, sizes or limits of another robot; a wrong board",
        "checks each value and each pair that must fit, asks the board what it is, tries each wheel in `failstop"
        " prove`",
        "a wrong size makes every speed wrong", "`failstop prove` after each change", ("LIMIT-1", "PROOF-1"),
    ),
    Hazard(
        "H-TWO", PEOPLE, "Two programs have the board", "a second service, the vendor's driver, a serial monitor",
        "takes the port for itself, and says who else has it; a second service is refused",
        "a program of root's that writes into the port beside it", "remove the vendor's driver", ("ACCESS-1",
        "BOARD-2"),
    ),
    Hazard(
        "H-TOOL", PEOPLE, "failstop itself is wrong",
        "a defect; an update; a part that was never tried on this machine",
        "is held by the proofs of these pages; what cannot happen in the core is checked as it runs, and stops",
        "defects that none of the proofs looks for", "`failstop prove` after each update; an emergency-stop circuit",
        ("MOVE-1", "MOVE-2", "CAUSE-1"),
    ),
    Hazard(
        "H-LATE-CUT", PEOPLE, "A person needs more than a software stop", "people near a robot that can hurt them",
        f"{NOTHING_HELPS}: failstop is no emergency stop", "everything that power does",
        "an emergency-stop circuit (ISO 13850)",
    ),
)  # fmt: skip
"""Every hazard that is known, each with claims or with NOTHING_HELPS."""
