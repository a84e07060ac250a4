"""Solitary waves of a wanted amplitude, from full simulations: the striker speed is solved for."""

from collections.abc import Callable
from math import exp, log
from pathlib import Path

import numpy as np

from drivers import paths
from drivers.case import Case, build_case
from drivers.errors import InputError, RunError
from postproc.signals import first_peak
from validation.reference.travelling_wave import solve_travelling_wave
from validation.simulate import Simulation, case_of, exact, run_codes, run_codes_on

SCENE = "table1"
MARGIN, BEYOND = 1.3, 10  # a search sees this many times the travel time, to beads beyond the lower sensor
AFTER = 1.15  # times the arrival at the lower sensor: the run ends when the peak has passed
EXACT_SPEED = 1e-12  # relative, of the striker speed that is solved for
CODE_AMPLITUDE = 1e-7  # relative: a code's amplitude counts as the one wanted
MAX_CORRECTIONS = 8

Amplitude = Callable[[Simulation], float]


def sensor_pair(case: Case) -> tuple[int, int]:
    """The beads of the upper and the lower sensor.

    Raises:
        InputError: the scene has not two of them.
    """
    beads = [sensor.from_wall for sensor in case.layout.sensors]
    if len(beads) != 2:
        raise InputError(case.scene.file, "chain.sensors", f"{len(beads)} sensors", "two, between which a wave travels")
    return beads[0], beads[1]


def sensor_amplitude(simulation: Simulation) -> float:
    """Mean over the sensors of the peak of their averages above the static value, N: F_m of Table 1."""
    return float(np.mean([simulation.values[f"bead_{bead}_amplitude_N"] for bead in sensor_pair(simulation.case)]))


def contact_peak(simulation: Simulation) -> float:
    """Mean of the first peaks of the contact forces between the upper and the lower sensor, static part included."""
    upper, lower = sensor_pair(simulation.case)
    force, time = simulation.trace.force_N[:, lower:upper], simulation.trace.time_s
    static = force[0]
    firsts = [first_peak(time, column - column[0]) for column in force.T]
    return float(
        np.mean([start + (peak.value if peak else np.nan) for start, peak in zip(static, firsts, strict=True)])
    )


def static_force(simulation: Simulation) -> float:
    """Mean static force of the same contacts, N."""
    upper, lower = sensor_pair(simulation.case)
    return float(simulation.trace.force_N[0, lower:upper].mean())


def speed_between_sensors(simulation: Simulation) -> float:
    """Peak to peak, m/s."""
    upper, lower = sensor_pair(simulation.case)
    return simulation.values[f"speed_{upper}_to_{lower}_m_s"]


def arrival(simulation: Simulation) -> float:
    """When the peak reaches the lower sensor, s."""
    return simulation.values[f"bead_{sensor_pair(simulation.case)[1]}_arrival_s"]


def strike(speed_m_s: float, duration_s: float, *settings: str) -> Case:
    """The chain of Table 1 under a striker of some speed, for whole microseconds."""
    duration = f"run.duration={np.ceil(duration_s * 1e6):.0f} us"
    return case_of(SCENE, *settings, f"striker.speed={speed_m_s!r} m/s", duration)


def strike_for(force_N: float, amplitude: Amplitude, *settings: str) -> Simulation:
    """The exact simulation of the strike that gives a wanted amplitude, just long enough to see it pass.

    Args:
        force_N: the amplitude wanted.
        amplitude: how it is read from a simulation.
        settings: laid over the scene.

    Raises:
        RunError: no striker speed gives this amplitude.
    """
    from scipy.optimize import brentq

    speed, travel_s = _estimates(strike(1.0, 1e-6, *settings), force_N)
    start = log(speed)

    def excess(log_speed: float) -> float:
        return amplitude(exact(strike(exp(log_speed), MARGIN * travel_s, *settings))) / force_N - 1

    low, high = start - 0.5, start + 0.5
    while excess(low) > 0 and low > start - 12:  # under precompression a weak strike gives less than the static force
        low -= 1.0
    if not excess(low) < 0 < excess(high):
        raise RunError(f"{SCENE}: no striker speed gives a wave of {force_N:g} N")
    root = float(brentq(excess, low, high, xtol=EXACT_SPEED))
    passed = AFTER * arrival(exact(strike(exp(root), MARGIN * travel_s, *settings)))
    return exact(strike(exp(root), passed, *settings))


def _estimates(case: Case, force_N: float) -> tuple[float, float]:
    """Striker speed and travel time to beyond the lower sensor for a wave of some force without a static one.

    An equal striker hands on v_m = 0.682 v; under a static force the wave is faster.
    """
    wave, chain, j = solve_travelling_wave(), case.chain, case.chain.beads // 2
    stiffness, mass = float(chain.stiffness[j]), float(chain.mass_kg[j])
    speed = (force_N / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6) / 0.682
    beads = chain.beads - sensor_pair(case)[1] + BEYOND
    return speed, beads / (wave.speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * force_N ** (1 / 6))


def strikes_by_codes(
    exact_ones: list[Simulation], forces_N: list[float], amplitude: Amplitude, runs: Path = paths.RUNS
) -> dict[str, list[Simulation]]:
    """The same amplitudes solved for by each code: from the reference's speeds on, corrected by its own amplitudes.

    Raises:
        RunError: a run failed, or a code's corrections do not settle.
    """
    solved: dict[str, list[Simulation]] = {}
    found = run_codes_on([simulation.case for simulation in exact_ones], runs)
    for _ in range(MAX_CORRECTIONS):
        wanted: dict[str, list[Case]] = {}
        for code, simulations in found.items():
            solved[code] = simulations
            ratios = [amplitude(s) / force for s, force in zip(simulations, forces_N, strict=True)]
            if max(abs(ratio - 1) for ratio in ratios) > CODE_AMPLITUDE:
                wanted[code] = [_corrected(s.case, ratio) for s, ratio in zip(simulations, ratios, strict=True)]
        if not wanted:
            return solved
        found = run_codes(wanted, runs)
    raise RunError(f"{SCENE}: the striker speed of {', '.join(found)} does not settle on the amplitude wanted")


def _corrected(case: Case, ratio: float) -> Case:
    """The case with a striker speed that brings its amplitude, ``ratio`` times the one wanted, to 1: F ~ v^(6/5)."""
    assert case.scene.striker is not None
    striker = case.scene.striker.model_copy(update={"speed": case.scene.striker.speed * ratio ** (-5 / 6)})
    return build_case(case.scene.model_copy(update={"striker": striker}))
