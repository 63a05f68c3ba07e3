"""Where a broker is and how to get in: addresses, TLS, and credentials that no scene holds."""

from __future__ import annotations

import os
import ssl
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import urlsplit

from plotfeed.proto.errors import PlotfeedError

USERNAME_VARIABLE = "PLOTFEED_MQTT_USERNAME"
PASSWORD_VARIABLE = "PLOTFEED_MQTT_PASSWORD"  # noqa: S105 - its name, not its value
DEFAULT_PORTS = {"mqtt": 1883, "mqtts": 8883}
VERSIONS = {"5": (5,), "3.1.1": (4,), "any": (5, 4)}
"""MQTT by its own names; 4 is how 3.1.1 is numbered in the protocol."""


class AddressError(PlotfeedError):
    """What should be the address of a broker, or a key to it, and is not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Certificates and credentials. None of it is ever shown."""

    ca_file: Path | None = None
    """Who vouches for the broker; without it, whom the system trusts."""
    certificate_file: Path | None = None
    key_file: Path | None = None
    """Of the client, where the broker asks for one."""
    username: str | None = None
    password: str | None = field(default=None, repr=False)

    def tls_context(self) -> ssl.SSLContext:
        """For a connection to a broker with TLS; raises `AddressError`."""
        files = {"CA file": self.ca_file, "client certificate": self.certificate_file}
        try:
            context = ssl.create_default_context(cafile=self.ca_file)
            if self.certificate_file is not None:
                # A key with a passphrase is refused: there is nobody to ask.
                context.load_cert_chain(self.certificate_file, self.key_file, lambda: "")
        except (OSError, ValueError) as error:
            named = ", ".join(f"{name} {path}" for name, path in files.items() if path is not None)
            raise AddressError(f"{named}: {_reason(error)}") from None
        return context

    def with_credentials(
        self, file: Path | None, environment: Mapping[str, str] = os.environ
    ) -> Access:
        """With user name and password from the environment, else from a file; `AddressError`."""
        if USERNAME_VARIABLE in environment:
            return replace(
                self,
                username=environment[USERNAME_VARIABLE],
                password=environment.get(PASSWORD_VARIABLE),
            )
        if file is None:
            return self
        expected = AddressError(f"{file}: expected TOML with username and password, both text")
        try:
            found = tomllib.loads(file.read_text())
        except (OSError, UnicodeDecodeError) as error:
            raise AddressError(f"{file}: {_reason(error)}") from None
        except tomllib.TOMLDecodeError:
            raise expected from None  # its own message might quote the password
        username, password = found.get("username"), found.get("password")
        if not isinstance(username, str) or not isinstance(password, str | None):
            raise expected
        return replace(self, username=username, password=password)


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """Where a broker is, and which versions of MQTT to try, one after the other."""

    host: str
    port: int = DEFAULT_PORTS["mqtt"]
    versions: tuple[int, ...] = VERSIONS["any"]
    tls: bool = False
    access: Access = Access()

    @classmethod
    def parse(
        cls, url: str, *, versions: tuple[int, ...] = VERSIONS["any"], access: Access | None = None
    ) -> BrokerAddress:
        """From mqtt://HOST[:PORT], or mqtts:// for TLS; raises `AddressError`."""
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError:
            raise _no_address(url) from None
        if parts.username is not None:
            raise AddressError(
                "a broker's address holds no credentials: give them as "
                f"{USERNAME_VARIABLE} and {PASSWORD_VARIABLE}, or in a file"
            )
        rest = parts.path.strip("/") + parts.query + parts.fragment
        if parts.scheme not in DEFAULT_PORTS or not parts.hostname or rest or port == 0:
            raise _no_address(url)
        return cls(
            parts.hostname,
            port or DEFAULT_PORTS[parts.scheme],
            versions,
            parts.scheme == "mqtts",
            access or Access(),
        )

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


def _no_address(url: str) -> AddressError:
    return AddressError(f"broker {url!r}: expected mqtt://HOST:PORT, or mqtts:// for TLS")


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
