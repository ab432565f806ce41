"""Requests of a paired device while another one takes its time: an enable that moves an arm to its drive pose."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import pytest

from failstop.web.hold import LATE
from failstop_lab.trial import Trial, wait_for, write_settings
from tests.support.arm_settings import ARM
from tests.web.parts import Web
from tests.web.viewer import Viewer

pytestmark = pytest.mark.page


def test_a_disable_gives_up_an_enable_that_is_under_way(tmp_path: Path) -> None:
    settings, pairing = tmp_path / "arm.toml", tmp_path / "web.toml"
    write_settings(str(settings), ARM)
    pairing.write_text('[web]\npairing = "on"\ntls = "on"\n')
    with (
        Trial(f"workers-{os.getpid()}", ("--config", str(settings))) as trial,
        Web(trial.name, "--config", str(pairing), state=trial.state) as web,
    ):
        anna = web.pair()
        answers: list[dict[str, Any]] = []

        def hold() -> None:
            with Viewer(web, anna) as viewer:
                while (found := viewer.hold("enable"))["said"] == LATE:
                    pass  # a busy machine held it up
                answers.append(found)

        asking = threading.Thread(target=hold)
        asking.start()
        wait_for("the arm to move", lambda: trial.robot.state.arm and trial.robot.state.arm.moving)
        assert web.post("/api/disable", headers=anna) == (200, {"said": "motion disabled"})
        asking.join()
        assert [(each["done"], each["said"]) for each in answers] == [(False, "motion disabled")]
        assert not trial.robot.state.enabled
