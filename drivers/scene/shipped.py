"""Shipped scenes, studies and materials."""

from drivers.base import paths
from drivers.base.text_table import text_table
from drivers.scene.read_scene import read_toml


def print_shipped() -> None:
    """Print names of scenes and studies with titles, and names of materials with the source of their constants."""
    for what, home in (("scenes", paths.SCENES), ("studies", paths.STUDIES)):
        _print(what, {path.stem: read_toml(path).get("title", "") for path in sorted(home.glob("*.toml"))})
    _print("materials", {name: each.get("source", "") for name, each in read_toml(paths.MATERIALS).items()})


def _print(what: str, lines: dict[str, str]) -> None:
    print(f"{what}:", *(f"  {line}" for line in text_table(lines.items())), sep="\n")
