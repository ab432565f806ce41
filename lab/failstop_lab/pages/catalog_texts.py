"""Texts of `journalctl -x` for each kind of event: the subject, and what it means and what to do, with @FIELD@ for a
field's value. systemd/failstop.catalog is made from this (`make docs`)."""

from __future__ import annotations

TEXTS = {
    "ready": (
        "@FAILSTOP_NAME@ is ready",
        "Every process runs, the port is open and the wheels were told to stop. Motion is disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "waiting": (
        "@FAILSTOP_NAME@ waits for @FAILSTOP_FOR@",
        "Motion can't be enabled until then, and the wheels are kept stopped.\n"
        "For the port: is the board plugged in and powered, and is device.path its path? For a process: the journal\n"
        "shows how it died.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    "stop": (
        "Stop latched: @FAILSTOP_REASON@",
        "The robot was stopped and stays stopped. Noticed by: @FAILSTOP_NOTICED_BY@. Written to the board by:\n"
        "@FAILSTOP_WRITTEN_BY@, FAILSTOP_LATENCY_US after the notice. If nobody wrote it, use the POWER SWITCH.\n"
        "The entry stop_outcome, which follows within two seconds, shows whether the board and the wheels obeyed.\n"
        "Nothing moves until somebody resets and enables.\n"
        "Next: fix the cause, then failstop reset and failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    "stop_again": (
        "Stopped again: @FAILSTOP_REASON@",
        "There was another cause while a stop was latched for: @FAILSTOP_LATCHED@. Look for the first cause.\n"
        "Next: journalctl -x FAILSTOP_EVENT=stop FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    "stop_also": (
        "The same stop, also noticed as: @FAILSTOP_REASON@",
        "Several causes came at once, or several processes noticed the same one. You need to do nothing about this\n"
        "entry; see the stop itself.",
    ),
    "stop_outcome": (
        "Did the stop reach the wheels? @FAILSTOP_REASON@",
        "Two proofs beyond the written bytes. acknowledged: the board answered a ping that was sent after the stop\n"
        "(FAILSTOP_ACKNOWLEDGED_US from the cause). observed: the board's reports or the IMU showed that the wheels\n"
        "came to rest (FAILSTOP_OBSERVED_MS). If a proof is missing, nobody knows; it does not mean that the wheels\n"
        "turn.\n"
        "Next: if the wheels were NOT seen still, use the POWER SWITCH; else failstop status --name @FAILSTOP_NAME@",
    ),
    "unstill": (
        "The wheels do not come to rest",
        "A stop was written for: @FAILSTOP_REASON@. The board still reports turning wheels, or the IMU still feels\n"
        "the robot shake: the board does not obey, or somebody pushes the robot. The stop is written again and again,\n"
        "and still.command is run if it is set.\n"
        "Next: use the POWER SWITCH. Software can do no more.",
    ),
    "wheels_turn": (
        "The wheels turn although they were told to stop, or they are still again",
        "Motion is disabled, so somebody pushes the robot, another program at the port drives it, or the board does\n"
        "not obey. FAILSTOP_BY is wheels where the board reports it, and then the stop is written again. IMU: the\n"
        "robot moves, or is being moved. Nothing is latched, and still.command is not run.\n"
        "Next: if nobody pushes the robot, use the POWER SWITCH; then failstop doctor --name @FAILSTOP_NAME@",
    ),
    "wheel_stands": (
        "The @FAILSTOP_WHEEL@ wheel does not turn although it should",
        "The command is @FAILSTOP_TOLD@ turns a second, but the board has reported @FAILSTOP_SEEN@ for 3 s. The wheel\n"
        "is stalled, or its motor or its encoder is unplugged. failstop does not stop the robot for this.\n"
        "Next: check that wheel, its cable and its encoder",
    ),
    "servo": (
        "@FAILSTOP_PART@: @FAILSTOP_WRONG@",
        "A servo of the bus reports an error, or does not answer while others do. Motion can't be enabled while a\n"
        "wheel's servo does not answer, because that wheel would not turn while the others do.\n"
        "Next: check that servo's plug, its power, its id and whether something blocks it, then failstop status",
    ),
    "died": (
        "@FAILSTOP_PROCESS@ died",
        "Process @FAILSTOP_PID@ @FAILSTOP_HOW@. Its death has stopped the robot; this entry adds how it died.\n"
        "Next: journalctl _PID=@FAILSTOP_PID@, and coredumpctl info @FAILSTOP_PID@ if it crashed",
    ),
    "restarting": (
        "@FAILSTOP_PROCESS@ is restarted",
        "It starts in @FAILSTOP_WAIT_S@ s. A restarted process never enables motion; somebody must do that.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    "down": (
        "@FAILSTOP_PROCESS@ is down",
        "It died too often (settings restart.deaths, restart.window_s). The wheels are told to stop and the status is\n"
        "served, but motion can't be enabled before a reset, which restarts the process. The gate, which hears\n"
        "resets, is restarted after a minute.\n"
        "Next: journalctl FAILSTOP_EVENT=died FAILSTOP_PROCESS=@FAILSTOP_PROCESS@; fix the cause; then\n"
        "failstop reset --name @FAILSTOP_NAME@",
    ),
    "start_failed": (
        "@FAILSTOP_PROCESS@ could not be started",
        "@FAILSTOP_REASON@. failstop tries again twice a second, and motion can't be enabled until it works.\n"
        "Next: check what the computer has run out of: memory, processes, file descriptors",
    ),
    "not_started": (
        "@FAILSTOP_NAME@ could not be started",
        "@FAILSTOP_REASON@. failstop writes a stop as it begins, but from now on nothing watches the robot.\n"
        "Next: fix the reason, then start the service again",
    ),
    "fenced": (
        "@FAILSTOP_PROCESS@ hung and was fenced",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, so it was killed and can write nothing more.\n"
        "The times are from the notice to the kill and to the end of the process; for the port owner also to the\n"
        "stops on the supervisor's own descriptor, one after the kill and one after the end.\n"
        "Next: was the machine overloaded or frozen? failstop doctor --name @FAILSTOP_NAME@ checks real-time rights",
    ),
    "starved": (
        "The machine did not run @FAILSTOP_PROCESS@",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, beyond its deadline, while it wanted to run: other programs had\n"
        "the processor, or its memory was on the disk. failstop did not stop the robot for this and ended no process,\n"
        "because motion was disabled or a stop was already latched. This is logged at most every ten seconds; so far\n"
        "it has happened @FAILSTOP_TIMES@ times.\n"
        "Next: give the service real-time rights (failstop doctor --name @FAILSTOP_NAME@ has the command), or\n"
        "see what else keeps the computer busy",
    ),
    "suspended": (
        "The supervisor was suspended",
        "A signal suspended it for @FAILSTOP_SILENT_MS@ ms, as Ctrl-Z in its terminal does, so nobody watched the\n"
        "other processes. This stopped nothing, because motion was disabled or a stop was latched.\n"
        "Next: leave the service running in its terminal, or end it with Ctrl-C",
    ),
    "enabled": (
        "Motion was enabled by @FAILSTOP_WHO@",
        "From now on commands move the wheels. The client itself gave its name and pid.\n"
        "Next: failstop disable --name @FAILSTOP_NAME@ disables motion again",
    ),
    "disabled": (
        "Motion was disabled",
        "The client FAILSTOP_WHO did it, or failstop did it because of FAILSTOP_REASON, for example an interlock that\n"
        "was lost. The wheels were stopped; nothing is latched.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "reset": (
        "The latched stop was cleared by @FAILSTOP_WHO@",
        "A reset clears the latch and nothing else: motion stays disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "limit": (
        "@FAILSTOP_WHO@ has changed the speed limit",
        "It limits every driver until somebody changes it or the service ends.\n"
        "Next: failstop limit 100 --name @FAILSTOP_NAME@ lifts it",
    ),
    "refused": (
        "@FAILSTOP_WHO@ was refused: @FAILSTOP_VERB@",
        "The reason: @FAILSTOP_REASON@. Nothing was changed.\nNext: failstop status --name @FAILSTOP_NAME@",
    ),
    "ignored": (
        "Commands of @FAILSTOP_WHO@ are ignored",
        "It sends commands as the source @FAILSTOP_SOURCE@, which programs can't use: the settings do not have it, or\n"
        "it is the board's gamepad.\n"
        "Next: fix the program, or declare a source under [sources] and restart the service",
    ),
    "said": (
        "@FAILSTOP_WHO@ reports about itself",
        "What a client says it sees, and what it says is wrong, in its own words.\n"
        "Next: failstop why --name @FAILSTOP_NAME@ shows why the wheels are stopped, and what each client reports",
    ),
    "driver_silent": (
        "@FAILSTOP_WHO@ stopped sending commands while it drove",
        "It sent no command for FAILSTOP_SILENT_MS, which is longer than the timeout of the source\n"
        "@FAILSTOP_SOURCE@, so the wheels were stopped. Nothing is latched: if it resumes, the robot moves again.\n"
        "Next: does that program still run, and does it send its commands often enough?",
    ),
    "driver_gone": (
        "The driver @FAILSTOP_WHO@ has died",
        "It crashed or was killed, so the wheels were stopped at once and motion was disabled: nothing drives until\n"
        'somebody enables it. With gate.driver_death = "stay" motion stays enabled.\n'
        "Next: that program's own log; coredumpctl list, if it crashed; failstop enable --name @FAILSTOP_NAME@",
    ),
    "driver_ended": (
        "@FAILSTOP_WHO@ ended its command",
        "The program that drove ended cleanly, or a person let go of the key, so the wheels were stopped. Nothing is\n"
        "wrong, and nothing is latched.",
    ),
    "device_lost": (
        "The board's port is gone: @FAILSTOP_PATH@",
        "It was unplugged, lost its power, or was reset. If the wheels turn now, only the board itself or the POWER\n"
        "SWITCH can stop them. failstop writes the stop the moment the port is back.\n"
        "Next: use the POWER SWITCH if the wheels turn; check the cable; journalctl -k shows what the kernel saw",
    ),
    "device_back": (
        "The board's port is back: @FAILSTOP_PATH@",
        "The first bytes on it were a stop, unless the entry says that no stop could be written yet. A latched stop\n"
        "stays latched. If the entry says that this may not be the board, the stop proves nothing until the device\n"
        "answers. In both cases use the POWER SWITCH if the wheels turn.\n"
        "Next: failstop reset, then failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    "restarted": (
        "The board restarted: @FAILSTOP_SIGN@",
        "It has forgotten its speed and its settings. If motion is enabled, failstop latches a stop.\n"
        "Next: check the battery, the motors' supply and the board's plugs, then failstop reset",
    ),
    "link": (
        "The board's link is @FAILSTOP_STATE@",
        "unproven: it has not answered a ping since the port was opened, so nobody knows whether it hears.\n"
        "alive: it answers.\n"
        "deaf: it has stopped answering, or it obeys zero although motion is written to it.\n"
        "silent: it has stopped reporting. It lost power, or it hangs, or the wire from it is broken; failstop can't\n"
        "tell these apart.\n"
        "Deaf and silent stop the robot while motion is enabled: then use the POWER SWITCH.\n"
        "unheard: nothing has answered since the port came back, so it may be another device: use the POWER SWITCH.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    "rights": (
        "Missing rights: @FAILSTOP_WHAT@",
        "On a busy computer stops come later, and some come without a cause. The entry's text has the command that\n"
        "grants the rights; the systemd unit grants them with LimitRTPRIO=40 and LimitMEMLOCK=infinity.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    "pad": (
        "The gamepad",
        "Its mode changed, one of its buttons stopped the robot, or MODE was held to reset. For a button, the entry\n"
        "has the last raw frames, which show whether somebody pressed it or the gamepad sent garbage.\n"
        "Next: failstop status --name @FAILSTOP_NAME@ shows the mode",
    ),
    "arm": (
        "The arm",
        "A servo does not answer, or answers again; or a servo is hot or low on supply, and may let go of what the\n"
        "arm holds; or nobody uses the arm, so it is about to go to its tuck pose.\n"
        "Next: failstop arm --name @FAILSTOP_NAME@ shows each joint",
    ),
    "charger": (
        "The charger is @FAILSTOP_STATE@",
        "failstop concludes this from a jump of the battery's voltage to @FAILSTOP_BATTERY_MV@ mV.\n"
        "Next: if it is wrong, change battery.step_mv (failstop config shows it)",
    ),
    "odd": (
        "The board reports an impossible @FAILSTOP_WHAT@",
        "It was @FAILSTOP_VALUE@. The value counts as not reported, and later ones of this kind are not logged.\n"
        "Next: check the sensor's wiring or, for your own board, how its description reads the value. On a bench with\n"
        "USB power alone, a battery of about 0 V is normal.",
    ),
    "scan": (
        "The obstacle sensor is @FAILSTOP_STATE@",
        "While it is silent, programs can't move the wheels (no scan). Nothing is latched: motion resumes by itself,\n"
        "from zero speed, when the sensor delivers again.\n"
        "Next: does the sensor's driver run, and does its client call sensed()?",
    ),
    "scale": (
        "The wheels may turn at another speed than commanded",
        "Either no turn of a wheel has confirmed the board's unit of speed, so speeds are capped until one does; or\n"
        "the board's reports or the gyro show another speed than the commanded one. The message names the setting.\n"
        "Next: failstop setup measures board.per_rps by a turn of a wheel",
    ),
    "gyro": (
        "The gyro's calibration",
        "The gyro's bias, measured at the start; or the robot was not at rest, so it could not be measured.\n"
        "Next: after `not stationary`, leave the robot at rest and restart the service",
    ),
    "disk": (
        "A file of the service",
        "A file in the state directory could not be read or written, or can be again. Stops do not depend on it.\n"
        "Next: df and ls -ld on the directory that the entry names",
    ),
    "command": (
        "still.command @FAILSTOP_STATE@",
        "The command in your settings that runs when the wheels do not come to rest.\n"
        "Next: check that it did its work; its output is in the journal too",
    ),
    "left_out": (
        "@FAILSTOP_COUNT@ events of the kind @FAILSTOP_OF@ were left out",
        "At most 64 KiB a minute are logged of each kind, and 8 KiB of all stop requests while a stop is latched;\n"
        "further ones are only counted. Every stop was still written.\n"
        "Next: journalctl FAILSTOP_EVENT=@FAILSTOP_OF@ FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    "note": (
        "A remark",
        "An event that fits no other kind; the entry's text says everything.",
    ),
    "incident": (
        "The record of a stop",
        "The last minute before a latched stop, and what followed, was saved to a file; or the reason why it was not.\n"
        "Next: failstop incident list --name @FAILSTOP_NAME@",
    ),
    "stopping": (
        "@FAILSTOP_NAME@ is stopping",
        "Somebody told it to end. It writes the stop, then ends its processes, then writes the stop once more.",
    ),
    "stopped": (
        "@FAILSTOP_NAME@ has ended",
        "From now on nothing watches the robot. acknowledged: the board answered a ping that was sent after the\n"
        "first of the two stops (FAILSTOP_ACKNOWLEDGED_US from that). If it had answered before and did NOT\n"
        "acknowledge this one, or if the second could NOT be written, the exit code is 1: look at the wheels.\n"
        "unproven: it has not answered since its port was opened, so nobody knows whether it hears.\n"
        "Next: failstop stop writes a stop even without a service; systemctl start starts the service",
    ),
}
