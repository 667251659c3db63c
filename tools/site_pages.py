"""Pages and files of the documentation site that lie outside of ``docs/``.

The README is its first page; CONTRIBUTING, CHANGELOG, LICENSE, CITATION.cff and ``results/`` keep
their places below the root, and notebooks become pages. Links are written for GitHub, where
``docs/`` is a folder of its own: here they lose ``docs/`` on the way down and a ``../`` on the way
up.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import Any

from mkdocs.structure.files import File, Files  # type: ignore[import-not-found, unused-ignore]

from tools.notebooks import as_markdown, read

ROOT = Path(__file__).parent.parent
NOTEBOOK = ".ipynb"
PAGES = ("CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "CITATION.cff")
LINK = re.compile(r"(\]\()((?!https?:|mailto:|#)[^)#\s]+)([^)]*\))")


def outside() -> dict[str, Path]:
    """Each such file by its place on the site."""
    found = {"index.md": ROOT / "README.md"} | {name: ROOT / name for name in PAGES}
    for path in sorted((ROOT / "results").rglob("*")):
        if path.is_file():
            found[path.relative_to(ROOT).as_posix()] = path
    return found


def on_files(files: Files, config: Any) -> Files:
    """Adds them to the site's files."""
    for place, path in outside().items():
        files.append(File.generated(config, place, abs_src_path=str(path)))
    for path in sorted((ROOT / "docs").rglob(f"*{NOTEBOOK}")):
        place = path.relative_to(ROOT / "docs").with_suffix(".md").as_posix()
        files.append(File.generated(config, place, content=as_markdown(read(path))))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Makes links of the repository into links of the site."""
    place = page.file.src_uri
    repository = _in_repository(place)

    def moved(found: re.Match[str]) -> str:
        target = normpath((PurePosixPath(repository).parent / found[2]).as_posix())
        link = relpath(_on_site(target), PurePosixPath(place).parent.as_posix() or ".")
        return f"{found[1]}{link}{found[3]}"

    return LINK.sub(moved, markdown)


def _in_repository(place: str) -> str:
    if place == "index.md":
        return "README.md"
    return place if place in outside() else f"docs/{place}"


def _on_site(target: str) -> str:
    if target == "README.md":
        return "index.md"
    if target == "results":
        return "results/weights/README.md"
    if target.endswith(NOTEBOOK):
        target = f"{target.removesuffix(NOTEBOOK)}.md"
    return target.removeprefix("docs/")
