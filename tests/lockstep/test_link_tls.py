"""The link over TLS: the run's own certificate, and nobody else's."""

import datetime
import os
import ssl
import tempfile

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from link_helpers import PATIENCE_S, Client, RawClient, Recorder, drive, token

from lockstep.errors import FrameError, LinkError, ServerLost
from lockstep.frames import decode, encode
from lockstep.messages import VERSION, Hello, Welcome
from lockstep.tls import client_context, server_context
from server_app.certificates import alternative_name, run_certificate

CERTIFICATE, KEY = run_certificate("127.0.0.1")
OTHER_CERTIFICATE, OTHER_KEY = run_certificate("127.0.0.1")


@pytest.fixture
def secured(make_link):
    """A link over TLS."""
    return make_link(server_context=server_context(CERTIFICATE, KEY), handshake_s=PATIENCE_S)


def ours():
    return client_context(CERTIFICATE)


def run_with_honest_clients(link, context):
    """A whole run on a link whose round is open: what the server and the clients heard."""
    clients = [link.client(block, client_context=context) for block in link.blocks]
    link.server.wait_connected(PATIENCE_S)
    heard = drive(link.server, 3)
    assert [client.join() for client in clients] == [None] * len(clients)
    return heard, [client.handler.calls for client in clients]


def test_the_same_conversation_runs_over_tls(secured, link):
    secured.admit((0,), (1, 2))
    link.admit((0,), (1, 2))
    (heard, calls), (plain, plain_calls) = (
        run_with_honest_clients(secured, ours()),
        run_with_honest_clients(link, None),
    )
    assert [one.tobytes() for one in heard] == [one.tobytes() for one in plain]
    assert calls == plain_calls


def test_only_tls_1_3_is_spoken(secured):
    secured.admit((0,))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with context.wrap_socket(secured.raw().sock) as tls:
        assert tls.version() == "TLSv1.3"
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    with pytest.raises(ssl.SSLError, match="alert protocol version"):
        context.wrap_socket(secured.raw().sock)


def test_large_weights_travel_whole_over_tls(secured):
    shape = (2, 300_000)
    heavy = np.arange(2 * shape[1], dtype=np.float32).reshape(1, *shape)

    class Heavy(Recorder):
        def upload(self):
            return heavy

    secured.server.admit([(0,)], {0: token(0)}, shape)
    options = {"client_context": ours(), "n_parameters": shape[1]}
    client = Client(secured.server, Heavy((0,)), **options)
    secured.server.wait_connected(PATIENCE_S)
    uploads = [seen for seen in drive(secured.server, 1) if seen.ndim == 3]
    assert client.join() is None
    np.testing.assert_array_equal(uploads, [heavy, heavy])
    np.testing.assert_array_equal(client.handler.model, heavy[0])


@pytest.mark.parametrize("trusted", ["another run's", "the system's", "one that ours has signed"])
def test_a_client_that_trusts_another_certificate_is_gone_and_the_run_goes_on(
    secured, caplog, trusted
):
    context = {
        "another run's": lambda: client_context(OTHER_CERTIFICATE),
        "the system's": ssl.create_default_context,
        "one that ours has signed": lambda: client_context(signed_by_ours()[0]),
    }[trusted]()
    secured.admit((0,), (1, 2))
    stranger = Client(secured.server, Recorder((0,)), client_context=context)
    error = stranger.join()
    assert isinstance(error, ServerLost)
    assert "no TLS with the server: SSLCertVerificationError" in str(error)
    run_with_honest_clients(secured, ours())
    assert "alert unknown ca" in caplog.text


@pytest.mark.parametrize("made_by", ["another server", "our certificate's key"])
def test_a_server_with_another_certificate_is_not_spoken_to(make_link, made_by):
    pair = (OTHER_CERTIFICATE, OTHER_KEY) if made_by == "another server" else signed_by_ours()
    false = make_link(server_context=server_context(*pair))
    false.admit((0,))
    error = false.client((0,), client_context=ours()).join()
    assert isinstance(error, ServerLost)
    assert "certificate verify failed" in str(error)
    assert not false.server.stats()[0,].bytes_received


def signed_by_ours():
    """A certificate that the holder of the run's key has made for somebody else."""
    key = ec.generate_private_key(ec.SECP256R1())
    issuer = x509.load_pem_x509_certificate(CERTIFICATE.encode()).subject
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "somebody else")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder(issuer, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([alternative_name("127.0.0.1")]), False)
        .sign(serialization.load_pem_private_key(KEY.encode(), None), hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    leaf = certificate.public_bytes(serialization.Encoding.PEM)
    return leaf.decode(), private.decode()


def test_a_client_without_tls_learns_that_it_is_not_understood(secured, caplog):
    secured.admit((0,), (1, 2))
    error = Client(secured.server, Recorder((0,))).join()
    assert isinstance(error, ServerLost | FrameError)
    run_with_honest_clients(secured, ours())
    assert "SSLError" in caplog.text


def test_a_client_with_tls_says_so_where_the_server_has_none(link, caplog):
    link.admit((0,), (1, 2))
    error = Client(link.server, Recorder((0,)), client_context=ours()).join()
    assert isinstance(error, ServerLost)
    assert "no TLS with the server" in str(error)
    run_with_honest_clients(link, None)
    assert "not a frame of the link" in caplog.text


class SlowClient:
    """A TLS client by hand, whose bytes go out when the test says so."""

    def __init__(self, server):
        self.raw = RawClient(server)
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = ours().wrap_bio(self._in, self._out)

    def next_flight(self):
        """What the handshake has to say next."""
        with pytest.raises(ssl.SSLWantReadError):
            self._tls.do_handshake()
        return self._out.read()

    def finish(self, hello):
        """Go through with the handshake, say hello, and hear the answer."""
        while True:
            try:
                self._tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                self._in.write(self.raw.sock.recv(65536))
        self._tls.write(encode(hello))
        self.raw.send(self._out.read())
        while True:
            try:
                return decode(self._tls.read(65536))
            except ssl.SSLWantReadError:
                self._in.write(self.raw.sock.recv(65536))


def test_a_slow_tls_handshake_blocks_nobody_and_may_still_succeed(secured):
    secured.admit((0,), (1, 2))
    slow = SlowClient(secured.server)
    flight = slow.next_flight()
    slow.raw.send(flight[:20])
    run_with_honest_clients(secured, ours())
    secured.admit((0,))
    for start in range(20, len(flight), 100):
        slow.raw.send(flight[start : start + 100])
    assert slow.finish(Hello(VERSION, "v1", [0], [token(0)])) == Welcome()
    secured.server.wait_connected(PATIENCE_S)
    slow.raw.close()


def test_a_handshake_that_never_ends_is_ended(make_link, caplog):
    link = make_link(server_context=server_context(CERTIFICATE, KEY), handshake_s=0.3)
    slow = SlowClient(link.server)
    slow.raw.send(slow.next_flight()[:-1])
    assert slow.raw.at_end()
    slow.raw.close()
    assert "said no hello in time" in caplog.text


def test_no_key_is_left_on_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    seen = []
    load = ssl.SSLContext.load_cert_chain

    def watched(context, path):
        seen.append((os.stat(path).st_mode & 0o777, os.path.dirname(path)))
        return load(context, path)

    monkeypatch.setattr(ssl.SSLContext, "load_cert_chain", watched)
    server_context(CERTIFICATE, KEY)
    with pytest.raises(LinkError):
        server_context(CERTIFICATE, OTHER_KEY)
    assert seen == [(0o600, str(tmp_path))] * 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("certificate", "key"),
    [(CERTIFICATE, OTHER_KEY), (CERTIFICATE, ""), ("", KEY), ("no", "PEM"), (KEY, KEY)],
)
def test_a_certificate_and_a_key_that_do_not_fit_are_refused_and_not_shown(certificate, key):
    with pytest.raises(LinkError, match="certificate and key cannot be used") as caught:
        server_context(certificate, key)
    assert "PRIVATE" not in str(caught.value)


@pytest.mark.parametrize(
    "pem", ["", "no PEM", KEY, CERTIFICATE[:-40], CERTIFICATE + OTHER_CERTIFICATE, "\u00e9"]
)
def test_a_client_trusts_exactly_one_certificate(pem):
    with pytest.raises(LinkError, match="certificate"):
        client_context(pem)


@pytest.mark.parametrize(
    ("host", "kind", "value"),
    [
        ("127.0.0.1", x509.IPAddress, "127.0.0.1"),
        ("fd00::7", x509.IPAddress, "fd00::7"),
        ("ap.example", x509.DNSName, "ap.example"),
    ],
)
def test_the_runs_certificate_names_its_host_and_lasts_a_long_run(host, kind, value):
    certificate = x509.load_pem_x509_certificate(run_certificate(host)[0].encode())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name) for name in names.get_values_for_type(kind)] == [value]
    now = datetime.datetime.now(datetime.UTC)
    assert certificate.not_valid_before_utc < now - datetime.timedelta(hours=12)
    assert certificate.not_valid_after_utc > now + datetime.timedelta(days=29)


def test_no_two_runs_share_a_key():
    assert KEY != OTHER_KEY
    assert CERTIFICATE != OTHER_CERTIFICATE
