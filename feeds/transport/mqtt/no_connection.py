"""Why there is no connection to a broker, in words and without secrets."""

from __future__ import annotations

import asyncio
import ssl

from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.gmqtt_client import reason_name, refusal_code
from plotfeed.proto.errors import PlotfeedError

VERSION_NAMES = {5: "5", 4: "3.1.1"}
UNKNOWN_VERSION = frozenset({1, 132})
"""CONNACK's codes, in MQTT 3.1.1 and 5, for a version of MQTT that the broker does not speak."""
TRANSIENT = frozenset({3, 131, 136, 137, 151, 159})
"""CONNACK's codes for what a broker may think better of: busy, not available yet."""
TLS_TIMEOUT_S = 1.0


class MqttError(PlotfeedError):
    """A broker with which there is no connection."""

    exit_code = 1

    def __init__(self, reason: str, *, final: bool = False, versions: bool = False) -> None:
        super().__init__(reason)
        self.final = final
        """It would be no better a second time."""
        self.other_version = versions
        """It may be better with another version of MQTT."""


def failure(error: Exception) -> MqttError:
    """The error for what went wrong before the broker had an answer, or for its answer."""
    if (code := refusal_code(error)) is not None:
        return MqttError(
            f"it refuses: {reason_name(code)}",
            final=code not in TRANSIENT,
            versions=code in UNKNOWN_VERSION,
        )
    if isinstance(error, ssl.SSLCertVerificationError):
        return MqttError(f"its certificate is not good: {error.verify_message}", final=True)
    if isinstance(error, ssl.SSLError):
        return MqttError(f"TLS failed: {_words(error.reason) or 'no more is known'}")
    if isinstance(error, UnicodeError):
        return MqttError("no host can have this name", final=True)
    if isinstance(error, OSError):
        return MqttError(error.strerror or str(error) or type(error).__name__)
    return MqttError(str(error) or type(error).__name__)


def hung_up(
    address: BrokerAddress, version: int, lost: BaseException | None, *, wants_tls: bool
) -> MqttError:
    """The error for a broker that hangs up instead of answering; `lost` is what broke it."""
    if isinstance(lost, ssl.SSLError):
        return failure(lost)
    access, answer = address.access, "it hung up without an answer"
    if wants_tls and not address.tls:
        return MqttError(f"{answer}: it wants TLS (mqtts://)")
    may_want = []
    if address.tls:
        may_want.append(f"{'a' if access.certificate_file is None else 'another'} certificate")
    may_want.append(f"{'a' if access.username is None else 'another'} user name and password")
    may_want.append(f"another version of MQTT than {VERSION_NAMES[version]}")
    guess = f"it may have as many connections as it takes, or want {', or '.join(may_want)}"
    return MqttError(f"{answer}: {guess}", versions=True)


async def speaks_tls(address: BrokerAddress) -> bool:
    """Whether it answers TLS where it was spoken to without, whatever its certificate."""
    if address.tls:
        return True
    anybody = ssl.create_default_context()
    anybody.check_hostname = False
    anybody.verify_mode = ssl.CERT_NONE
    try:
        async with asyncio.timeout(TLS_TIMEOUT_S):
            _, writer = await asyncio.open_connection(address.host, address.port, ssl=anybody)
    except (OSError, TimeoutError):
        return False
    writer.transport.abort()
    return True


def no_answer() -> MqttError:
    """The error for a broker that takes the connection and says nothing."""
    return MqttError("no answer to CONNECT", versions=True)


def _words(reason: str | None) -> str:
    return (reason or "").replace("_", " ").lower()
