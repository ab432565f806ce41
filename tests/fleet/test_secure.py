"""A broker that asks for a password, and one with TLS."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.fleet import FleetError
from failstop.fleet.broker import NOT_YET, read_secret

from .scene import MOSQUITTO, Listener, Mosquitto, mosquitto, pump

CURVE = ("ec", "-pkeyopt", "ec_paramgen_curve:prime256v1")
OPENSSL = shutil.which("openssl")
PASSWORDS = shutil.which("mosquitto_passwd")
leaves_sockets = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""paho-mqtt leaves a socket whose handshake failed to the garbage collector."""
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto: `make fleet` installs it")


def openssl(*words: str) -> None:
    assert OPENSSL is not None
    subprocess.run([OPENSSL, *words], check=True, capture_output=True)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority, the broker's certificate, a client's, and an authority that nobody knows."""
    if OPENSSL is None:
        pytest.skip("needs openssl")
    place = tmp_path_factory.mktemp("certificates")
    for name in ("ca", "strange"):
        key, certificate = str(place / f"{name}.key"), str(place / f"{name}.pem")
        openssl("req", "-x509", "-newkey", *CURVE, "-nodes", "-days", "2", "-subj", f"/CN={name}",
                "-keyout", key, "-out", certificate)  # fmt: skip
    for name, alternative in (("broker", "IP:127.0.0.1"), ("elsewhere", "DNS:elsewhere"), ("client", "DNS:client")):
        key, request, extra = (str(place / f"{name}.{kind}") for kind in ("key", "csr", "ext"))
        openssl("req", "-newkey", *CURVE, "-nodes", "-subj", f"/CN={name}", "-keyout", key, "-out", request)
        Path(extra).write_text(f"subjectAltName={alternative}\n")
        openssl("x509", "-req", "-in", request, "-CA", str(place / "ca.pem"), "-CAkey", str(place / "ca.key"),
                "-CAcreateserial", "-days", "2", "-extfile", extra, "-out", str(place / f"{name}.pem"))  # fmt: skip
    return place


def secured(folder: Path, certificates: Path, name: str, *lines: str) -> tuple[str, ...]:
    ca, own, key = (str(certificates / file) for file in ("ca.pem", f"{name}.pem", f"{name}.key"))
    return (f"cafile {ca}", f"certfile {own}", f"keyfile {key}", *(lines or ("allow_anonymous true",)))


@pytest.fixture
def tls(tmp_path: Path, certificates: Path) -> Iterator[Mosquitto]:
    if MOSQUITTO is None:
        pytest.skip("needs mosquitto: `make fleet` installs it")
    own = ("allow_anonymous true", "require_certificate true")
    with mosquitto(tmp_path, *secured(tmp_path, certificates, "broker", *own)) as running:
        yield running


def outcome(broker: Mosquitto, **changed: object) -> str:
    """Empty when it connects, else why not."""
    listener = Listener(broker.settings(**changed))
    pump("an outcome", lambda: listener.broker.problem != NOT_YET, listener)
    found = listener.broker.problem
    listener.broker.close()
    return found


def own(certificates: Path) -> dict[str, object]:
    client = {"cert_file": "client.pem", "cert_key_file": "client.key", "ca_file": "ca.pem"}
    return {"broker__tls": "on", **{f"broker__{key}": str(certificates / file) for key, file in client.items()}}


def test_tls_with_a_certificate_of_ones_own(tls: Mosquitto, certificates: Path) -> None:
    listener = Listener(tls.settings(**own(certificates)))
    pump("the connection", lambda: not listener.broker.problem, listener)
    payload = b"x" * 100_000  # more than one record of TLS
    listener.broker.say("a/b", payload)
    pump("its own message", lambda: listener.last.get("a/b") == payload, listener)
    listener.broker.close()


@leaves_sockets
def test_an_authority_that_nobody_knows(tls: Mosquitto, certificates: Path) -> None:
    given = {**own(certificates), "broker__ca_file": str(certificates / "strange.pem")}
    assert "certificate verify failed" in outcome(tls, **given).lower()


def test_without_tls_where_there_is_tls(tls: Mosquitto) -> None:
    assert outcome(tls)


@needs_broker
@leaves_sockets
def test_a_certificate_for_another_host(tmp_path: Path, certificates: Path) -> None:
    with mosquitto(tmp_path, *secured(tmp_path, certificates, "elsewhere")) as broker:
        assert "certificate verify failed" in outcome(broker, **own(certificates)).lower()


@needs_broker
@pytest.mark.skipif(PASSWORDS is None, reason="needs mosquitto_passwd")
def test_a_password(tmp_path: Path) -> None:
    assert PASSWORDS is not None
    stored, right, wrong = (tmp_path / name for name in ("stored", "right", "wrong"))
    subprocess.run([PASSWORDS, "-b", "-c", str(stored), "robot-1", "open sesame"], check=True, capture_output=True)
    right.write_text("open sesame\n")
    wrong.write_text("open barley\n")
    for path in (right, wrong):
        path.chmod(0o600)
    with mosquitto(tmp_path, "allow_anonymous false", f"password_file {stored}") as broker:
        given: dict[str, object] = {"broker__user": "robot-1"}
        assert outcome(broker, broker__password_file=str(right), **given) == ""
        for refused in (outcome(broker, broker__password_file=str(wrong), **given), outcome(broker)):
            assert "refuses" in refused
            assert "uthori" in refused


def test_a_password_that_everybody_may_read(tmp_path: Path) -> None:
    path = tmp_path / "password"
    path.write_text("x")
    path.chmod(0o644)
    with pytest.raises(FleetError, match="chmod 600"):
        read_secret(str(path))
    with pytest.raises(FleetError, match="No such file"):
        read_secret(str(tmp_path / "none"))


def test_certificates_that_are_not_there(tmp_path: Path) -> None:
    from failstop.fleet.settings import FleetSettings

    with pytest.raises(FleetError, match=r"broker\.ca_file"):
        Listener(FleetSettings({"broker.tls": "on", "broker.ca_file": str(tmp_path / "none")}))
