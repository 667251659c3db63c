"""Files as editors leave them: marks, line ends and encodings."""

import ast
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conf.overrides import FOLDER
from env.texts import read_text, read_unmarked_text

ROOT = FOLDER.parent
OURS = ("env", "agent", "conf", "client_app", "server_app", "experiments", "benchmarks", "docs")
OF_LINUX = {"agent/threads.py", "benchmarks/memory.py", "conf/fingerprint.py"}
"""Read below /proc alone."""


@given(st.text(st.characters(codec="utf-8", exclude_characters="\r\0\ufeff")))
def test_marks_and_line_ends_make_no_difference(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("text") / "file"
    for encoding in ("utf-8", "utf-8-sig"):
        for end in ("\n", "\r\n", "\r"):
            path.write_bytes(text.replace("\n", end).encode(encoding))
            assert read_text(path) == text


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a = 1\n".encode("utf-16"), "it is in UTF-16: save it as UTF-8"),
        (b"\xfe\xff" + "a = 1\n".encode("utf-16-be"), "it is in UTF-16: save it as UTF-8"),
        ("a = 1\n".encode("utf-32"), "it is in UTF-32: save it as UTF-8"),
        ("a = 1\n".encode("utf-16-le"), "it holds zero bytes, as UTF-16 does: save it as UTF-8"),
        (
            "# ok\n# Flur für\n".encode("latin-1"),
            "line 2 holds the byte 0xfc, which is not UTF-8: save it as UTF-8",
        ),
    ],
)
def test_another_encoding_is_named_with_what_to_do(tmp_path, content, said):
    path = tmp_path / "file"
    path.write_bytes(content)
    for read in (read_text, lambda path: read_unmarked_text(path, "Hydra")):
        with pytest.raises(UnicodeError, match="save it as UTF-8") as caught:
            read(path)
        assert str(caught.value) == said


def test_a_mark_is_refused_where_another_program_reads_the_file(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a: 1\r\n")
    assert read_unmarked_text(path, "Hydra") == "a: 1\n"
    path.write_bytes("a: 1\n".encode("utf-8-sig"))
    with pytest.raises(UnicodeError, match="which Hydra does not read: save it as UTF-8 without"):
        read_unmarked_text(path, "Hydra")


def opened_as_text(tree):
    """The calls that read or write text, with whether each one names an encoding."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        if name == "read_text" and isinstance(node.func, ast.Name):
            continue  # ours
        modes = [a.value for a in node.args if isinstance(a, ast.Constant)]
        binary = any(re.fullmatch(r"[rwax]\+?b\+?", str(mode)) for mode in modes)
        opens = name == "open" and not ast.unparse(node.func).startswith("os.") and not binary
        if opens or name in ("read_text", "write_text"):
            yield node.lineno, any(word.arg == "encoding" for word in node.keywords)


@pytest.mark.parametrize("part", OURS)
def test_whoever_opens_a_text_file_names_its_encoding(part):
    found = {
        f"{path.relative_to(ROOT)}:{line}"
        for path in (ROOT / part).rglob("*.py")
        for line, named in opened_as_text(ast.parse(path.read_text(encoding="utf-8")))
        if not named and str(path.relative_to(ROOT)) not in OF_LINUX
    }
    assert found == set()
