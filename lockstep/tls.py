"""TLS for the link: a server with a certificate of its own, and clients that trust it alone.

The server makes a key and a self-signed certificate for its run. The certificate reaches each
client inside its Flower train message, so it is as trustworthy as that message, and no authority
is asked: neither the system's nor Flower's. A client is let in by its tokens, not by a certificate.
"""

import ssl
import tempfile

from lockstep.errors import LinkError, described


def server_context(certificate_pem: str, key_pem: str) -> ssl.SSLContext:
    """What a `LinkServer` needs to speak TLS 1.3, from the run's certificate and private key.

    They are read through a file that only this user may read and that is gone when this returns.

    Raises:
        LinkError: they are no certificate and key, or do not belong together.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.num_tickets = 0  # nobody resumes a session, and a ticket would be unread at the end
    try:
        with tempfile.NamedTemporaryFile("w", prefix="risfleet-", suffix=".pem") as file:
            file.write(f"{key_pem}\n{certificate_pem}\n")
            file.flush()
            context.load_cert_chain(file.name)
    except (OSError, ValueError) as error:
        raise LinkError(f"the link's certificate and key cannot be used: {_why(error)}") from error
    return context


def client_context(certificate_pem: str) -> ssl.SSLContext:
    """What `serve` needs to speak TLS 1.3 with the one server that holds this certificate's key.

    The names in the certificate are not compared with the address: the key is the server's
    identity, nobody else can have it, and a robot may reach the server under another name or
    through an address translation. The certificate may sign no other, so it is the only one that
    is ever accepted.

    Raises:
        LinkError: that is not exactly one certificate.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # it starts out with no authorities at all
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    try:
        context.load_verify_locations(cadata=certificate_pem)
    except (OSError, ValueError, TypeError) as error:
        raise LinkError(f"the link's certificate cannot be used: {_why(error)}") from error
    if (count := context.cert_store_stats()["x509"]) != 1:
        raise LinkError(f"the link has one certificate, not {count}")
    return context


def _why(error: Exception) -> str:
    """What OpenSSL has to say, and nothing of what it was given."""
    return described(error) if isinstance(error, ssl.SSLError) else type(error).__name__
