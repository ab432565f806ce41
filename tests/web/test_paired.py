"""Paired devices: who may, who may not any more, and what is kept. Over real HTTPS, beside a real service."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from failstop.web import devices
from failstop_lab.trial import Trial, wait_for
from tests.web.parts import Web
from tests.web.viewer import Viewer

SETTINGS = '[web]\npairing = "on"\ntls = "on"\n'


@pytest.fixture(scope="module")
def anna(web: Web) -> dict[str, str]:
    """The headers of a device that was paired by the code of `failstop web pair`."""
    said = web.command("pair").stdout
    code = next(line.split()[1] for line in said.splitlines() if line.startswith("code"))
    return web.pair(code=code)


def test_a_paired_device_enables_disables_and_is_told_of_a_refusal(
    trial: Trial, web: Web, anna: dict[str, str]
) -> None:
    """test_sockets.py holds for the other verbs."""
    assert web.post("/api/stop", headers=anna)[0] == 200
    wait_for("the latch", lambda: trial.robot.state.estop)
    assert "Anna's phone (page)" in str(trial.robot.state.estop)
    with Viewer(web, anna) as viewer:
        found = viewer.hold("enable", epoch=trial.robot.state.epoch)
        assert not found["done"]
        assert "latched" in found["said"]
        wait_for("a reset to be taken", trial.reset)
        assert viewer.hold("enable", epoch=trial.robot.state.epoch)["said"] == "motion enabled"
    assert trial.robot.state.enabled
    assert web.post("/api/disable", headers=anna)[0] == 200
    assert not trial.robot.state.enabled


def test_a_paired_device_limits_the_speed(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    assert web.post("/api/limit", {"percent": 25}, anna) == (200, {"said": "speed limited to 25 % of the settings'"})
    assert trial.robot.state.speed_limit == 0.25
    assert web.get("/api/state")["view"]["limit"] == 25
    for wrong in ({}, {"percent": "100"}, {"percent": 3}, {"percent": 200}):
        assert web.post("/api/limit", wrong, anna)[0] == 409
    assert trial.robot.state.speed_limit == 0.25
    assert web.post("/api/limit", {"percent": 10})[0] == 401
    assert trial.robot.state.speed_limit == 0.25
    trial.robot.limit_speed(1.0)


def test_a_page_without_a_file_goes_by_the_settings_of_the_running_service(trial: Trial, tmp_path: Path) -> None:
    """Whatever file that was started with: the installed one may say otherwise, or not exist."""
    with Web(trial.name, state=str(tmp_path)) as web:
        assert web.url.startswith("https://")
        assert web.command("pair").returncode == 0
        web.process.terminate()
        assert web.process.stdout is not None
        assert "settings: the settings of the running service" in web.process.stdout.read()


def test_where_pairing_is_off_the_settings_that_say_so_are_named(tmp_path: Path) -> None:
    """No service runs: the defaults count, and then a file."""
    with Web("pairs-nobody", state=str(tmp_path)) as web:
        said = web.command("pair").stderr
    assert (
        "pairing is switched off (the defaults, because no settings file was found): start the page with --config"
        in said
    )
    path = tmp_path / "settings.toml"
    path.write_text('[web]\npairing = "off"\n')
    with Web("pairs-nobody", "--config", str(path), state=str(tmp_path)) as web:
        said = web.command("pair").stderr
    assert f'pairing is switched off ({path}): set web.pairing = "on" in {path}, and restart the page' in said


@pytest.mark.parametrize(
    "cookie", ["", "{its}=", "{its}=guess", "failstop-{name}=guess", "__Host-failstop=guess", "failstop=guess"]
)
def test_nobody_else_may(trial: Trial, web: Web, anna: dict[str, str], cookie: str) -> None:
    sent = cookie.format(its=anna["Cookie"].partition("=")[0], name=web.name)
    for verb in ("disable", "limit", "forget"):
        assert web.post(f"/api/{verb}", headers={"Cookie": sent})[0] == 401
    assert not trial.robot.state.enabled


def test_the_hash_of_a_token_is_no_token(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    kept = json.loads((Path(trial.state) / "devices.json").read_text())
    token = anna["Cookie"].partition("=")[2]
    assert devices.digest_of(token) in {row["digest"] for row in kept}
    assert token not in json.dumps(kept)
    for row in kept:
        assert web.post("/api/disable", headers={"Cookie": f"__Host-failstop-{web.name}={row['digest']}"})[0] == 401


def test_what_is_kept_is_its_own(trial: Trial) -> None:
    for name in ("devices.json", "key.pem", "control"):
        assert stat.S_IMODE(os.stat(Path(trial.state) / name).st_mode) & 0o077 == 0, name


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(web: Web) -> None:
    status, headers, _ = web.ask("POST", "/api/pair", {"code": web.code(), "name": "Bert"})
    assert status == 200
    cookie = headers["set-cookie"]
    for word in (f"__Host-failstop-{web.name}=", "HttpOnly", "Secure", "SameSite=Strict", "Path=/"):
        assert word in cookie
    assert "Domain" not in cookie
    assert "Max-Age=31536000" in cookie
    assert "expires" not in cookie.lower(), "by the robot's clock, which may be years behind the phone's"


def test_a_stolen_cookie_ends_with_its_device(web: Web) -> None:
    bert = web.pair("Bert's tablet")
    assert web.ask("GET", "/api/me", headers=bert)[2] == (
        b'{"pairing": true, "device": "Bert\'s tablet", "drive": false, "lacks": ""}'
    )
    listed = web.command("devices").stdout
    identity = next(line.split()[0] for line in listed.splitlines() if "Bert's tablet" in line)
    assert web.command("revoke", identity).returncode == 0
    assert web.post("/api/disable", headers=bert)[0] == 401
    assert web.command("revoke", identity).returncode == 1


def test_a_device_forgets_itself(web: Web) -> None:
    carl = web.pair("Carl")
    assert web.post("/api/forget", headers=carl)[0] == 200
    assert web.post("/api/forget", headers=carl)[0] == 401


def test_a_room_of_phones_pairs_one_after_the_other(web: Web) -> None:
    for number in range(6):
        assert web.post("/api/forget", headers=web.pair(f"phone {number}"))[0] == 200


def test_a_code_is_used_once_and_guesses_are_limited(web: Web) -> None:
    code = web.code()
    said = [web.ask("POST", "/api/pair", {"code": "0000-0000", "name": "Eve"}) for _ in range(8)]
    assert {status for status, _, _ in said} == {403, 429}
    assert 429 in {status for status, _, _ in said}, "and no more are heard"
    assert web.ask("POST", "/api/pair", {"code": code, "name": "Eve"})[0] == 429
    assert b"Eve" not in web.command("devices").stdout.encode()


def test_attending_needs_a_paired_device(web: Web) -> None:
    with Viewer(web) as stranger:
        stranger.send(attend=True)
        while "attend" not in (found := stranger.next()):
            assert "nonce" not in found
        assert "not paired" in found["attend"]


@pytest.mark.parametrize("identity", ["nothing", "..", "%2e%2e%2fkey.pem", "--help", "a" * 200])
def test_an_incident_that_there_is_not(web: Web, identity: str) -> None:
    assert web.ask("GET", f"/api/incidents/{identity}/story")[0] == 404
    assert web.ask("GET", f"/api/incidents/{identity}/picture")[0] == 404
