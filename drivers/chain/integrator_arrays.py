"""A chain as the integrators of ``validation.reference`` take it."""

import numpy as np

from drivers.chain.chain import Chain
from validation.reference.hertz_chain import HertzChain
from validation.reference.tube_chain import TubeChain


def arrays_of(chain: Chain) -> HertzChain:
    """The arrays of a chain."""
    return HertzChain(chain.mass_kg, chain.stiffness, chain.overlap_m, chain.velocity_m_s, chain.load_N, chain.damping)


def tube_arrays_of(chain: Chain) -> TubeChain:
    """The arrays of a three-dimensional chain; its bore is a true cylinder.

    Raises:
        ValueError: the chain is straight.
    """
    lateral = chain.lateral
    if lateral is None:
        raise ValueError("chain.lateral: none, expected a three-dimensional chain")
    bore, nowhere = lateral.bore, np.zeros(chain.bodies)
    return TubeChain(
        mass_kg=chain.mass_kg,
        radius_m=chain.radius_m,
        stiffness=chain.stiffness,
        damping=chain.damping,
        shear=lateral.shear_stiffness,
        load_N=chain.load_N,
        bore_stiffness=bore.stiffness if bore else nowhere,
        bore_shear=bore.shear_stiffness if bore else nowhere,
        place_m=np.column_stack([lateral.offset_m, chain.height_m]),
        velocity_m_s=np.column_stack([lateral.velocity_m_s, chain.velocity_m_s]),
        wall_m=chain.wall_height_m,
        friction=lateral.friction,
        bore_m=bore.radius_m if bore else 0.0,
        bore_friction=bore.friction if bore else 0.0,
        turns=lateral.turns,
    )
