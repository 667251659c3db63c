"""Every snippet of docs/environment.md runs as it stands."""

import re
import warnings

import pytest

from conf.overrides import FOLDER

PAGE = FOLDER.parent / "docs" / "environment.md"
SNIPPETS = re.findall(r"^## ([^\n]+)$|^```python\n(.*?)^```$", PAGE.read_text(), re.M | re.S)


def named_snippets():
    """Each snippet under the name of its section, numbered."""
    section = ""
    for heading, code in SNIPPETS:
        section = heading or section
        if code:
            yield pytest.param(code, id=section.split(":")[0].replace(" ", "_"))


def test_the_page_has_a_snippet_for_each_way_in():
    assert len(list(named_snippets())) >= 6


@pytest.mark.parametrize("code", list(named_snippets()))
def test_a_snippet_runs(code):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # TorchRL says which PettingZoo it was tested with.
        warnings.filterwarnings("ignore", message="PettingZoo in TorchRL is tested")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        exec(compile(code, str(PAGE), "exec"), {"__name__": "snippet"})


def test_the_files_that_the_page_names_exist():
    text = PAGE.read_text()
    links = re.findall(r"\]\(([\w/.]+)\)", text)
    assert links
    assert all((PAGE.parent / link).is_file() for link in links)
    assert all((FOLDER.parent / name).is_file() for name in re.findall(r"`(tests/[\w/.]+)`", text))


def test_the_readme_leads_to_the_page():
    assert "docs/environment.md" in (FOLDER.parent / "README.md").read_text()
