"""Claims on the speed, width and force of single waves, from strikes on Table 1's chain."""

import numpy as np

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from postproc.paper.strikes import contact_peak, sensor_amplitude, speed_between_sensors, static_force
from validation.claims.simulated import BARE, LONG, Run, largest_N, smallest_N, struck
from validation.reference.precompressed_wave import solve_at_amplitude

WIDTH = "bead_5_width_4pct_diameters"


def exponent(run: Run) -> float:
    """Power of the force in the speed, from two strikes without gravity a factor of ten apart."""
    found = [run(case_of("table1", *BARE, f"striker.speed={speed} m/s")) for speed in (0.2, 2.0)]
    speeds, forces = [speed_between_sensors(one) for one in found], [contact_peak(one) for one in found]
    return float(np.log(speeds[1] / speeds[0]) / np.log(forces[1] / forces[0]))


def width_by_amplitude(run: Run) -> float:
    """Width at 4 % without gravity: under the strike of the table's 0.06 N over that under the strike of its 5 N."""
    low, high = (struck(run, force, *BARE, LONG).values[WIDTH] for force in (smallest_N(), largest_N()))
    return low / high


def width_by_modulus(run: Run) -> float:
    """Width at 4 % with gravity for the softest over that for the hardest modulus, at strikes of the same force."""
    soft, hard = min(quoted().ptfe.moduli_MPa), max(quoted().ptfe.moduli_MPa)
    hard_one = struck(run, largest_N())
    striker = hard_one.case.scene.striker
    assert striker is not None
    speed = striker.speed * (hard / soft) ** (1 / 3)  # F ~ k^(2/5) v^(6/5)
    settings = (f"materials.ptfe.youngs_modulus={soft} MPa", f"striker.speed={speed!r} m/s")
    return run(case_of("table1", *settings)).values[WIDTH] / hard_one.values[WIDTH]


def width_by_gravity(run: Run) -> float:
    """Width at 4 % with gravity over that without, under the strike of the table's 0.06 N."""
    heavy, bare = (struck(run, smallest_N(), LONG, *off).values[WIDTH] for off in ((), BARE))
    return heavy / bare


def _speed_by_gravity(run: Run, force_N: float) -> float:
    """Speed with gravity over that of the exponent 1/6 without it at the same peak force, less 1, per cent."""
    heavy, bare = (struck(run, force_N, LONG, *off) for off in ((), BARE))
    same_force = speed_between_sensors(bare) * (contact_peak(heavy) / contact_peak(bare)) ** (1 / 6)
    return float(100 * (speed_between_sensors(heavy) / same_force - 1))


def gravity_low(run: Run) -> float:
    """By how much gravity speeds up the wave of the table's 0.06 N, per cent."""
    return _speed_by_gravity(run, smallest_N())


def gravity_high(run: Run) -> float:
    """By how much gravity speeds up the wave of the table's 5 N, per cent."""
    return _speed_by_gravity(run, largest_N())


def theory_and_chain(run: Run) -> float:
    """Largest deviation of Eq. (4) from simulated speeds with gravity, at strikes of 0.015 to 5 m/s, per cent."""
    found = []
    for speed in (0.015, 0.1, 0.7, 5.0):
        one = run(case_of("table1", f"striker.speed={speed} m/s"))
        particles = theory.particles_of(one.case)
        long_wave = theory.precompressed_speed(particles, contact_peak(one), static_force(one.case))
        found.append(abs(long_wave / speed_between_sensors(one) - 1))
    return 100 * max(found)


def contact_force_high(run: Run) -> float:
    """Simulated peak contact force over that of Eq. (6) at the table's 5 N, beta being the solitary wave's."""
    return _contact_force(run, largest_N())


def contact_force_low(run: Run) -> float:
    """Simulated peak contact force over that of Eq. (6) at the table's 0.06 N, beta being the solitary wave's."""
    return _contact_force(run, smallest_N())


def _contact_force(run: Run, force_N: float) -> float:
    one = struck(run, force_N)
    chain, static, peak = one.case.chain, static_force(one.case), contact_peak(one)
    wave = solve_at_amplitude(float(chain.stiffness[6]), float(chain.mass_kg[0]), static, peak / static - 1)
    return peak / theory.contact_force(wave.beta, sensor_amplitude(one), static)


def slowest_speed(run: Run) -> float:
    """Simulated speed at the table's 0.06 N, m/s."""
    return speed_between_sensors(struck(run, smallest_N()))
