"""A chain as the integrators of ``validation.reference`` take it."""

from drivers.chain import Chain
from validation.reference.hertz_chain import HertzChain


def arrays_of(chain: Chain) -> HertzChain:
    """The arrays of a chain."""
    return HertzChain(chain.mass_kg, chain.stiffness, chain.overlap_m, chain.velocity_m_s, chain.load_N, chain.damping)
