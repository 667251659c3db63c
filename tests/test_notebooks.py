"""The notebooks in docs/examples run from their first cell to their figure, and show no dates."""

from __future__ import annotations

import base64
import re
from pathlib import Path
from typing import Any

import nbformat
import pytest
from jupyter_client.manager import KernelManager

from tools.notebooks import executed, read

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
FIRST_RUN = EXAMPLES / "first_run.ipynb"
SHORTER = """"train.max_ticks": 160, "train.worlds": 4, "agent.learn_from": 100,
        "agent.batch_size": 16, "evaluation.episodes": 4, "evaluation.every": 4,"""


@pytest.fixture(autouse=True)
def _no_traces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What Jupyter writes beside the notebook goes elsewhere."""
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / name))


def first_run() -> Any:
    return read(FIRST_RUN)


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def figures(notebook: Any) -> list[bytes]:
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    shown = [output.get("data", {}).get("image/png") for output in outputs]
    return [base64.b64decode(image) for image in shown if image]


def table(cell: Any) -> str:
    return str(cell.outputs[-1].data["text/html"])


def learned(notebook: Any) -> list[float]:
    """The row of the third cell's table."""
    row = code_cells(notebook)[2].outputs[-1].data["text/plain"].splitlines()[1]
    return [float(value) for value in row.split()[1:]]


@pytest.mark.slow
def test_the_first_run_comes_to_a_figure(tmp_path: Path) -> None:
    notebook = first_run()
    cells = code_cells(notebook)
    for cell, said, instead in (
        (cells[0], '"train.max_ticks": 300,', SHORTER),
        (cells[0], '"evaluation.every": 60,', ""),
        (cells[2], "episodes=100", "episodes=4"),
    ):
        assert said in cell.source
        cell.source = cell.source.replace(said, instead)
    executed(notebook, tmp_path)
    train, run, *_ = code_cells(notebook)
    (progress,) = train.outputs  # one line, which changed in its place
    assert "done" in progress.data["text/plain"]
    assert "160 ticks" in table(run)
    (picture,) = figures(notebook)
    assert picture.startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_first_run_learns_what_it_says(tmp_path: Path) -> None:
    notebook = executed(first_run(), tmp_path)
    success, _, ee, *_ = learned(notebook)
    assert success >= 0.95
    assert ee == pytest.approx(learned(first_run())[2], rel=0.1)


def test_the_first_run_is_kept_as_it_was_executed() -> None:
    notebook, text = first_run(), FIRST_RUN.read_text()
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == [1, 2, 3, 4, 5]
    assert len(figures(notebook)) == 1
    assert len(text) < 200_000
    assert not re.search(r"\b20\d\d-\d\d|/home/|/tmp/|/root/|Traceback", text)
    nbformat.validate(notebook)


@pytest.mark.slow
def test_a_kernels_interrupt_ends_a_run_and_keeps_it(
    tmp_path: Path, tiny_overrides: tuple[str, ...]
) -> None:
    endless = [*tiny_overrides, "train.max_ticks=null", "train.episodes=100000000", "run.dir=run"]
    source = (
        "import risfleet\n"
        f"run = risfleet.train({endless!r}, progress=lambda status: print(status['state']))\n"
        "print('kept', run.stopped_early)"
    )
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(tmp_path))
    client = manager.client()
    try:
        client.start_channels()
        client.wait_for_ready(timeout=300)
        client.execute(source)
        said, interrupted = "", False
        while "kept" not in said:
            content = client.get_iopub_msg(timeout=300)["content"]
            assert "ename" not in content, content
            said += content.get("text", "")
            if "training" in said and not interrupted:
                manager.interrupt_kernel()
                interrupted = True
        assert said.endswith("kept True\n")
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
