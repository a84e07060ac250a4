"""The command ``beads explore``, apart from others, since Bokeh takes long to load."""

from pathlib import Path

from validation.explore.server import serve
from validation.explore.views import Question


def explore(
    scene: str, settings: tuple[str, ...], knobs: tuple[str, ...], quiet: bool, runs: Path, results: Path
) -> None:
    """Turn the values of a scene and watch the forces, in a browser.

    The page is served on this machine alone, at an address that is printed.

    Examples:
      beads explore fig4
      beads explore shot.toml --knob striker.speed=0.1..5
    """
    serve(Question(scene, settings), knobs, runs, results, browser=not quiet)
