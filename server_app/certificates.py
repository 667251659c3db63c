"""The certificate of a run's link: self-signed, made when the run starts, kept in memory."""

from __future__ import annotations

import datetime
import ipaddress

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID

VALID_DAYS = 30
BACK_DATED_DAYS = 1
"""A robot whose clock is behind by less than this still takes a certificate made just now."""


def run_certificate(host: str) -> tuple[str, str]:
    """Make a key and a certificate for the link of one run.

    The certificate is an end: it may sign nothing, so whoever trusts it trusts one key only.

    Args:
        host: name or IP address at which the robots find the server; it is named in the
            certificate.

    Returns:
        The certificate and its private key (ECDSA, P-256), both as PEM. The key is not encrypted.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "RISFleet link")])
    now = datetime.datetime.now(datetime.UTC)
    day = datetime.timedelta(days=1)
    usage = x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=False,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - BACK_DATED_DAYS * day)
        .not_valid_after(now + VALID_DAYS * day)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), False)
        .add_extension(x509.SubjectAlternativeName([alternative_name(host)]), False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return certificate.public_bytes(serialization.Encoding.PEM).decode(), private.decode()


def alternative_name(host: str) -> x509.GeneralName:
    """A host as a certificate names it.

    Args:
        host: an IP address or a name.

    Raises:
        ValueError: it is neither; a name must be ASCII.
    """
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
