"""Where the link may listen, and whether it is encrypted there."""

from __future__ import annotations

import ipaddress
import socket

from conf import Config, ConfigError


def check_address(config: Config) -> None:
    """Checks that the link can listen where it is told to.

    Raises:
        ConfigError: the host is not this machine's, the link would leave it unencrypted, or the
            port is in use.
    """
    where = config.federation.link
    if config.runtime.name == "local":
        return
    try:
        family, *_, address = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_STREAM)[0]
        socket.create_server((address[0], 0), family=family).close()
    except (OSError, UnicodeError) as error:
        allowed = f"an address of this machine, as robots reach it ({error})"
        raise ConfigError.of([("federation.link.host", where.host, allowed)]) from error
    if where.tls is False and not is_loopback(where.host):
        allowed = "true or null: beyond loopback the link is encrypted"
        raise ConfigError.of([("federation.link.tls", "false", allowed)])
    try:
        socket.create_server((address[0], where.port), family=family).close()
    except OSError as error:
        allowed = f"a port that is free on {where.host}, or 0 for any ({error.strerror})"
        raise ConfigError.of([("federation.link.port", where.port, allowed)]) from error


def is_loopback(host: str) -> bool:
    """Whether a name or address stays on this machine."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        return all(ipaddress.ip_address(row[4][0]).is_loopback for row in found)
    except (OSError, ValueError, UnicodeError):
        return False


def uses_tls(config: Config) -> bool:
    """Whether the link is encrypted: as it is told, else wherever it leaves this machine."""
    where = config.federation.link
    if where.tls is None:
        return config.runtime.secure or not is_loopback(where.host)
    return where.tls
