"""How arguments and options are made: readers of values, completion by a shell, actions in modules loaded late."""

import platform
import re
import tomllib
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class

from drivers.base import paths
from postproc.figures import captions

Items = list[CompletionItem[str]]


def act(module: str, function: str, **given: Any) -> Any:
    """Import a module of this package and call a function in it."""
    return getattr(import_module(f"{__package__}.{module}"), function)(**given)


def instead(names: str, text: str, module: str, function: str) -> click.Option:
    """Option that makes a command do something else, such as ``--version``."""

    def callback(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
        if asked and not context.resilient_parsing:
            act(module, function)
            context.exit()

    return option(names, text, is_eager=True, expose_value=False, callback=callback)


def print_version() -> None:
    """Print a line with the version of the project and of Python, and the commit."""
    from drivers.base.processes import git, local_changes  # takes as long to load as all others

    project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
    changes = " and changes" * local_changes()
    commit = git("rev-parse", "--short=10", "HEAD") or "unknown"
    print(f"{project['name']} {project['version']}, commit {commit}{changes}, Python {platform.python_version()}")


def option(words: str, text: str, **more: Any) -> click.Option:
    """Option of a command.

    Args:
        words: option, then the parameter of the function if it has another name, then the placeholder of the value
            in capital letters, without which it is a flag, and ``...`` if it is repeatable.
        text: help text.
        more: further arguments of ``click.Option``.
    """
    names = [word for word in words.split() if word != "..." and not word.isupper()]
    value = next((word for word in words.split() if word.isupper()), "")
    look = (
        {"metavar": value, "multiple": "..." in words.split(), **KINDS.get(value, {})} if value else {"is_flag": True}
    )
    return click.Option(names, help=text, **(look | more))


def argument(name: str, value: str, text: str, **more: Any) -> click.Argument:
    """Argument of a command, for which a placeholder stands in the help; with ``...`` there may be any number."""
    look = {"nargs": -1 if value.endswith("...") else 1, **KINDS.get(value, {})}
    return click.Argument([name], metavar=value, help=text, **(look | more))


def number(kind: Callable[[str], float], allowed: Callable[[float], bool], described: str) -> Callable[[str], float]:
    """Reader of a number within limits; unlike click's it refuses nan."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not allowed(value):
            raise click.BadParameter(f"found {text}; allowed: {described}")
        return value

    return read


def _slice(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if match and 1 <= int(match[1]) <= int(match[2]):
        return int(match[1]), int(match[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def _bodies(text: str) -> tuple[int, int]:
    if match := re.fullmatch(r"([0-9]{1,8})(?:-([0-9]{1,8}))?", text):
        return int(match[1]), int(match[2] or match[1])
    raise click.BadParameter(f"found {text}; allowed: a body, such as 9, or a range of bodies, such as 5-9")


def folder_to_write(text: str | Path) -> Path:
    """Path of a folder that can be made and written to, after a trial that leaves no file."""
    path = Path(text)
    try:
        there = next(place for place in (path, *path.parents) if place.exists() or place.is_symlink())
        with TemporaryDirectory(prefix=f".{path.name}-", dir=there):
            return path
    except OSError as error:
        allowed = "a folder that can be made and written to"
        raise click.BadParameter(f"found {path} ({error.strerror or error}); allowed: {allowed}") from error


def file_to_write(text: str) -> Path:
    """Path of a file that is there or can be made."""
    path = Path(text)
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "a device"
        raise click.BadParameter(f"found {path}, {kind}; allowed: a file")
    return folder_to_write(path.parent) / path.name


def print_paths(written: Iterable[Path]) -> None:
    """Print the paths of written files, each as soon as it is written."""
    for path in written:
        print(paths.shown(path), flush=True)


def _offer(names: Callable[[click.Context], Iterable[str]], files: str = "") -> dict[str, Any]:
    """Completion by names and files; if none begins with the incomplete word, the shell completes paths."""

    def complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> Items:
        folder, _, start = incomplete.rpartition("/")
        near = Path(folder or ("/" if incomplete.startswith("/") else ".")).expanduser()
        matching = [name for name in names(context) if name.startswith(incomplete)]
        if files and near.is_dir():
            prefix = incomplete.removesuffix(start)
            matching += [f"{prefix}{path.name}" for path in near.glob(files) if path.name.startswith(start)]
        items = [CompletionItem(name) for name in sorted(set(matching))]
        return items or [CompletionItem(incomplete, type="file")]

    return {"shell_complete": complete}


def _engine_names(context: click.Context) -> Iterable[str]:
    from drivers.engines import engine_names  # takes longer than the rest of a completion

    return engine_names()


def _run_names(context: click.Context) -> set[str]:
    folders = Path(context.params.get("runs") or paths.RUNS).glob("[!.]*/[!.]*-*-*/")
    return {f"{folder.parent.name}:{folder.name.rsplit('-', 2)[0]}" for folder in folders}


def _scene_names(context: click.Context) -> set[str]:
    return {path.stem for path in paths.SCENES.glob("*.toml")}


def _figures(context: click.Context, parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the paper's figures, with their titles where a shell shows them; else files."""
    known = [CompletionItem(name, help=text.title) for name, text in captions().items() if name.startswith(incomplete)]
    return known or [CompletionItem(incomplete, type="file")]


class Bash(BashComplete):
    """Completion of bash, which takes a colon as the end of a word, for words with colons."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Words before the incomplete one, and that one, joined again at colons."""
        before, last = super().get_completion_args()
        *before, last = re.sub("\0?:\0?", ":", "\0".join([*before, last])).split("\0")
        return before, last

    def format_completion(self, item: CompletionItem[str]) -> str:
        """Line of a completion, without the part that bash takes for earlier words."""
        whole, seen = self.get_completion_args()[1], super().get_completion_args()[1].removeprefix(":")
        return f"{item.type},{item.value.removeprefix(whole.removesuffix(seen))}"


add_completion_class(Bash)
SCENES, COUNT = _offer(_scene_names, "*.toml"), number(int, lambda count: 0 < count < 10**8, "a whole number from 1")
SCENES_AND_RUNS = _offer(lambda context: _scene_names(context) | _run_names(context), "*.toml")
KINDS: dict[str, dict[str, Any]] = {  # by the placeholder of a value: how a shell completes it, or how it is read
    "SCENE": SCENES,
    "[SCENE]...": SCENES,
    "SCENE|RUN": SCENES_AND_RUNS,
    "SCENE|RUN...": SCENES_AND_RUNS,
    "RUN": _offer(_run_names),
    "STUDY": _offer(lambda _: [path.stem for path in paths.STUDIES.glob("*.toml")], "*.toml"),
    "ENGINE": _offer(_engine_names),
    "[NAME]...": {"shell_complete": _figures},
    "DIR": {"type": folder_to_write},
    "FILE": {"type": Path},
    "FOLDER": {"type": Path},
    "SECONDS": {"type": number(float, lambda value: 0 < value < float("inf"), "seconds above zero")},
    "N": {"type": COUNT},
    "CASE": {"type": COUNT},
    "I/N": {"type": _slice},
    "A-B": {"type": _bodies},
}
