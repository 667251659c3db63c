"""What the documents name exists: files, modules, classes, links; their lines are short."""

import ast
import builtins
import re
import textwrap
import unicodedata
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

import pytest
import yaml  # type: ignore[import-untyped]

from conf import Config
from conf.commented import commented_yaml
from conf.removed_keys import REMOVED

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
OURS = {
    "env", "agent", "storage", "repeatable", "lockstep", "conf", "training", "server_app",
    "client_app", "experiments", "risfleet", "benchmarks", "tools", "tests",
}  # fmt: skip
# Files that a reader is asked to write, or that commands make.
THEIRS = {
    "plans/mine.toml",
    "reproduce/runs",
    "runs/chaos/chaos.csv",
    "conf/baseline/four_levels.yaml",
    "conf/strategy/fedtrimmed.yaml",
}
# Keys that results were measured with and that are gone.
GONE = set(REMOVED) | {"agent.priority.alpha"}
# Groups of entry points, for plug-ins.
GROUPS = {
    "risfleet.rewards", "risfleet.channel_models", "risfleet.strategies",
    "risfleet.run",  # a tag of MLflow's
}  # fmt: skip
SUFFIXES = ("py", "toml", "yaml", "yml", "md", "service", "png", "csv")
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.M | re.S)


@cache
def text(page):
    return page.read_text(encoding="utf-8")


def prose(page):
    """A page without its blocks of code."""
    return FENCE.sub("", text(page))


def spans(page):
    """Code within sentences, without the test of a file that it may name."""
    found = re.findall(r"`([^`]+)`", prose(page))
    return {" ".join(span.split()).split("::")[0] for span in found}


def name_of(page):
    return str(page.relative_to(ROOT))


pages = pytest.mark.parametrize("page", PAGES, ids=name_of)


def keys(value, above=""):
    for name, inner in value.items():
        yield above + name
        if isinstance(inner, dict):
            yield from keys(inner, f"{above}{name}.")


KEYS = {*keys(yaml.safe_load(commented_yaml(Config())))}


def exists(page, name):
    return any((folder / name).exists() for folder in (ROOT, ROOT / "tests", page.parent))


@pages
def test_files_that_a_page_names_exist(page):
    named = {span for span in spans(page) if re.fullmatch(r"[\w@.-]+(/[\w@.-]+)+/?", span)}
    named = {name for name in named if name.endswith(SUFFIXES) or name.split("/")[0] in OURS}
    named = {name for name in named if not re.fullmatch(r"risfleet/[A-Z]\w+-v\d+", name)}
    assert [name for name in sorted(named - THEIRS) if not exists(page, name)] == []


def resolves(name):
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


@pages
def test_modules_and_functions_that_a_page_names_exist(page):
    dotted = {span for span in spans(page) if re.fullmatch(r"[a-z_]+(\.\w+)+", span)}
    named = {n for n in dotted if n.split(".")[0] in OURS and not n.endswith(SUFFIXES)}
    assert [name for name in sorted(named - KEYS - GONE - GROUPS) if not resolves(name)] == []


@pages
def test_modules_that_the_reference_shows_exist(page):
    shown = re.findall(r"^::: (\S+)$", text(page), re.M)
    assert [name for name in shown if not resolves(name)] == []


@cache
def sources():
    folders = [ROOT / name for name in sorted(OURS)]
    return "\n".join(path.read_text() for folder in folders for path in folder.rglob("*.py"))


@pages
def test_classes_that_a_page_names_exist(page):
    """Flower's processes and others' classes are named in our sources, too."""
    named = {s for s in spans(page) if re.fullmatch(r"(?:[A-Z]+[a-z]+){2,}(\.\w+)?", s)}
    words = {part for name in named for part in name.split(".")} - {*dir(builtins)}
    assert [word for word in sorted(words) if not re.search(rf"\b{word}\b", sources())] == []


@pages
def test_what_the_python_of_a_page_imports_exists(page):
    missing = []
    for _, language, code in FENCE.findall(text(page)):
        if language != "python":
            continue
        for node in ast.walk(ast.parse(textwrap.dedent(code))):
            if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in OURS:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                missing += [name for name in names if not resolves(name)]
    assert missing == []


def slug(heading):
    """The anchor that a heading has on GitHub and on the site."""
    plain = re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    kept = re.sub(r"[^\w\- ]", "", unicodedata.normalize("NFC", plain))
    return kept.replace(" ", "-")


@cache
def anchors(page):
    return {slug(heading) for heading in re.findall(r"^#+ (.*)$", prose(page), re.M)}


@pages
def test_links_of_a_page_lead_somewhere(page):
    broken = []
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", prose(page)):
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


@pages
def test_lines_of_a_page_are_short(page):
    lines = [line for line in prose(page).splitlines() if not line.lstrip().startswith("|")]
    assert [line for line in lines if len(line) > 100 and "![" not in line] == []


@pages
def test_a_page_begins_with_a_sentence(page):
    """Under the title stands what a reader can do with the page."""
    title, blank, first = text(page).splitlines()[:3]
    assert title.startswith("# ")
    assert blank == ""
    assert re.match(r"[A-Z`]", first)


def test_every_page_can_be_reached_from_the_readme():
    seen, pending = set(), [PAGES[0]]
    while pending:
        page = pending.pop()
        seen.add(page)
        links = re.findall(r"\]\((?!https?:)([^)\s#]+\.md)", prose(page))
        targets = {(page.parent / link).resolve() for link in links}
        pending += [target for target in targets if target.is_file() and target not in seen]
    assert [name_of(page) for page in PAGES if page not in seen] == []
