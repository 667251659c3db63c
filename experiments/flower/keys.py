"""The files of a secured fleet: an authority, its SuperLink's certificate, its SuperNodes' keys.

ca.crt  ca.key                  the authority; its key is needed for another SuperLink only
superlink.crt  superlink.key    for the SuperLink's host, with ca.crt
node-0/ca.crt node.key node.pub for the first SuperNode's host; node.pub is to be registered
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from conf import ConfigError
from lockstep.messages import MAX_ROBOTS
from server_app.certificates import alternative_name, certificate_pem, certify, key_pem

VALID_DAYS = 5 * 365
LOOPBACK = ("localhost", "127.0.0.1")

_NODE = "node-"


@dataclass(frozen=True)
class NodeKeys:
    """What one SuperNode's host needs, in a folder of its own that is copied there."""

    folder: Path

    @property
    def number(self) -> int:
        """Counted from 0."""
        return int(self.folder.name.removeprefix(_NODE))

    @property
    def public(self) -> Path:
        """The key to register with the SuperLink."""
        return self.folder / "node.pub"

    def options(self) -> list[str]:
        """For ``flower-supernode``."""
        return [
            "--root-certificates", str(self.folder / "ca.crt"),
            "--auth-supernode-private-key", str(self.folder / "node.key"),
        ]  # fmt: skip


@dataclass(frozen=True)
class FleetKeys:
    """A folder that ``make_keys`` has made."""

    folder: Path

    @property
    def authority(self) -> Path:
        """The certificate by which everybody knows the SuperLink."""
        return self.folder / "ca.crt"

    @property
    def hosts(self) -> list[str]:
        """Where the SuperNodes find the SuperLink, as its certificate says."""
        certificate = x509.load_pem_x509_certificate((self.folder / "superlink.crt").read_bytes())
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
        return [str(name.value) for name in names.value]

    @property
    def nodes(self) -> list[NodeKeys]:
        """Of the SuperNodes, in the order of their numbers."""
        return [NodeKeys(self.folder / f"{_NODE}{number}") for number in _numbers(self.folder)]

    def options(self) -> list[str]:
        """For ``flower-superlink``."""
        return [
            "--ssl-ca-certfile", str(self.authority),
            "--ssl-certfile", str(self.folder / "superlink.crt"),
            "--ssl-keyfile", str(self.folder / "superlink.key"),
            "--enable-supernode-auth",
        ]  # fmt: skip


def make_keys(folder: Path, hosts: Sequence[str], nodes: int) -> FleetKeys:
    """Makes all keys of a fleet; the folder appears whole or not at all.

    Args:
        folder: must not exist, or be empty.
        hosts: names and IP addresses at which the SuperNodes find the SuperLink; loopback is
            always added.
        nodes: number of SuperNodes.

    Raises:
        ConfigError: a host is none, the number is out of range, or the folder holds something.
        OSError: the folder cannot be written.
    """
    _check_number(nodes, "--nodes")
    for host in hosts:
        try:
            alternative_name(host)
        except ValueError as error:
            raise ConfigError(f"--host {error}.") from error
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} exists and is not empty: nothing is ever overwritten.")

    def fill(place: Path) -> None:
        authority_key, key = (ec.generate_private_key(ec.SECP384R1()) for _ in range(2))
        authority = certify("RISFleet authority", authority_key, days=VALID_DAYS)
        certificate = certify(
            "RISFleet SuperLink",
            key,
            days=VALID_DAYS,
            hosts=list(dict.fromkeys([*hosts, *LOOPBACK])),
            issuer=(authority, authority_key),
        )
        _write(place / "ca.key", key_pem(authority_key), private=True)
        _write(place / "ca.crt", certificate_pem(authority))
        _write(place / "superlink.key", key_pem(key), private=True)
        _write(place / "superlink.crt", certificate_pem(certificate))
        for number in range(nodes):
            (place / f"{_NODE}{number}").mkdir(mode=0o700)
            _fill_node(place / f"{_NODE}{number}", certificate_pem(authority))

    folder.parent.mkdir(parents=True, exist_ok=True)
    _make_whole(folder, fill)
    return FleetKeys(folder)


def add_nodes(folder: Path, nodes: int) -> list[NodeKeys]:
    """Makes keys for further SuperNodes of a fleet, which are returned; needs no ``ca.key``.

    Raises:
        ConfigError: the folder holds no fleet's keys, or the number is out of range.
        OSError: the folder cannot be written.
    """
    _check_number(nodes, "--add")
    try:
        authority = (folder / "ca.crt").read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(f"{folder} holds no fleet's keys: make them with --nodes.") from None
    first = max(_numbers(folder), default=-1) + 1
    added = [NodeKeys(folder / f"{_NODE}{first + offset}") for offset in range(nodes)]
    for node in added:
        _make_whole(node.folder, lambda place: _fill_node(place, authority))
    return added


def _check_number(nodes: int, option: str) -> None:
    if not 1 <= nodes <= MAX_ROBOTS:
        raise ConfigError(f"{option} {nodes}: allowed are 1 to {MAX_ROBOTS}.")


def _numbers(folder: Path) -> list[int]:
    """The numbers of the nodes that have a folder here."""
    suffixes = [path.name.removeprefix(_NODE) for path in folder.glob(f"{_NODE}*")]
    return sorted(int(suffix) for suffix in suffixes if suffix.isdecimal())


def _make_whole(folder: Path, fill: Callable[[Path], None]) -> None:
    """Makes a folder (mode 700) that is either there with all that `fill` writes, or not there."""
    place = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        fill(place)
        place.rename(folder)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _fill_node(folder: Path, authority_pem: str) -> None:
    """Writes a SuperNode's files: its key's halves are in OpenSSH's form, as Flower takes them."""
    key = ec.generate_private_key(ec.SECP384R1())
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.OpenSSH,
        serialization.NoEncryption(),
    )
    public = key.public_key().public_bytes(
        serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH
    )
    _write(folder / "node.key", private.decode(), private=True)
    _write(folder / "node.pub", public.decode() + "\n")
    _write(folder / "ca.crt", authority_pem)


def _write(path: Path, text: str, *, private: bool = False) -> None:
    """Writes a new file; a private one is never readable by others, not even for a moment."""
    mode = 0o600 if private else 0o644
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with open(handle, "w", encoding="utf-8") as file:
        file.write(text)
