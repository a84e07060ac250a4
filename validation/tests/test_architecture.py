"""Imports run one way, so that each part can be read and changed by itself."""

import ast
from pathlib import Path

import pytest

from drivers import paths
from drivers.engines import codes, engine_names

PACKAGES = ("drivers", "postproc", "validation")


def imports_of(folder: Path) -> set[tuple[str, str]]:
    """Pairs of a file and a project module it imports, wherever in the file."""
    found = set()
    for file in folder.rglob("*.py"):
        if "tests" in file.parts:
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            elif isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            else:
                continue
            found |= {(str(file.relative_to(paths.ROOT)), m) for m in modules if m.split(".")[0] in PACKAGES}
    return found


def test_the_reference_stands_on_nothing() -> None:
    modules = {module for _, module in imports_of(paths.ROOT / "validation" / "reference")}
    assert all(module.startswith("validation.reference") for module in modules)


def test_post_processing_knows_no_engine() -> None:
    composing = ("postproc/figures/", "postproc/__main__.py")  # they run what they draw
    modules = {module for file, module in imports_of(paths.ROOT / "postproc") if not file.startswith(composing)}
    assert not {m for m in modules if m.startswith(("validation", "drivers.engines", "drivers.case", "drivers.run"))}


def test_nobody_below_imports_a_figure() -> None:
    users = {file for package in PACKAGES for file, module in imports_of(paths.ROOT / package)
             if module.startswith("postproc.figures")}  # fmt: skip
    assert not users


def test_engines_know_no_post_processing() -> None:
    modules = {module for _, module in imports_of(paths.ROOT / "drivers" / "engines")}
    assert not {module for module in modules if module.startswith(("postproc", "validation"))}


@pytest.mark.parametrize("engine", engine_names())
def test_nobody_else_imports_an_engine_by_name(engine: str) -> None:
    users = {file for package in PACKAGES for file, module in imports_of(paths.ROOT / package)
             if module == f"drivers.engines.{engine}"}  # fmt: skip
    assert not users


@pytest.mark.parametrize("code", codes())
def test_what_judges_runs_chooses_nothing_by_a_codes_name(code: str) -> None:
    """A further engine touches none of it; words for people may name what a code does."""
    folders = [paths.ROOT / "validation" / each for each in ("departure", "diagnosis", "independent", "pair", "report")]
    files = [file for folder in folders for file in folder.rglob("*.py")]
    named = {str(file) for file in files for node in ast.walk(ast.parse(file.read_text()))
             if isinstance(node, ast.Constant) and node.value == code}  # fmt: skip
    assert all(folder.is_dir() for folder in folders)
    assert not named


def test_modules_are_small() -> None:
    long = {str(file): n for package in PACKAGES for file in (paths.ROOT / package).rglob("*.py")
            if (n := len(file.read_text().splitlines())) > 400}  # fmt: skip
    assert not long
