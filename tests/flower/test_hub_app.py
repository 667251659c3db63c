"""What Flower Hub asks of an app, by the rules of the installed Flower: `hub/`, and the project."""

from __future__ import annotations

import importlib
import io
import shutil
import subprocess
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from flwr.cli.build import build_fab_from_files
from flwr.cli.config_utils import load_and_validate
from flwr.cli.utils import collect_files, validate_project_name

from experiments.flower.manifest import Components

ROOT = Path(__file__).parents[2]
HUB = ROOT / "hub"


def project(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "pyproject.toml").read_text())


@pytest.mark.parametrize(
    "app", [ROOT, pytest.param(HUB, marks=pytest.mark.slow)], ids=["project", "hub"]
)
def test_flwr_build_passes(app: Path, tmp_path: Path) -> None:
    """The command itself, from a folder where no module lies by chance."""
    command = [str(Path(sysconfig.get_path("scripts"), "flwr")), "build", "--app"]
    copy = tmp_path / "app"
    shutil.copytree(app, copy, ignore=shutil.ignore_patterns(".*", "runs", "results", "tests"))
    done = subprocess.run(
        [*command, str(copy)], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(list(tmp_path.glob("risfleet.*.fab"))) == 1


def test_the_hub_s_app_is_of_the_newest_format_and_carries_no_code() -> None:
    bundle, metadata = build_fab_from_files(collect_files(HUB))
    names = zipfile.ZipFile(io.BytesIO(bundle)).namelist()
    assert {*names} == {"pyproject.toml", "README.md", "LICENSE", ".info/CONTENT"}
    assert metadata.fab_format_version == 1
    assert (metadata.flwr_version_min, metadata.flwr_version_target) == ("1.41", "1.41.0")


def test_the_hub_s_app_passes_what_publishing_checks(capsys: pytest.CaptureFixture[str]) -> None:
    publish = importlib.import_module("flwr.cli.app_cmd.publish")  # hidden by the function
    config, warnings = load_and_validate(HUB / "pyproject.toml", check_module=False)
    assert warnings == []
    validate_project_name(config["project"]["name"], "name")
    validate_project_name(HUB.name, "folder")
    publish._validate_description(config["project"]["description"])
    assert len(config["project"]["description"]) <= 200
    files = publish._collect_file_paths(HUB)
    publish._validate_files(files)
    assert [file.name for file in files] == ["LICENSE", "README.md", "pyproject.toml"]
    assert "Skip" not in capsys.readouterr().out


def test_the_hub_s_app_depends_on_this_version_and_says_what_the_project_says() -> None:
    own, app = project(ROOT)["project"], project(HUB)["project"]
    assert app["version"] == own["version"]
    flower = next(item for item in own["dependencies"] if item.startswith("flwr"))
    assert app["dependencies"] == [f"risfleet=={own['version']}", flower]
    assert app["requires-python"] == own["requires-python"]
    assert (HUB / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert f"risfleet-{own['version']}-py3-none-any.whl" in (HUB / "README.md").read_text()


def test_all_manifests_name_the_same_components() -> None:
    expected = vars(Components())
    for folder in (ROOT, HUB):
        found = project(folder)["tool"]["flwr"]["app"]["components"]
        assert found == {"serverapp": expected["server"], "clientapp": expected["client"]}
