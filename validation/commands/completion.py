"""Shell completion for names of scenes, studies, engines, runs and figures, and for paths."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from click import Context, Parameter
from click.shell_completion import BashComplete, CompletionItem, add_completion_class

from drivers.base import paths

Completer = Callable[[Context, Parameter, str], list[CompletionItem[str]]]


def _offer(names: Callable[[Context], Iterable[str]], files: str = "") -> Completer:
    """Completion by names and files; if none begins with the incomplete word, the shell completes paths."""

    def complete(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
        folder, _, start = incomplete.rpartition("/")
        near = Path(folder or ("/" if incomplete.startswith("/") else ".")).expanduser()
        matching = [name for name in names(context) if name.startswith(incomplete)]
        if files and near.is_dir():
            prefix = incomplete.removesuffix(start)
            matching += [f"{prefix}{path.name}" for path in near.glob(files) if path.name.startswith(start)]
        items = [CompletionItem(name) for name in sorted(set(matching))]
        return items or [CompletionItem(incomplete, type="file")]

    return complete


def _engine_names(context: Context) -> Iterable[str]:
    from drivers.engines import engine_names

    return engine_names()


def _run_names(context: Context) -> set[str]:
    folders = Path(context.params.get("runs") or paths.RUNS).glob("[!.]*/[!.]*-*-*/")
    return {f"{folder.parent.name}:{folder.name.rsplit('-', 2)[0]}" for folder in folders}


def _scene_names(context: Context) -> list[str]:
    return [path.stem for path in paths.SCENES.glob("*.toml")]


scenes = _offer(_scene_names, "*.toml")
studies = _offer(lambda _: [path.stem for path in paths.STUDIES.glob("*.toml")], "*.toml")
engines = _offer(_engine_names)
runs = _offer(_run_names)
scenes_and_runs = _offer(lambda context: [*_scene_names(context), *_run_names(context)], "*.toml")


def figures(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of the paper's figures, with their titles where a shell shows them."""
    from postproc.figures import captions

    return [CompletionItem(name, help=text.title) for name, text in captions().items() if name.startswith(incomplete)]


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
