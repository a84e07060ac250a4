"""Scenes, studies and materials that come with the checkout."""

from drivers.base import paths
from drivers.scene.read_scene import read_toml


def print_shipped() -> None:
    """Prints their names, each with its title, or the source of its constants."""
    for what, home in (("scenes", paths.SCENES), ("studies", paths.STUDIES)):
        _print(what, {path.stem: read_toml(path).get("title", "") for path in sorted(home.glob("*.toml"))})
    _print("materials", {name: each.get("source", "") for name, each in read_toml(paths.MATERIALS).items()})


def _print(what: str, lines: dict[str, str]) -> None:
    width = max(map(len, lines))
    print(f"{what}:", *(f"  {name:<{width}}  {text}".rstrip() for name, text in lines.items()), sep="\n")
