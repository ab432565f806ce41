"""Storage: the page's files, which are the paired devices and its certificate, and where the commands find them."""

from __future__ import annotations

import os
import secrets
import ssl
import subprocess
import time
from hashlib import sha256
from typing import NoReturn

from failstop.api.errors import FailstopError
from failstop.files import durable, root
from failstop.web.addresses import own_addresses
from failstop.web.devices import Devices

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

SYSTEM_BASE = "/var/lib/failstop-web"
DEVICES = "devices.json"
KEY = "key.pem"
CERTIFICATE = "certificate.pem"
CONTROL = "control"
DAYS = 825
"""How long a certificate is valid, days: as long as browsers accept."""
RENEW_S = 30 * 86400.0
OPENSSL_S = 30.0


def folder(name: str, environ: Mapping[str, str]) -> str:
    """The folder in which the page of a service keeps its files: systemd's $STATE_DIRECTORY, else a folder below
    $XDG_STATE_HOME or ~/.local/state."""
    if given := environ.get("STATE_DIRECTORY", "").split(":")[0]:
        return given
    home = environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return os.path.join(home, "failstop", name, "web")


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """The folders in which the page of that service may be: one that this user has started, or the system's."""
    return [folder(name, environ), os.path.join(root.at(SYSTEM_BASE), name)]


class Storage:
    """The folder of a running page. Only this page writes there."""

    def __init__(self, place: str) -> None:
        """Raises FailstopError."""
        self.place = place
        try:
            os.makedirs(place, exist_ok=True)
            os.chmod(place, 0o700)
        except OSError as error:
            _fail(place, error)

    def path(self, name: str) -> str:
        """The path of a file in the folder."""
        return os.path.join(self.place, name)

    def devices(self) -> Devices:
        """The paired devices. Raises FailstopError if the file can't be read, because nobody must be locked out, or let
        in, without a message."""
        try:
            with open(durable.open_own(self.path(DEVICES)), "rb") as file:
                return Devices.load(file.read())
        except FileNotFoundError:
            return Devices()
        except OSError as error:
            _fail(self.path(DEVICES), error)
        except ValueError as error:
            raise FailstopError(f"{self.path(DEVICES)}: {error}: remove it, and pair your devices again") from None

    def keep(self, devices: Devices) -> None:
        """Save the devices, whole or not at all. Raises FailstopError."""
        self._write(DEVICES, devices.dump())

    def keep_fewer(self, devices: Devices) -> None:
        """Save the devices after one was revoked. If the disk is full, the old file is overwritten, which needs no
        room. A crash in the middle of that leaves a damaged file, which lets nobody in. Raises FailstopError."""
        try:
            self.keep(devices)
        except FailstopError as error:
            try:
                fd = durable.open_own(self.path(DEVICES), os.O_WRONLY)
                try:
                    data = devices.dump().ljust(os.fstat(fd).st_size)
                    if os.pwrite(fd, data, 0) != len(data):
                        raise error
                    os.fsync(fd)
                finally:
                    os.close(fd)
            except OSError:
                raise error from None

    def _write(self, name: str, data: bytes) -> None:
        draft = f"{self.path(name)}.{secrets.token_hex(4)}"
        before = os.umask(0o077)
        try:
            durable.write_draft(draft, data)
            durable.publish(draft, self.path(name))
        except OSError as error:
            _fail(self.path(name), error)
        finally:
            os.umask(before)

    def tls(self, names: list[str]) -> ssl.SSLContext:
        """The context for HTTPS with the page's own certificate, which is made at the first start, and again before it
        expires. Raises FailstopError."""
        if not self._valid():
            self._make(names, own_addresses())
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.path(CERTIFICATE), self.path(KEY))
        except (OSError, ssl.SSLError) as error:
            raise FailstopError(f"{self.path(CERTIFICATE)}: {error}: remove it, and a new one is made") from None
        return context

    def fingerprint(self) -> str:
        """The SHA-256 of the certificate, as browsers show it; empty if there is no certificate."""
        try:
            with open(self.path(CERTIFICATE), encoding="ascii") as file:
                found = sha256(ssl.PEM_cert_to_DER_cert(file.read())).hexdigest().upper()
        except (OSError, ValueError):
            return ""
        return ":".join(found[at : at + 2] for at in range(0, len(found), 2))

    def _valid(self) -> bool:
        """True if there is a certificate that stays valid for a while."""
        if not (os.path.exists(self.path(KEY)) and os.path.exists(self.path(CERTIFICATE))):
            return False
        words = ("x509", "-in", self.path(CERTIFICATE), "-noout", "-checkend", str(int(RENEW_S)))
        return _openssl(*words).returncode == 0

    def _make(self, names: list[str], addresses: list[str]) -> None:
        others = ",".join([*(f"DNS:{name}" for name in names), *(f"IP:{address}" for address in addresses)])
        draft = self.path(f"{KEY}.{secrets.token_hex(4)}")
        before = os.umask(0o077)
        try:
            made = _openssl(
                *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-sha256"),
                *("-days", str(DAYS), "-subj", f"/CN=failstop {time.strftime('%Y-%m-%d')}"),
                *("-addext", f"subjectAltName={others}", "-addext", "basicConstraints=critical,CA:FALSE"),
                *("-addext", "extendedKeyUsage=serverAuth", "-keyout", draft, "-out", f"{draft}.crt"),
            )
            if made.returncode:
                raise FailstopError(f"openssl made no certificate: {made.stderr.strip()[-300:]}")
            durable.publish(draft, self.path(KEY))
            durable.publish(f"{draft}.crt", self.path(CERTIFICATE))
        except OSError as error:
            _fail(self.path(CERTIFICATE), error)
        finally:
            os.umask(before)


def _openssl(*words: str) -> subprocess.CompletedProcess[str]:
    """Run openssl. Raises FailstopError if it is not installed."""
    try:
        return subprocess.run(("openssl", *words), capture_output=True, text=True, timeout=OPENSSL_S, check=False)
    except FileNotFoundError:
        raise FailstopError("HTTPS needs the program openssl (Debian, Ubuntu: apt install openssl)") from None
    except subprocess.TimeoutExpired:
        raise FailstopError(f"openssl did not end within {OPENSSL_S:g} s") from None


def _fail(path: str, error: OSError) -> NoReturn:
    raise FailstopError(f"{path}: {error.strerror}") from None
