"""Kratos: deck of a straight chain for the DEMApplication, reader of its arrays."""

import re
from math import sqrt
from pathlib import Path

import numpy as np

from drivers.base.decks import Deck
from drivers.base.decks import render as render_template
from drivers.base.processes import line_of
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.drives import drive_words, pieces_of
from drivers.chain.trace import Trace, make_trace
from drivers.engines import IN_OVERLAPS, Engine, last_line
from drivers.engines._raw_output import read_arrays

PACKAGE = "lib/python3*/site-packages/KratosMultiphysics"  # beside the folder of its interpreter


def render(case: Case) -> Deck:
    """Render ``chain.py``; a flat face is a sphere of the radius of the bead below, of the material of ``_face``."""
    chain, scene = case.chain, case.scene
    labels, flat = list(chain.materials), bool(np.isinf(chain.radius_m[-1]))
    if flat:
        labels[-1] = f"flat {labels[-1]}"
    named = [*zip(labels, chain.materials, strict=True), *([(chain.wall, chain.wall)] if chain.wall else [])]
    constants = {label: scene.elastic_constants(name) for label, name in named}
    if flat:
        constants[labels[-1]] = _face(*(scene.materials[name].compliance for name in chain.materials[-2:]))
    radius = chain.sphere_radius_m + _above(chain)
    numbers = np.column_stack([chain.height_m + _above(chain), radius, chain.mass_kg, chain.velocity_m_s])
    gap = np.where(chain.stiffness > 0, -chain.overlap_m, 0.0).max(initial=0.0)
    text = render_template(
        "kratos/chain.py.j2",
        case=case,
        flat=flat,
        bodies=list(zip(numbers.tolist(), labels, strict=True)),
        materials=[(label, *values) for label, values in constants.items()],
        reach=float(f"{2 * gap + 0.1 * radius.min():.1g}"),
        pieces=pieces_of(chain.drive, scene.time_step_s, scene.steps),
        drive_words=drive_words(scene),
    )
    return Deck({"chain.py": text}, ("kratos", "chain.py"), raw=("chain.npz",))


def _face(bead: float, face: float) -> tuple[float, float]:
    """Young's modulus and Poisson's ratio nu of a sphere that contacts a bead of its radius as a flat face does.

    Since R* is half that of the flat contact, the sphere has the compliance ``(bead + face) / sqrt(2) - bead``. It is
    negative for a stiff face: then nu, with the compliance ``(1 - nu^2) / E``, is above 1.
    """
    compliance = (bead + face) / sqrt(2) - bead
    poisson = 1.5 if compliance < 0 else 0.0
    return (1 - poisson**2) / compliance, poisson


def _above(chain: Chain) -> Array:
    """Height of the spheres above their bodies: for a flat face the radius of the bead below, else 0."""
    return np.where(np.isinf(chain.radius_m), chain.radius_m[-2:][0], 0.0)


def read(case: Case, folder: Path) -> Trace:
    """Read the arrays as a trace; RunError if the file or an array is missing or incomplete."""
    chain, samples = case.chain, case.scene.samples
    arrays = read_arrays(folder / "chain.npz", dict.fromkeys(("force", "height", "velocity"), (samples, chain.bodies)))
    height = arrays["height"] - _above(chain)
    return make_trace(chain, case.sample_times_s, arrays["force"], height, arrays["velocity"])


def libraries(program: Path) -> list[Path]:
    """Files that ``import`` loads of Kratos' packages beside the folder of an interpreter."""
    loaded = (".libs/*.so", "*.py", "DEMApplication/__init__.py")
    return sorted(file for name in loaded for file in program.parent.parent.glob(f"{PACKAGE}/{name}"))


def failure_reason(stdout: str, stderr: str) -> str:
    """Line of Python's error; an error of Kratos continues with its source lines and names that it knows."""
    errors = re.findall(r"^\w*(?:Error|Exception)\b.*", stderr, re.MULTILINE)
    return errors[-1] if errors else last_line(stdout, stderr)


ENGINE = Engine(
    how_to_get="make engines CODES=kratos, or pip install KratosDEMApplication, with a link kratos to the interpreter",
    program="kratos",
    version=lambda command: line_of(command, "-cimport KratosMultiphysics", r"Multi-Physics \d"),
    libraries=libraries,
    scheme=IN_OVERLAPS,  # it adds displacements to heights at time 0, so that rounding of heights does not add up
    render=render,
    server=Deck({"serve.py": render_template("kratos/serve.py.j2")}, ("kratos", "serve.py"), raw=()),
    read=read,
    failure_reason=failure_reason,
    loop_pattern=r"^completed \d+ steps in ([0-9.]+) s$",
    style={"color": "#e69f00", "ls": (0, (7, 2)), "marker": ">", "ms": 4.0},
)
