"""Contacts with the bore and start of a three-dimensional chain.

Beads pressed onto the wall by gravity or a precompression start at the frictionless equilibrium closest to their seeded
positions, where they lean alternately against the bore. All other beads start at their seeded positions and just touch.

The equilibrium is a minimum of the potential energy, found by damped Newton steps (Levenberg and Marquardt). The
Hessian is banded, since beads touch neighbours only.
"""

from dataclasses import replace
from functools import cache
from math import pi, sqrt

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from drivers.base.cache import cached
from drivers.base.errors import InputError
from drivers.chain.chain import AT_REST, Array, Chain, contact_stiffness_at, hertz_stiffness, stiffness_by
from drivers.scene.model import Material, Scene
from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT

OFFSET_STREAM = 1  # stream of random numbers; masses have another stream
POLISHING_STEPS = 5  # Newton steps after convergence, to reach the rounding error
MAX_STEPS = 20_000  # Newton steps
MAX_SHIFT = 1e3  # in contact stiffnesses; a larger shift ends the search
MIN_SHIFT = 1e-14  # in contact stiffnesses; without a shift the Hessian is singular, by rotation about the axis
MAX_STEP_SHARE = 0.25  # of a bead's play; its largest step


def mindlin_stiffness(first: Material, radius_1_m: float, second: Material, radius_2_m: float) -> float:
    """Shear stiffness k_t in ``dF_t = k_t sqrt(overlap) ds``, in N m^-3/2.

    ``k_t = 8 G* sqrt(R*)`` with ``1/G* = 2(2-nu1)(1+nu1)/E1 + 2(2-nu2)(1+nu2)/E2``: Mindlin's contact without slip.
    """
    soft = (2 * (2 - m.poisson_ratio) * (1 + m.poisson_ratio) / m.youngs_modulus for m in (first, second))
    return 8 / sum(soft) / sqrt(1 / radius_1_m + 1 / radius_2_m)


@cache
def conformity(radius_m: float, bore_radius_m: float) -> float:
    """Ratio of the contact stiffness of a sphere in a bore to that on a flat of the same material.

    Hertz's elliptic contact (Johnson, Contact Mechanics, section 4.2) with the relative curvatures ``1/R - 1/R_bore``
    across the axis and ``1/R`` along the axis; the force is proportional to overlap^(3/2) as well. A bore radius of
    inf is a flat.
    """
    from scipy.optimize import brentq
    from scipy.special import ellipe, ellipkm1

    across, along = (1 / radius_m - 1 / bore_radius_m) / 2, 1 / radius_m / 2
    if across == along:
        return 1.0

    def curvatures(squared: float) -> tuple[float, float]:
        """``E/m - K`` and ``K - E``; their ratio is that of the relative curvatures along and across the axis."""
        second, first = float(ellipkm1(squared)), float(ellipe(1 - squared))
        return first / squared - second, second - first

    # m = (b/a)^2 of the ellipse's axes a > b
    squared = brentq(lambda m: np.divide(*curvatures(m)) - along / across, 1e-300, 1 - 1e-12, xtol=1e-300, rtol=1e-15)
    over, under = curvatures(squared)
    second, curved = float(ellipkm1(squared)), sqrt(over * under)
    f1_cubed = 4 / (pi * (1 - squared)) * squared**0.75 * curved
    f2 = 2 / pi * squared**0.25 * f1_cubed ** (-1 / 3) * second
    mean_radius = 1 / (2 * sqrt(across * along))
    return float(sqrt(mean_radius / radius_m) * f2**-1.5)


def with_lateral(scene: Scene, chain: Chain) -> Chain:
    """Chain with the additional properties and the start of a three-dimensional scene.

    Raises:
        InputError: no equilibrium was found.
    """
    chain = _with_bore(scene, chain)
    started = replace(
        chain,
        straight=False,
        across_m=_seeded_offsets(scene, chain),
        shear_stiffness=stiffness_by(mindlin_stiffness, scene, chain.materials, chain.radius_m),
        friction=scene.contact.friction,
        turns=scene.contact.rotation and max(scene.contact.friction, chain.bore_friction) > 0,
    )
    pressed = chain.overlap_m[: chain.beads] > 0  # beads pressed onto the wall
    resting = int(pressed.argmin()) if not pressed.all() else chain.beads
    if not started.bore_m or not started.across_m[:resting].any():
        return started
    return _packed(scene, started, resting)


def _seeded_offsets(scene: Scene, chain: Chain) -> Array:
    """Positions across the axis, drawn from a normal distribution and limited to the play. Shape (bodies, 2)."""
    tube, spread = scene.tube, scene.chain.lateral_offset
    if tube is None or not spread:
        return np.zeros((chain.bodies, 2))
    offset = np.random.default_rng([scene.seed, OFFSET_STREAM]).normal(0.0, spread, (chain.bodies, 2))
    play = np.maximum(tube.inner_diameter / 2 - chain.radius_m, 0.0)  # a wider body is above the tube, on the axis
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-300)
    return np.asarray(offset * np.minimum(1.0, play / distance)[:, np.newaxis])


def _with_bore(scene: Scene, chain: Chain) -> Chain:
    """Chain with the contacts of its bodies with the bore, if there is a tube."""
    tube = scene.tube
    if tube is None:
        return chain
    bore_m, top = tube.inner_diameter / 2, np.inf if tube.top is None else tube.top
    stiffness, shear = np.zeros((2, chain.bodies))
    for j in np.flatnonzero((chain.radius_m < bore_m) & (chain.height_m <= top)):
        radius = chain.radius_m[j]
        contact = scene.materials[tube.material], np.inf, scene.materials[chain.materials[j]], radius
        stiffness[j] = conformity(radius, bore_m) * hertz_stiffness(*contact)
        shear[j] = conformity(radius, bore_m) * mindlin_stiffness(*contact)
    return replace(
        chain, bore_m=bore_m, bore_stiffness=stiffness, bore_shear=shear, bore_friction=tube.friction, top_m=top
    )


def _packed(scene: Scene, chain: Chain, resting: int) -> Chain:
    """Chain with its lowest ``resting`` beads in equilibrium."""
    touching = replace(chain, overlap_m=np.minimum(chain.overlap_m, 0.0))
    start = np.column_stack([chain.across_m, touching.height_m - chain.wall_height_m])[:resting]
    of_beads = (chain.load_N, chain.stiffness, chain.radius_m, chain.bore_stiffness)
    depends_on = [start.tolist(), *(values[:resting].tolist() for values in of_beads), chain.bore_m]
    found = cached(["rest", depends_on], lambda: [array.tolist() for array in find_rest(chain, start)])
    place, left = map(np.array, found)
    worst = int(np.argmax(left))
    if left[worst] > AT_REST * float(np.abs(chain.load_N[:resting]).sum()):
        unbalanced = f"no equilibrium: {left[worst]:.2g} N are unbalanced on bead {worst + 1}"
        allowed = f"at most {AT_REST:g} of the load; try fewer beads, another seed or a wider tube"
        raise InputError(scene.file, "chain.lateral_offset", unbalanced, allowed)
    across, overlap = chain.across_m.copy(), chain.overlap_m.copy()
    across[:resting] = place[:, :2]
    along = np.diff(place, axis=0)
    radius = chain.radius_m[:resting]
    overlap[0] = radius[0] - place[0, 2]
    overlap[1:resting] = radius[1:] + radius[:-1] - np.sqrt((along**2).sum(axis=1))
    return replace(chain, overlap_m=overlap, across_m=across)


def find_rest(chain: Chain, place_m: Array) -> tuple[Array, Array]:
    """Frictionless equilibrium of a chain's lowest beads.

    Args:
        chain: the chain.
        place_m: positions to start from, heights above the wall, shape (beads, 3).

    Returns:
        Positions in equilibrium, and the unbalanced force on each bead in N.
    """
    place, shift, beads = place_m.copy(), 1e-6, len(place_m)
    load = float(np.abs(chain.load_N[:beads]).sum())
    scale = contact_stiffness_at(chain.stiffness[:beads].max(), load)
    longest = MAX_STEP_SHARE * float((chain.bore_m - chain.radius_m[:beads]).min())
    rounding = 1e-15 * load * float(place[-1, 2])  # rounding error of the energy; smaller decreases are accepted
    energy, gradient, bands = _potential(chain, place)
    best, least, polished = place, float(np.abs(gradient).max()), 0
    for _ in range(MAX_STEPS):
        polished += least <= AT_REST * load
        if polished > POLISHING_STEPS or shift > MAX_SHIFT:
            break
        step = _step(bands, gradient, shift * scale)
        if step is not None and np.abs(step).max() <= longest:
            trial = _potential(chain, place + step)
            if trial[0] < energy or -float((gradient * step).sum()) < rounding:
                place, (energy, gradient, bands) = place + step, trial
                residual = float(np.abs(gradient).max())
                if residual < least:
                    best, least = place, residual
                shift = max(shift / 4, MIN_SHIFT)
                continue
        shift = max(4 * shift, 1e-12)
    return best, np.abs(_potential(chain, best)[1]).max(axis=1)


def _step(bands: Array, gradient: Array, shift: float) -> Array | None:
    """Newton step with ``shift`` added to the Hessian's diagonal; None if the Hessian is not positive definite."""
    shifted = bands.copy()
    shifted[-1] += shift
    try:
        return np.asarray(solveh_banded(shifted, -gradient.ravel(), check_finite=False)).reshape(-1, 3)
    except LinAlgError:
        return None


def _potential(chain: Chain, place: Array) -> tuple[float, Array, Array]:
    """Potential energy, its gradient (beads, 3), and its Hessian as upper bands (6, 3 beads)."""
    count = len(place)
    radius, load, stiffness = chain.radius_m[:count], chain.load_N[:count], chain.stiffness[:count]
    gradient, diagonal = np.zeros((count, 3)), np.zeros((count, 3, 3))
    gradient[:, 2] -= load

    along = np.diff(place, axis=0)
    distance = np.linalg.norm(along, axis=1)
    pairs_J, pull, block = _contacts(stiffness[1:], along, distance, radius[1:] + radius[:-1] - distance, -1)
    gradient[1:] += pull
    gradient[:-1] -= pull
    diagonal[1:] += block
    diagonal[:-1] += block

    height = place[:1, 2]
    wall_J, pull, bent = _contacts(stiffness[:1], height[:, None], height, radius[:1] - height, -1)
    gradient[:1, 2:] += pull
    diagonal[:1, 2:, 2:] += bent

    across = place[:, :2]
    off = np.maximum(np.hypot(across[:, 0], across[:, 1]), 1e-300)
    bore_J, push, bent = _contacts(chain.bore_stiffness[:count], across, off, off + radius - chain.bore_m, 1)
    gradient[:, :2] += push
    diagonal[:, :2, :2] += bent
    return -float(load @ place[:, 2]) + (pairs_J + wall_J + bore_J), gradient, _block_bands(diagonal, -block)


def _contacts(stiffness: Array, vector: Array, length: Array, overlap: Array, sign: int) -> tuple[float, Array, Array]:
    """Energy of Hertz contacts, its gradient (contacts, n), and its Hessian (contacts, n, n), by a vector of each.

    Args:
        stiffness: stiffness of each contact. Shape (contacts,).
        vector: vector of each contact. Shape (contacts, n).
        length: length of each vector. Shape (contacts,).
        overlap: overlap of each contact. Shape (contacts,).
        sign: 1 if overlaps grow with the length of the vector, as in the bore, -1 if they shrink, as between beads.
    """
    closed = np.maximum(overlap, 0.0)
    root = np.sqrt(closed)
    energy, slope = ENERGY_SHARE * stiffness * closed**2 * root, EXPONENT * stiffness * root
    force = stiffness * closed * root
    normal = vector / length[:, None]
    outer = normal[:, :, None] * normal[:, None, :]
    turned = (sign * force / length)[:, None, None] * (np.eye(vector.shape[1]) - outer)
    return float(energy.sum()), (sign * force)[:, None] * normal, slope[:, None, None] * outer + turned


def _block_bands(diagonal: Array, coupling: Array) -> Array:
    """Upper bands, in scipy's layout, of a symmetric block-tridiagonal matrix.

    Args:
        diagonal: blocks on the diagonal, shape (bodies, 3, 3).
        coupling: blocks above the diagonal, shape (bodies - 1, 3, 3).
    """
    bands = np.zeros((6, 3 * len(diagonal)))
    for row in range(3):
        for column in range(3):
            if column >= row:
                bands[5 - (column - row), column::3] = diagonal[:, row, column]
            bands[5 - (column + 3 - row), 3 + column :: 3] = coupling[:, row, column]
    return bands
