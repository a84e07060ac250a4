"""Structure of the packages: imports run one way, folders are small, module names are unique."""

import ast
import graphlib
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.base.processes import git
from drivers.engines import codes, engine_names

LAYERS = ("validation.reference", "drivers", "postproc", "validation")  # each imports those before it
MAX_LINES = 600
NAMES_A_MODULE = re.compile(r"(drivers|postproc|validation)(\.\w+)+(:\w+)?")
ENTRY_POINTS = ("__init__", "__main__", "conftest")
TOP_FOLDERS = {"inputs", "templates", "drivers", "postproc", "validation"}


def sources(root: Path = paths.ROOT, *, tests: bool = False) -> list[Path]:
    """Python files of the three packages, relative to the checkout."""
    found = [file.relative_to(root) for package in LAYERS[1:] for file in (root / package).rglob("*.py")]
    return sorted(file for file in found if tests or "tests" not in file.parts)


def module_of(file: Path) -> str:
    """Dotted module name of a file; for ``__init__.py`` the name of the package."""
    parts = file.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(file: Path, modules: set[str], root: Path = paths.ROOT) -> Iterator[str]:
    """Project modules imported anywhere in a file, also for type checking only."""
    for node in ast.walk(ast.parse((root / file).read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: a relative import"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in modules else str(node.module) for name in whole]
        else:
            continue
        yield from (name for name in names if name in modules)


def imports(root: Path = paths.ROOT) -> dict[str, set[str]]:
    """Imports of every module."""
    modules = {module_of(file) for file in sources(root)}
    return {module_of(file): set(imports_of(file, modules, root)) for file in sources(root)}


def layer_of(module: str) -> int:
    """Number of the layer of a module; ``validation.reference`` is 0."""
    return min(i for i, layer in enumerate(LAYERS) if f"{module}.".startswith(f"{layer}."))


def upward_imports(root: Path = paths.ROOT) -> list[str]:
    """Imports from a higher layer, except those of ``__main__`` modules."""
    return [
        f"{module} -> {taken}"
        for module, imported in imports(root).items()
        if not module.endswith("__main__")
        for taken in imported
        if layer_of(taken) > layer_of(module)
    ]


def test_imports_run_one_way() -> None:
    assert upward_imports() == []


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("drivers/base/errors.py", "from postproc.read import signals"),
        ("drivers/run/run.py", "def late():\n    from validation.accuracy.budget import error_budget"),
        ("postproc/read/signals.py", "import validation.checks"),
        ("validation/reference/adaptive.py", "from drivers.base.errors import InputError"),
    ],
)
def test_a_single_upward_import_is_found(tmp_path: Path, file: str, line: str) -> None:
    for package in LAYERS[1:]:
        shutil.copytree(paths.ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("tests"))
    with (tmp_path / file).open("a") as source:
        source.write(f"\n\n{line}\n")
    assert [each for each in upward_imports(tmp_path) if each.startswith(module_of(Path(file)))]


def test_no_module_is_named_in_a_string() -> None:
    """Except lazy exports of a package."""
    named = [
        (str(file), node.value)
        for file in sources()
        if file.stem != "__init__"
        for node in ast.walk(ast.parse((paths.ROOT / file).read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and NAMES_A_MODULE.fullmatch(node.value)
    ]
    assert named == []


def test_imports_run_in_no_circle() -> None:
    graphlib.TopologicalSorter(imports()).prepare()  # raises CycleError, which names the circle


def test_module_names_are_unique() -> None:
    names = Counter(file.stem for file in sources(tests=True) if file.stem not in ENTRY_POINTS)
    assert {name: count for name, count in names.items() if count > 1} == {}


def test_class_names_are_unique() -> None:
    names = Counter(
        node.name
        for file in sources()
        if file.parts[0] in ("drivers", "postproc")
        for node in ast.walk(ast.parse((paths.ROOT / file).read_text()))
        if isinstance(node, ast.ClassDef)
    )
    assert {name: count for name, count in names.items() if count > 1} == {}


def test_each_folder_has_a_docstring() -> None:
    for folder in {file.parent for file in sources(tests=True)}:
        assert ast.get_docstring(ast.parse((paths.ROOT / folder / "__init__.py").read_text())), folder


def test_modules_are_small() -> None:
    lengths = {str(file): len((paths.ROOT / file).read_text().splitlines()) for file in sources(tests=True)}
    assert {file: lines for file, lines in lengths.items() if lines > MAX_LINES} == {}


@pytest.mark.parametrize("engine", engine_names())
def test_no_module_imports_an_engine_by_name(engine: str) -> None:
    assert not [module for module, imported in imports().items() if f"drivers.engines.{engine}" in imported]


@pytest.mark.parametrize("code", codes())
def test_nothing_chooses_by_the_name_of_a_code(code: str) -> None:
    """A further engine changes no other module: its name is only in its own module, in contact laws, in data files."""
    own = {file for file in sources() if file.parts[:2] == ("drivers", "engines") and code in file.stem}
    named = {
        str(file)
        for file in sources()
        if file not in own and file.parts[:2] != ("drivers", "laws.py")
        for node in ast.walk(ast.parse((paths.ROOT / file).read_text()))
        if isinstance(node, ast.Constant) and node.value == code
    }
    assert own
    assert not named


def test_the_top_level_holds_the_five_folders() -> None:
    tracked = {name for name in git("ls-files").splitlines() if "/" in name}
    assert {name.partition("/")[0] for name in tracked if name[0] != "."} <= TOP_FOLDERS
