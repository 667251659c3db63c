"""Executes notebooks where they stand, without dates of runs, and shows them on the site.

``python -m tools.notebooks docs/examples/first_run.ipynb``
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

PATIENCE_S = 900
METADATA = {
    "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"},
    "language_info": {"name": "python"},
}
RUN = re.compile(r"runs/[\d_-]+-k\d+-s\d+")


def read(path: Path) -> NotebookNode:
    """Reads a notebook."""
    found: NotebookNode = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    return found


def executed(notebook: NotebookNode, folder: Path) -> NotebookNode:
    """Executes all cells of a notebook in their order.

    Args:
        notebook: gets the outputs.
        folder: the working folder.

    Returns:
        The same notebook.
    """
    client = NotebookClient(
        notebook,
        timeout=PATIENCE_S,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
    )
    client.execute()
    notebook.metadata.clear()
    notebook.metadata.update(METADATA)
    return notebook


def as_markdown(notebook: NotebookNode) -> str:
    """A notebook with what it shows as a page of the documentation site."""
    parts = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        parts += [_shown(output) for output in cell.outputs]
    return "\n\n".join(parts)


def _shown(output: NotebookNode) -> str:
    """One output, in the richest form that it has."""
    data = output.get("data", {"text/plain": output.get("text", "")})
    if "image/png" in data:
        picture = "".join(data["image/png"].split())
        return f'<img alt="figure" src="data:image/png;base64,{picture}">'
    if "text/html" in data:
        return str(data["text/html"])
    return f"```text\n{data['text/plain']}\n```"


def main() -> int:
    """Executes the notebooks that the command line names."""
    for path in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as folder:
            notebook = executed(read(path), Path(folder))
        text = nbformat.writes(notebook)  # type: ignore[no-untyped-call]
        path.write_text(RUN.sub("runs/NAME", text) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
