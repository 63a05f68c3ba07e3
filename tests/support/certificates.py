"""Certificates for tests: of a broker, of clients, and such as must not be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import trustme

LONG_AGO = {"not_before": datetime(2019, 1, 1), "not_after": datetime(2020, 1, 1)}  # noqa: DTZ001


@dataclass(frozen=True)
class Pair:
    """A certificate and its key."""

    certificate: Path
    key: Path


class Certificates:
    """PEM files in a folder."""

    def __init__(self, folder: Path) -> None:
        ours, another = trustme.CA(), trustme.CA()
        self._folder = folder
        self.ca = folder / "ca.pem"
        self.other_ca = folder / "other-ca.pem"
        ours.cert_pem.write_to_path(str(self.ca))
        another.cert_pem.write_to_path(str(self.other_ca))
        here = ("127.0.0.1", "::1", "localhost")
        self.broker = self._pair("broker", ours.issue_cert(*here))
        self.elsewhere = self._pair("elsewhere", ours.issue_cert("elsewhere.example"))
        self.expired = self._pair("expired", ours.issue_cert(*here, **LONG_AGO))
        self.client = self._pair("client", ours.issue_cert("client@example.org"))
        self.stranger = self._pair("stranger", another.issue_cert("client@example.org"))

    def _pair(self, name: str, issued: trustme.LeafCert) -> Pair:
        pair = Pair(self._folder / f"{name}.pem", self._folder / f"{name}.key")
        pair.certificate.write_bytes(b"".join(blob.bytes() for blob in issued.cert_chain_pems))
        issued.private_key_pem.write_to_path(str(pair.key))
        return pair
