"""Certificates: the one that each run's link makes for itself, and the parts of any other."""

from __future__ import annotations

import datetime
import ipaddress
import re
from collections.abc import Sequence

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

RUN_DAYS = 30
"""Longer than any run; one that is resumed makes a new certificate."""

BACK_DATED = datetime.timedelta(days=1)
"""A robot whose clock is behind by less than this still takes a certificate made just now."""

_DNS_NAME = re.compile(r"(?=.{1,253}\Z)(?!-)[A-Za-z0-9-]{1,63}(\.(?!-)[A-Za-z0-9-]{1,63})*\.?")


def run_certificate(host: str) -> tuple[str, str]:
    """Make a key and a self-signed certificate for the link of one run.

    The certificate may sign nothing, so whoever trusts it trusts one key only.

    Args:
        host: name or IP address at which the robots find the server; the certificate names it.

    Returns:
        The certificate and its private key (ECDSA, P-256), both as PEM. The key is not encrypted.

    Raises:
        ValueError: the host is neither a name nor an address.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = certify("RISFleet link", key, days=RUN_DAYS, hosts=[host])
    return certificate_pem(certificate), key_pem(key)


def certify(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    *,
    days: int,
    hosts: Sequence[str] = (),
    issuer: tuple[x509.Certificate, ec.EllipticCurvePrivateKey] | None = None,
) -> x509.Certificate:
    """Make a certificate.

    Args:
        name: whose it is.
        key: whose public half it certifies.
        days: how long it is valid.
        hosts: names and IP addresses of a server. Without any it is an authority, which may sign
            servers' certificates.
        issuer: the authority that signs it; by default it signs itself.

    Raises:
        ValueError: a host is neither a name nor an address.
    """
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    authority, signing_key = (subject, key) if issuer is None else (issuer[0].subject, issuer[1])
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    issuer_identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(signing_key.public_key())
    depth = None if hosts else 0
    # A server's key signs handshakes, an authority's certificates.
    usage = x509.KeyUsage(
        digital_signature=bool(hosts),
        key_cert_sign=not hosts,
        crl_sign=not hosts,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    builder = (
        x509.CertificateBuilder(authority, subject, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - BACK_DATED)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=not hosts, path_length=depth), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(identifier, critical=False)
        .add_extension(issuer_identifier, critical=False)
    )
    if hosts:
        names = x509.SubjectAlternativeName([alternative_name(host) for host in hosts])
        server = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
        builder = builder.add_extension(names, critical=False).add_extension(server, critical=False)
    return builder.sign(signing_key, hashes.SHA256())


def alternative_name(host: str) -> x509.GeneralName:
    """A host as a certificate names it.

    Raises:
        ValueError: it is neither an IP address nor a DNS name.
    """
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        if _DNS_NAME.fullmatch(host) is None:
            raise ValueError(f"{host!r} is neither an IP address nor the name of a host") from None
        return x509.DNSName(host)


def certificate_pem(certificate: x509.Certificate) -> str:
    """A certificate as PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def key_pem(key: ec.EllipticCurvePrivateKey) -> str:
    """A private key as PEM (PKCS 8), not encrypted."""
    pem, pkcs8 = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    return key.private_bytes(pem, pkcs8, serialization.NoEncryption()).decode()
