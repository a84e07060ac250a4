"""Kratos: deck of a straight chain for the DEMApplication, reader of its arrays."""

import re
from math import sqrt
from pathlib import Path

import numpy as np

from drivers.base import decks
from drivers.base.errors import InputProblem
from drivers.base.processes import line_of
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.trace import Trace, make_trace
from drivers.engines import IN_OVERLAPS, Engine, last_line
from drivers.engines._raw_output import read_arrays
from drivers.scene.model import Material

PYTHON = "kratos-python"  # a Python with KratosDEMApplication
VERSION = """
import KratosMultiphysics.DEMApplication
from importlib.metadata import version
print("KratosDEMApplication", version("KratosDEMApplication"))
"""
OUTPUT = "kratos.npz"
MAX_PAIRS = 1_000_000  # of bodies that are no neighbours, but looked at in each step
PACKAGE = "lib/python3*/site-packages/KratosMultiphysics"  # beside the folder of its interpreter


def render(case: Case) -> decks.Deck:
    """Render ``chain.py``; a flat face is a sphere of the radius of the bead below, of the material of ``_face``."""
    chain = case.chain
    labels, flat = list(chain.materials), bool(np.isinf(chain.radius_m[-1]))
    if flat:
        labels[-1] = f"flat {labels[-1]}"
    materials = case.materials_by(labels)
    if flat:
        materials[labels[-1]] = _face(*(case.scene.materials[name].compliance for name in chain.materials[-2:]))
    radius = chain.sphere_radius_m + _above(chain)
    numbers = np.column_stack([chain.height_m + _above(chain), radius, chain.mass_kg, chain.velocity_m_s])
    text = decks.render(
        "kratos/chain.py.j2",
        case=case,
        flat=flat,
        bodies=list(zip(numbers.tolist(), labels, strict=True)),
        materials=materials,
        reach=_reach_m(chain),
    )
    return decks.Deck({"chain.py": text}, (PYTHON, "chain.py"), raw=(OUTPUT,))


def _reach_m(chain: Chain) -> float:
    """Distance to neighbours at time 0: that of the widest gap, and some more."""
    gap = np.where(chain.stiffness > 0, -chain.overlap_m, 0.0).max(initial=0.0)
    return float(f"{2 * gap + 0.1 * chain.radius_m.min():.1g}")


def refusal(case: Case) -> InputProblem | None:
    """Refuse a gap so wide that each of many bodies is within its reach."""
    chain, radius, reach_m = case.chain, case.chain.sphere_radius_m, _reach_m(case.chain)
    within = np.searchsorted(chain.height_m - radius, chain.height_m + radius + 2 * reach_m)
    pairs = int((within - np.arange(1, chain.bodies + 1)).sum())
    if pairs - chain.bodies <= MAX_PAIRS:  # each has one neighbour above without gaps
        return None
    found = f"gaps that bring {pairs:.2g} pairs of bodies within the reach of {reach_m:g} m that they need"
    return "chain.bead", found, f"at most {MAX_PAIRS:.0e} pairs: fewer beads, or narrower gaps"


def _face(bead: float, face: float) -> Material:
    """Material, with a Poisson's ratio nu, of a sphere that contacts a bead of its radius as a flat face does.

    Since R* is half that of the flat contact, the sphere has the compliance ``(bead + face) / sqrt(2) - bead``. It is
    negative for a stiff face: then nu, with the compliance ``(1 - nu^2) / E``, is above 1.
    """
    compliance = (bead + face) / sqrt(2) - bead
    poisson = 1.5 if compliance < 0 else 0.0
    return Material.model_construct(youngs_modulus=(1 - poisson**2) / compliance, poisson_ratio=poisson)


def _above(chain: Chain) -> Array:
    """Height of the spheres above their bodies: for a flat face the radius of the bead below, else 0."""
    return np.where(np.isinf(chain.radius_m), chain.radius_m[-2:][0], 0.0)


def read(case: Case, folder: Path) -> Trace:
    """Read the arrays as a trace; RunError if the file or an array is missing or incomplete."""
    chain, samples = case.chain, case.scene.samples
    arrays = read_arrays(folder / OUTPUT, dict.fromkeys(("force", "height", "velocity"), (samples, chain.bodies)))
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
    how_to_get=f"make engines CODES=kratos, or pip install KratosDEMApplication and a link {PYTHON} beside its python",
    title="Kratos",
    program=PYTHON,
    version=lambda command: line_of(command, f"-c{VERSION}", r"^KratosDEMApplication \d"),
    libraries=libraries,
    scheme=IN_OVERLAPS,  # it adds displacements to heights at time 0, so that rounding of heights does not add up
    refusal=refusal,
    render=render,
    server=decks.Deck({"serve.py": decks.render("serve.py.j2", code="kratos")}, (PYTHON, "serve.py"), raw=()),
    read=read,
    failure_reason=failure_reason,
    style={"color": "#e69f00", "ls": (0, (7, 2)), "marker": ">", "ms": 4.0},
)
