"""Plain words: docstrings, comments, messages, names, inputs and READMEs keep the English of ``words.toml``."""

import ast
import io
import re
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base.paths import ROOT

RULES = tomllib.loads(Path(__file__).with_name("words.toml").read_text())
DOCSTRING = re.compile(rf"({RULES['openings']['docstring']})\b", re.IGNORECASE)
TEXT = re.compile(rf"({RULES['openings']['text']})\b", re.IGNORECASE)
ABSENT = re.compile(r"(no|nothing|found)\b")
PHRASES = {re.compile(rf"\b({phrase})\b", re.IGNORECASE): plain for phrase, plain in RULES["phrases"].items()}
NAMES = set(RULES["names"]["words"].split("|"))
CONSTANTS = set(RULES["constants"]["refused"].split())
PROSE = (".md", ".j2", ".toml", ".css", ".js")
QUOTED = re.compile(r'^quote = (".*"|"""(.|\n)*?""")$', re.MULTILINE)  # the paper's own words
OWNERS = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
Place = tuple[int, str]


def folders() -> list[str]:
    """The folders to read, each with the files directly in it; the checkout's own files as ``.``."""
    packages = [ROOT / name for name in ("inputs", "templates", "drivers", "postproc", "validation")]
    found = {path.parent for package in packages for path in package.rglob("*") if path.suffix in (".py", *PROSE)}
    return [".", *sorted(str(folder.relative_to(ROOT)) for folder in found)]


@pytest.mark.parametrize("folder", folders())
def test_words(folder: str) -> None:
    """No file of a folder opens a text as it should not, or uses a refused phrase or name."""
    problems = []
    for path in sorted((ROOT / folder).iterdir()):
        if path.name in ("words.toml", "test_words.py") or not (
            path.suffix in (".py", *PROSE) or path.name == "Makefile"
        ):
            continue
        found = python_problems(path.read_text()) if path.suffix == ".py" else prose_problems(path)
        problems += [f"{path.relative_to(ROOT)}:{line}: {problem}" for line, problem in sorted(set(found))]
    assert not problems, "\n" + "\n".join(problems)


def python_problems(source: str) -> Iterator[Place]:
    """Problems of a module: its docstrings, comments, strings and names."""
    tree = ast.parse(source)
    docstrings = {}
    for node in ast.walk(tree):
        if isinstance(node, OWNERS) and (text := ast.get_docstring(node)):
            docstrings[node.body[0].lineno] = text
            if opening := DOCSTRING.match(text):
                yield node.body[0].lineno, f"docstring opens with {opening[0]!r}"
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and " " in node.value
            and node.lineno not in docstrings
            and (opening := TEXT.match(node.value))
        ):
            yield node.lineno, f"text opens with {opening[0]!r}"
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "InputError" and len(node.args) > 3:
            found = ast.unparse(node.args[2]).lstrip("f").strip("'\"")
            if ABSENT.match(found):
                yield node.lineno, f"'found {found}' reads oddly: write a statement, such as 'file not found'"
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and (opening := TEXT.match(token.string.lstrip("#: "))):
            yield token.start[0], f"comment opens with {opening[0]!r}"
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            yield from phrases(token.string, token.start[0])
    yield from names(tree)


def names(tree: ast.Module) -> Iterator[Place]:
    """Refused names of functions, classes, arguments and constants."""
    for node in ast.walk(tree):
        name = node.arg if isinstance(node, ast.arg) else getattr(node, "name", None)
        if isinstance(name, str) and NAMES & set(re.split(r"_|(?<=[a-z])(?=[A-Z])", name.lower())):
            yield getattr(node, "lineno", 1), f"name {name}"
    for statement in tree.body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        for target in targets:
            if isinstance(target, ast.Name) and target.id.lstrip("_") in CONSTANTS:
                yield statement.lineno, f"constant {target.id} is no noun"


def prose_problems(path: Path) -> Iterator[Place]:
    """Problems of a text file: its phrases; of a TOML file how its comments and texts open as well."""
    text = QUOTED.sub(lambda quote: "\n" * quote[0].count("\n"), path.read_text())
    yield from phrases(text, 1)
    if path.suffix == ".toml":
        for number, line in enumerate(text.splitlines(), 1):
            if opening := TEXT.match(re.sub(r'^(\w+ = )?["#\s]*', "", line)):
                yield number, f"text opens with {opening[0]!r}"


def phrases(text: str, first_line: int) -> Iterator[Place]:
    """Refused phrases of a text whose first line has that number."""
    for pattern, plain in PHRASES.items():
        for found in pattern.finditer(text):
            yield first_line + text.count("\n", 0, found.start()), f"{found[0]!r}: write {plain}"


def test_the_rules_refuse() -> None:
    """Examples of what the rules are for, each refused for its reason, and plain English taken."""
    refused = '''
"""What it does."""
MOST = 3
def told_again(x):
    """Whether x."""
    # that of the bead
    raise ValueError("what was found " + "mend it")
raise InputError("x.toml", "key", "nothing", "a number")
'''
    kinds = [problem for _, problem in python_problems(refused)]
    for part in (
        "opens with 'What'",
        "constant MOST",
        "name told_again",
        "opens with 'Whether'",
        "comment",
        "text opens",
        "a statement",
        "'mend'",
    ):
        assert any(part in kind for kind in kinds), part
    assert not list(python_problems('"""Largest overlap."""\nMAX_BEADS = 3  # memory\n'))
