"""Fig. 1: the set-up to scale."""

from pathlib import Path

from postproc.draw.product import Product
from postproc.draw.scene_drawing import draw_scene
from postproc.paper.simulate import case_of


def make(_: Path) -> Product:
    """Draws it from Fig. 4's scene; nothing is run."""
    case = case_of("fig4")
    return Product(*draw_scene(case.scene, case.chain))
