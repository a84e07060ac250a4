"""Shell completion for names of scenes, studies, engines, runs and figures, and for paths."""

import re
from collections.abc import Iterable
from pathlib import Path

from click import Context, Parameter
from click.shell_completion import BashComplete, CompletionItem, add_completion_class

from drivers.base import paths


def _offered(names: Iterable[str], incomplete: str, files: str = "") -> list[CompletionItem[str]]:
    """Names and files that begin with the incomplete word; if there are none, the shell completes paths."""
    folder, _, start = incomplete.rpartition("/")
    near = Path(folder or ("/" if incomplete.startswith("/") else ".")).expanduser()
    found = [name for name in names if name.startswith(incomplete)]
    if files and near.is_dir():
        prefix = incomplete.removesuffix(start)
        found += [f"{prefix}{path.name}" for path in near.glob(files) if path.name.startswith(start)]
    items = [CompletionItem(name) for name in sorted(set(found))]
    return items or [CompletionItem(incomplete, type="file")]


def _names(home: Path) -> list[str]:
    return [path.stem for path in home.glob("*.toml")]


def scenes(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of shipped scenes, and TOML files."""
    return _offered(_names(paths.SCENES), incomplete, "*.toml")


def studies(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of shipped studies, and TOML files."""
    return _offered(_names(paths.STUDIES), incomplete, "*.toml")


def engines(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of engines, also of those in files of entries."""
    from drivers.engines import engine_names

    return _offered(engine_names(), incomplete)


def runs(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """``ENGINE:SCENE`` of existing run folders."""
    return _offered(_run_names(context), incomplete)


def scenes_and_runs(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of shipped scenes, TOML files, and ``ENGINE:SCENE`` of existing run folders."""
    return _offered([*_names(paths.SCENES), *_run_names(context)], incomplete, "*.toml")


def figures(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names of the paper's figures, with their titles where a shell shows them."""
    from postproc.figures import captions

    return [CompletionItem(name, help=each.title) for name, each in captions().items() if name.startswith(incomplete)]


def _run_names(context: Context) -> set[str]:
    folders = Path(context.params.get("runs") or paths.RUNS).glob("[!.]*/[!.]*-*-*/")
    return {f"{folder.parent.name}:{folder.name.rsplit('-', 2)[0]}" for folder in folders}


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
