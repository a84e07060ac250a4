"""Shell completion for names of scenes, studies, engines and runs."""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from argcomplete.completers import DirectoriesCompleter, FilesCompleter

from drivers.base import paths

Completer = Callable[..., Iterable[str]]


def _inputs(home: Path) -> Completer:
    """Completes names of files in a folder, and paths of other files."""

    def complete(prefix: str, **_: Any) -> list[str]:
        return [*(path.stem for path in home.glob("*.toml")), *FilesCompleter("toml")(prefix)]

    return complete


def _engines(**_: Any) -> list[str]:
    from drivers.engines import engine_names

    return engine_names()


def _runs(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Completes ``ENGINE:SCENE`` for the existing run folders, and paths."""
    folders = Path(getattr(parsed_args, "runs", None) or paths.RUNS).glob("[!.]*/[!.]*-*-*/")
    names = {f"{folder.parent.name}:{folder.name.rsplit('-', 2)[0]}" for folder in folders}
    return [*names, *DirectoriesCompleter()(prefix)]


_scenes = _inputs(paths.SCENES)
BY_METAVAR: dict[str, Completer] = {
    "SCENE": _scenes,
    "SCENE|RUN": lambda **found: [*_scenes(**found), *_runs(**found)],
    "STUDY": _inputs(paths.STUDIES),
    "RUN": _runs,
    "ENGINE": _engines,
}


def complete(argument: argparse.Action) -> None:
    """Gives an argument the completer of its metavar."""
    if isinstance(argument.metavar, str) and argument.metavar in BY_METAVAR:
        vars(argument)["completer"] = BY_METAVAR[argument.metavar]
