"""How well the reference conserves energy and momentum; the codes' balances stand in the report."""

from postproc.paper.simulate import Simulation, case_of, exact


def _fig4() -> Simulation:
    return exact(case_of("fig4"))


def momentum() -> float:
    """Momentum error on Fig. 4's scene before the wave reaches the wall, per cent of the largest momentum."""
    return 100 * _fig4().values["momentum_error_before_wall_share"]


def energy() -> float:
    """Energy error over all times, per cent of the striker's energy."""
    one = _fig4()
    return 100 * one.values["energy_drift_J"] / one.values["kinetic_energy_start_J"]


COMPUTED = {"conservation-momentum": momentum, "conservation-energy": energy}
