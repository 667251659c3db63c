"""What of the user's environment reaches Flower's processes: what is listed, or all of it."""

from __future__ import annotations

import json
import os
import ssl
import sys
import textwrap
from pathlib import Path

import pytest

from experiments.flower import commands, control, environment, variables
from experiments.flower.connection import Connection
from experiments.flower.environment import FlowerError
from experiments.flower.keys import make_keys
from experiments.flower.session import Session

pytestmark = pytest.mark.usefixtures("swift")

SOCKS = "socks5://127.0.0.1:9"
LEADS_ELSEWHERE = {
    **dict.fromkeys(("all_proxy", "ALL_PROXY", "http_proxy", "HTTPS_PROXY"), SOCKS),
    **dict.fromkeys(("Ftp_Proxy", "grpc_proxy", "no_proxy", "NO_PROXY"), SOCKS),
    **dict.fromkeys(("SSL_CERT_FILE", "SSL_CERT_DIR", "REQUESTS_CA_BUNDLE"), "/nowhere"),
    "SSLKEYLOGFILE": "/nowhere/keys",
    "GRPC_DEFAULT_SSL_ROOTS_FILE_PATH": "/nowhere",
    "GRPC_VERBOSITY": "debug",
    "RAY_ADDRESS": "10.0.0.1:6379",
    "RAY_NAMESPACE": "another",
    "RAY_RUNTIME_ENV_HOOK": "a.b",
    "FLWR_DATABASE": "another.db",
    "FLWR_OIDC_ENABLED": "1",
    "FLWR_LOCAL_CONTROL_API_PORT": "1",
    "FLWR_LOG_LEVEL": "DEBUG",
    "FORCE_COLOR": "1",
    "COLUMNS": "7",
    "PYTHONSTARTUP": "/nowhere.py",
    "PYTHONINSPECT": "1",
    "PYTHONOPTIMIZE": "2",
    "MPLBACKEND": "module://nowhere",
    "AWS_SECRET_ACCESS_KEY": "secret",
}
NEEDED = {
    "HOME": "/home/ada",
    "USER": "ada",
    "LC_ALL": "C.UTF-8",
    "TMPDIR": "/var/tmp",
    "PYTHONPATH": "/home/ada/plugins",
    "LD_LIBRARY_PATH": "/opt/lib",
    "CUDA_VISIBLE_DEVICES": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_CBWR": "COMPATIBLE",
    "VIRTUAL_ENV": "/home/ada/venv",
    "COVERAGE_PROCESS_START": "/home/ada/.coveragerc",
    "RISFLEET_CHAOS": "a mark",
    "WANDB_MODE": "online",
    "MLFLOW_TRACKING_URI": "http://127.0.0.1:9",
}


@pytest.fixture
def desktop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of a user who has set everything."""
    for name, value in (LEADS_ELSEWHERE | NEEDED).items():
        monkeypatch.setenv(name, value)


def seen(session: Session) -> dict[str, str]:
    """The variables that a process of a session finds."""
    show = "import json, os; print(json.dumps(dict(os.environ)))"
    status, printed, _ = session.run([sys.executable, "-S", "-c", show], 60.0)
    assert status == 0
    found: dict[str, str] = json.loads(printed)
    return found


# --- A private session ----------------------------------------------------------------------------


def test_a_sessions_processes_see_nothing_that_leads_elsewhere(
    desktop: None, session: Session
) -> None:
    found = seen(session)
    assert [name for name in found if "proxy" in name.lower()] == []
    assert {name for name in LEADS_ELSEWHERE if name in found} == set()
    assert found["FLWR_HOME"] == found["RAY_TMPDIR"] == str(session.folder)


def test_a_sessions_processes_see_what_a_user_needs(desktop: None, session: Session) -> None:
    found = seen(session)
    assert {name: found.get(name) for name in NEEDED} == NEEDED
    path = found["PATH"].split(os.pathsep)
    assert path[1:] == os.environ["PATH"].split(os.pathsep)
    assert Path(path[0], "flower-superexec").exists()


def test_a_variable_that_nobody_has_thought_of_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOMETHING_NEW", "x")
    assert "SOMETHING_NEW" not in variables.chosen()


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ("sqlite:///mine.db", "sqlite:///{here}/mine.db"),
        ("sqlite:////data/all.db", "sqlite:////data/all.db"),
        ("http://127.0.0.1:9", "http://127.0.0.1:9"),
    ],
)
def test_a_database_of_mlflow_lies_where_the_user_is(
    given: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    passed_on = variables.chosen({"MLFLOW_TRACKING_URI": given})
    assert passed_on == {"MLFLOW_TRACKING_URI": found.format(here=tmp_path)}


def test_what_is_passed_on_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "deployment.md").read_text()
    missing = [name for name in (*variables.CHOSEN, variables.PASS) if f"`{name}`" not in page]
    assert missing == []


def test_a_user_names_further_variables_but_no_proxy(desktop: None) -> None:
    named = {variables.PASS: " RAYTRACES ,RAY_memory_*,all_proxy", "RAYTRACES": "/data"}
    found = variables.chosen({**os.environ, **named, "RAY_memory_monitor_refresh_ms": "0"})
    assert found["RAYTRACES"] == "/data"
    assert found["RAY_memory_monitor_refresh_ms"] == "0"
    assert "all_proxy" not in found
    assert "RAY_ADDRESS" not in found


def test_a_users_colours_do_not_spoil_flowers_answers(desktop: None) -> None:
    made = environment.user_environment("name")
    assert "FORCE_COLOR" not in made
    assert made["SSL_CERT_FILE"] == "/nowhere"


def test_the_desktops_own_proxies_do_not_count_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert environment.child_environment(tmp_path, "name")["no_proxy"] == "*"


def test_the_control_api_is_asked_without_the_environment(
    tmp_path: Path, desktop: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSLKEYLOGFILE", str(tmp_path / "nowhere" / "keys"))
    authority = make_keys(tmp_path / "keys", ["127.0.0.1"], 1).authority
    connection = control._connection(9, authority, 1.0)
    context = connection._context  # type: ignore[attr-defined]
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert context.check_hostname
    assert context.keylog_filename is None
    assert context.cert_store_stats()["x509_ca"] == 1


# --- A federation of the user's -------------------------------------------------------------------


@pytest.fixture
def connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, desktop: None) -> Connection:
    """One to a federation elsewhere, whose `flwr` says what httpx says."""
    monkeypatch.setenv("FLWR_HOME", str(tmp_path))
    (tmp_path / "config.toml").write_text(
        '[superlink.far]\naddress = "192.0.2.7:8000"\nroot-certificates = "ca.crt"\n'
    )
    command = tmp_path / "flwr"
    command.write_text(
        f"#!{sys.executable}\n"
        + textwrap.dedent(
            """
            import json
            why = "Using SuperLink: far\\n\\nUsing SOCKS proxy, but the 'socksio' package is"
            print(json.dumps({"success": False, "error-message": why + " not installed."}))
            """
        )
    )
    command.chmod(0o755)
    monkeypatch.setattr(commands, "flower_command", lambda name: str(tmp_path / name))
    return Connection("far")


def test_a_users_federation_is_reached_with_all_of_his_environment(
    connection: Connection, tmp_path: Path
) -> None:
    with connection:
        assert connection._session is not None
        found = seen(connection._session)
    assert found["all_proxy"] == found["HTTPS_PROXY"] == SOCKS
    assert found["no_proxy"] == f"{SOCKS},127.0.0.1,localhost"
    assert found["SSL_CERT_FILE"] == "/nowhere"
    assert found["FLWR_HOME"] == str(tmp_path)


def test_a_socks_proxy_without_its_package_is_a_sentence(connection: Connection) -> None:
    with connection, pytest.raises(FlowerError) as refused:
        connection.submit("")
    said = str(refused.value)
    assert said.startswith("`flwr run` is to go through a SOCKS proxy (ALL_PROXY, Ftp_Proxy, ")
    assert "pip install socksio" in said
    assert SOCKS not in said, "it may hold a password"
    assert "\n" not in said
