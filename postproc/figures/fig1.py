"""Fig. 1: the set-up, drawn to scale from Fig. 4's scene."""

from pathlib import Path

from postproc.draw.product import Product
from postproc.draw.scene_drawing import draw_scene


def make(runs: Path) -> Product:
    """Draws it; nothing is run."""
    from drivers.chain.case import build_case
    from drivers.scene.read_scene import read_scene

    case = build_case(read_scene("fig4"))
    return Product(*draw_scene(case.scene, case.chain))
