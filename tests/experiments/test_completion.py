"""What completes a command line, asked for as a shell does."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.cli import COMMANDS, COMPOSING, main
from experiments.completion import candidates


def completed(
    line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> list[str]:
    """What the hidden option prints for a shell's line."""
    monkeypatch.setenv("COMP_LINE", line)
    capsys.readouterr()
    assert main(["--complete"]) == 0
    return capsys.readouterr().out.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("risfleet ev", ["evaluate"]),
        ("risfleet --comp", ["--completion"]),
        ("risfleet --completion ", ["bash", "zsh", "fish"]),
        ("risfleet train --m", ["--multirun"]),
        ("risfleet map --", ["--help", "--out", "--channels", "--json", "--config-dir"]),
        ("risfleet status --config", []),
        ("risfleet train exp", ["experiment="]),
        ("risfleet train env.chan", ["env.channel."]),
        ("risfleet train env.channel.fi", ["env.channel.file="]),
        ("risfleet train env.metric=", ["env.metric=qos", "env.metric=qoe"]),
        ("risfleet train runtime.secure=f", ["runtime.secure=false"]),
        ("risfleet train env.plan=h", ["env.plan=hall"]),
        ("risfleet train env.robots=", []),
        ("risfleet train env.robotz=", []),
        ("risfleet train -m strategy=krum,fedm", ["strategy=krum,fedmedian"]),
        ("risfleet train -m --objective e", ["ee", "ee_bits_per_joule"]),
        ("risfleet reproduce cl", ["claims"]),
        ("risfleet evaluate --json x", []),
        ("risfleet dance e", []),
        ("risfleet train 'run.dir=a b", []),
    ],
)  # fmt: skip
def test_a_line_is_completed(
    line: str,
    expected: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert completed(line, monkeypatch, capsys) == expected


def test_every_group_and_every_command_is_offered() -> None:
    assert {*COMMANDS} < {*candidates("risfleet ", COMMANDS, COMPOSING)}
    first = candidates("risfleet train ", COMMANDS, COMPOSING)
    assert {"experiment=", "strategy=", "env=", "env.", "agent.", "seed=", "rooms."} <= {*first}
    assert len(first) == len({*first})


def test_a_folder_of_the_users_is_looked_into(tmp_path: Path) -> None:
    (tmp_path / "my conf" / "experiment").mkdir(parents=True)
    (tmp_path / "my conf" / "experiment" / "mine.yaml").touch()
    option = f"--config-dir {shlex.quote(str(tmp_path / 'my conf'))}"
    found = candidates(f"risfleet train {option} experiment=m", COMMANDS, COMPOSING)
    assert found == ["experiment=mine"]
    assert candidates("risfleet train --config-dir no experiment=m", COMMANDS, COMPOSING) == []


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_by_the_script(tmp_path: Path) -> None:
    command = tmp_path / "risfleet"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m experiments.cli "$@"\n')
    command.chmod(0o755)
    program = """
        eval "$(./risfleet --completion bash)"
        COMP_LINE="./risfleet train experiment=q --cfg" COMP_POINT=29
        COMP_WORDS=(./risfleet train experiment = q --cfg) COMP_CWORD=4
        _risfleet; printf '%s\\n' "${COMPREPLY[@]}"
        COMP_LINE="./risfleet or" COMP_POINT=13 COMP_WORDS=(./risfleet or) COMP_CWORD=1
        _risfleet; printf '%s\\n' "${COMPREPLY[@]}"
    """
    root = str(Path(__file__).parents[2])
    found = subprocess.run(
        ["bash", "-c", program],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": root, "PATH": "/usr/bin:/bin"},
        check=True,
    )
    assert (found.stdout.split(), found.stderr) == (["quick", "oracle"], "")


def test_an_unknown_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", "csh"]) == 2
    assert capsys.readouterr().err == (
        "risfleet: --completion csh: allowed is one of bash, zsh, fish.\n"
    )
    for shell in ("zsh", "fish"):
        assert main(["--completion", shell]) == 0
        assert "risfleet" in capsys.readouterr().out
