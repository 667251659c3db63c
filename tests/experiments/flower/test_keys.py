"""``risfleet keys``: what it makes fits together, stays private, and is never overwritten."""

from __future__ import annotations

import os
import shlex
import socket
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from conf import ConfigError
from experiments.cli import main
from experiments.flower import keys as keys_module
from experiments.flower.keys import FleetKeys, add_nodes, make_keys

HOST = "ap.example"
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> FleetKeys:
    """The keys of a fleet of two; not to be written to."""
    return make_keys(tmp_path_factory.mktemp("fleet") / "keys", [HOST, "10.0.0.7"], 2)


def modes(folder: Path) -> dict[str, str]:
    """Every file and folder with its permissions."""
    return {
        str(path.relative_to(folder)): oct(path.stat().st_mode & 0o777)
        for path in [folder, *folder.rglob("*")]
    }


def test_everything_is_there_and_private_files_are_private(fleet: FleetKeys) -> None:
    node = {"": "0o700", "/ca.crt": "0o644", "/node.key": "0o600", "/node.pub": "0o644"}
    assert modes(fleet.folder) == {
        ".": "0o700",
        "ca.crt": "0o644",
        "ca.key": "0o600",
        "superlink.crt": "0o644",
        "superlink.key": "0o600",
        **{f"node-{number}{name}": mode for number in (0, 1) for name, mode in node.items()},
    }


def test_a_private_file_is_private_from_its_first_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: dict[str, int] = {}
    system_open = os.open

    def watched(path: str | Path, flags: int, mode: int = 0o777) -> int:
        descriptor = system_open(path, flags, mode)
        opened[Path(path).name] = os.fstat(descriptor).st_mode & 0o777
        return descriptor

    before = os.umask(0)
    try:
        monkeypatch.setattr(keys_module.os, "open", watched)  # type: ignore[attr-defined]
        make_keys(tmp_path / "keys", [HOST], 1)
    finally:
        os.umask(before)
    private = {name: mode for name, mode in opened.items() if name.endswith(".key")}
    assert private == dict.fromkeys(["ca.key", "superlink.key", "node.key"], 0o600)


def test_a_node_key_has_the_form_that_flower_takes(fleet: FleetKeys) -> None:
    publics = set()
    for node in fleet.nodes:
        private = serialization.load_ssh_private_key(
            (node.folder / "node.key").read_bytes(), password=None
        )
        public = serialization.load_ssh_public_key(node.public.read_bytes())
        assert isinstance(private, ec.EllipticCurvePrivateKey)
        assert isinstance(public, ec.EllipticCurvePublicKey)
        assert isinstance(private.curve, ec.SECP384R1)
        assert private.public_key().public_numbers() == public.public_numbers()
        assert (node.folder / "ca.crt").read_text() == fleet.authority.read_text()
        publics.add(public.public_numbers().x)
    assert len(publics) == 2


@pytest.fixture
def superlink(fleet: FleetKeys) -> Iterator[tuple[str, int]]:
    """The address of a TLS server on loopback that has the SuperLink's certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(fleet.folder / "superlink.crt", fleet.folder / "superlink.key")
    listener = socket.create_server(("127.0.0.1", 0))

    def greet() -> None:
        with listener, listener.accept()[0] as sock:
            sock.settimeout(PATIENCE_S)
            try:
                with context.wrap_socket(sock, server_side=True) as tls:
                    tls.sendall(b"hello")
            except OSError:
                pass  # the client does not trust us, and says so itself

    thread = threading.Thread(target=greet)
    thread.start()
    yield listener.getsockname()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def greeting(address: tuple[str, int], authority: Path, name: str) -> bytes:
    """What the server says to a client that trusts this authority and looks for this name."""
    context = ssl.create_default_context(cafile=authority)
    context.verify_flags |= ssl.VERIFY_X509_STRICT
    sock = socket.create_connection(address, PATIENCE_S)
    with sock, context.wrap_socket(sock, server_hostname=name) as tls:
        return tls.recv(5)


@pytest.mark.parametrize("name", [HOST, "10.0.0.7", "localhost", "127.0.0.1"])
def test_a_node_trusts_the_superlink_under_each_of_its_names(
    fleet: FleetKeys, superlink: tuple[str, int], name: str
) -> None:
    assert greeting(superlink, fleet.nodes[1].folder / "ca.crt", name) == b"hello"


def test_a_node_trusts_no_other_name(fleet: FleetKeys, superlink: tuple[str, int]) -> None:
    with pytest.raises(ssl.SSLCertVerificationError, match=r"evil\.example"):
        greeting(superlink, fleet.authority, "evil.example")


def test_another_fleets_node_trusts_nothing_of_ours(
    superlink: tuple[str, int], tmp_path: Path
) -> None:
    other = make_keys(tmp_path / "other", [HOST], 1)
    with pytest.raises(ssl.SSLCertVerificationError):
        greeting(superlink, other.authority, HOST)


def test_only_the_authority_can_sign(fleet: FleetKeys) -> None:
    signs = {}
    for name in ("ca.crt", "superlink.crt"):
        certificate = x509.load_pem_x509_certificate((fleet.folder / name).read_bytes())
        basic = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
        signs[name] = (basic.ca, usage.key_cert_sign)
    assert signs == {"ca.crt": (True, True), "superlink.crt": (False, False)}


def test_the_command_makes_the_keys_and_says_what_to_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "deep" / "keys"
    assert main(["keys", str(folder), "--host", HOST, "--host", "fd00::7", "--nodes", "2"]) == 0
    keys, said = FleetKeys(folder), capsys.readouterr().out
    assert keys.hosts == [HOST, "fd00::7", "localhost", "127.0.0.1"]
    commands = [
        shlex.split(line) for line in said.splitlines() if line.startswith(("flower-", "flwr "))
    ]
    assert [command[0] for command in commands] == [
        "flower-superlink", "flwr", "flwr", "flower-supernode", "flower-supernode",
    ]  # fmt: skip
    for option in (*keys.options(), "--enable-supernode-auth"):
        assert option in commands[0]
    for number, node in enumerate(keys.nodes):
        assert commands[1 + number] == [
            "flwr",
            "supernode",
            "register",
            str(node.public),
            "risfleet",
        ]
        assert [*node.options()] == commands[3 + number][3:7]
        assert commands[3 + number][-1] == f"partition-id={number} num-partitions=2"
    for command in commands:
        for word in command:
            assert not word.startswith(str(folder)) or Path(word).is_file()
    assert f'root-certificates = "{keys.authority}"' in said
    assert "PRIVATE" not in said


def test_nodes_are_added_without_the_authoritys_key_and_nothing_else_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = make_keys(tmp_path / "keys", [HOST], 2)
    (keys.folder / "ca.key").unlink()
    before = {path: path.read_bytes() for path in keys.folder.rglob("*") if path.is_file()}
    assert main(["keys", str(keys.folder), "--add", "2"]) == 0
    said = capsys.readouterr().out
    assert [node.number for node in keys.nodes] == [0, 1, 2, 3]
    assert all(path.read_bytes() == content for path, content in before.items())
    assert said.count("flwr supernode register") == 2
    assert "node-1" not in said
    assert f"--superlink {HOST}:8000" in said
    for node in keys.nodes[2:]:
        assert (node.folder / "ca.crt").read_text() == keys.authority.read_text()
        assert modes(node.folder)["node.key"] == "0o600"


def test_numbers_go_on_from_the_highest_one(tmp_path: Path) -> None:
    keys = make_keys(tmp_path / "keys", [HOST], 12)
    for path in keys.nodes[0].folder.iterdir():
        path.unlink()
    keys.nodes[0].folder.rmdir()
    assert [node.number for node in add_nodes(keys.folder, 1)] == [12]
    assert [node.number for node in keys.nodes] == list(range(1, 13))


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--nodes", "2"], "--host is missing"),
        (["--host", HOST], "--nodes is missing"),
        (["--host", HOST, "--nodes", "0"], "--nodes 0: allowed are 1 to 256"),
        (["--host", HOST, "--nodes", "257"], "--nodes 257: allowed are 1 to 256"),
        (["--host", "no host", "--nodes", "1"], "'no host' is neither an IP address nor"),
        (["--host", "", "--nodes", "1"], "'' is neither"),
        (["--host", "h:8000", "--nodes", "1"], "'h:8000' is neither"),
        (["--add", "1", "--host", HOST], "--add goes with neither"),
        (["--add", "1"], "holds no fleet's keys"),
        (["--add", "0"], "--add 0: allowed are"),
    ],
)
def test_a_mistake_is_one_sentence_and_makes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    assert main(["keys", str(tmp_path / "keys"), *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("risfleet: ")
    assert said.err.count("\n") == 1
    assert reason in said.err
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "keys").mkdir()
    keys = make_keys(tmp_path / "keys", [HOST], 1)
    before = {path: path.read_bytes() for path in keys.folder.rglob("*") if path.is_file()}
    assert main(["keys", str(keys.folder), "--host", HOST, "--nodes", "3"]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ConfigError, match="exists and is not empty"):
        make_keys(file, [HOST], 1)
    assert file.read_text() == "mine"
    after = {path: path.read_bytes() for path in keys.folder.rglob("*") if path.is_file()}
    assert after == before


def test_a_full_disk_leaves_nothing_half_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = []

    def fail_on_the_second_node(*_: object, **__: object) -> str:
        made.append(1)
        if len(made) == 2:
            raise OSError(28, "No space left on device")
        return "key"

    monkeypatch.setattr(keys_module, "_fill_node", fail_on_the_second_node)
    assert main(["keys", str(tmp_path / "keys"), "--host", HOST, "--nodes", "3"]) == 2
    assert "cannot be written: No space left on device." in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
