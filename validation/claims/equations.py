"""Statements on the paper's equations and numbers, and on exact solitary waves; no chain is simulated.

``paper_numbers`` has a value for each arithmetic statement of ``inputs/paper/claims.toml``, by its id: both sides of
such a statement follow from the paper's equations and numbers.
"""

from functools import cache
from math import nan, pi, sqrt

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.chain.chain import Array, hertz_force
from postproc.paper import quoted, strikes
from postproc.read.motion import case_of
from validation.reference import travelling_wave
from validation.reference.travelling_wave import fixed_point, solve_at_amplitude, solve_travelling_wave

AMPLITUDES = (1.0, 10.0, 100.0)  # dynamic force divided by the static force
SWEPT_AMPLITUDES = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4)
SPEED_M_S, STRAIN, STATIC_N = 150.0, 0.01, 0.02  # of a wave and of a chain; statements do not depend on them
CONTACT_N = 5.0  # of section IV's contact stress, strain and depth
AIR_M_S, NYLON_M_S, NYLON_N = 343.0, 235.0, 1.0  # sound at 20 °C; slowest and smallest wave on Nylon, ref. 14
HEAVY_GAS_M_S = 134.0  # sound in sulphur hexafluoride at 20 °C
PZT_KG_M3 = 7800.0  # usual density of lead zirconate titanate
NORMAL_MODULUS_MPA = 750.0  # largest modulus of PTFE at normal conditions in section IV
MICRO = 1e6
HUMP_WAVE_NUMBER = sqrt(10) / 5  # times 1/a, of Eq. (2)
HUMP_LENGTH = pi / HUMP_WAVE_NUMBER  # from zero to zero, in diameters: 4.967, "five" in the paper
GRID = 64  # points of the Fourier grid over one period


def long_wave_acceleration(particles: strikes.Particles, strain: Array, length_m: float) -> Array:
    """u_tt by Eq. (1) for a strain that is periodic over ``length_m``, differentiated on its Fourier grid.

    ``u_tt = -c^2 { xi^(3/2) + (a^2/10) xi^(1/4) (xi^(5/4))_xx }_x``, for xi > 0 at equally spaced positions.
    """
    a, c = particles.diameter_m, particles.speed_constant_m_s
    dispersive = strain**0.25 * _derivative(strain**1.25, length_m, 2)
    return -(c**2) * _derivative(strain**1.5 + a**2 / 10 * dispersive, length_m, 1)


def _derivative(values: Array, length_m: float, order: int) -> Array:
    wave_number = 2j * pi * np.fft.rfftfreq(len(values), length_m / len(values))
    return np.asarray(np.fft.irfft(np.fft.rfft(values) * wave_number**order, len(values)))


def peak_strain(particles: strikes.Particles, speed_m_s: float) -> float:
    """Strain of Eq. (2) at x = 0, one hump of which is ``xi = (5 V^2 / 4 c^2)^2 cos^4(sqrt(10) x / 5a)``."""
    return float((5 * speed_m_s**2 / (4 * particles.speed_constant_m_s**2)) ** 2)


def stationary_residual(power: float) -> float:
    """Largest violation of the long-wave equation by its periodic solution, divided by the largest of its terms.

    For ``F ~ overlap^n`` (n = 3/2: Eq. (1)) a wave of speed V satisfies the once integrated equation
    ``V^2 xi = c_n^2 { xi^n + n a^2 / (6 (n+1)) xi^((n-1)/2) (xi^((n+1)/2))_xx }``, solved by
    ``xi^((n-1)/2) = cos(k x)`` with ``k a = (n-1) (6 / (n (n+1)))^(1/2)`` and ``V^2 = 2 c_n^2 / (n+1)``: Eq. (2) for
    n = 3/2, a harmonic wave for n = 3. If (n+1)/(n-1) is whole, all terms are band-limited and derivatives are exact.
    """
    n = power
    period = 2 * pi / ((n - 1) * sqrt(6 / (n * (n + 1))))
    root = np.cos(2 * pi * np.arange(GRID) / GRID)  # xi^((n-1)/2), with its sign
    curvature = _derivative(root ** ((n + 1) / (n - 1)), period, 2)
    right = root ** (2 * n / (n - 1)) + n / (6 * (n + 1)) * root * curvature
    left = 2 / (n + 1) * root ** (2 / (n - 1))
    return float(np.abs(left - right).max() / np.abs(left).max())


def speed_from_strain(particles: strikes.Particles, strain: float) -> float:
    """Eq. (3), first form: ``V_s = (2/sqrt 5) c xi_m^(1/4)``."""
    return float(2 / sqrt(5) * particles.speed_constant_m_s * strain**0.25)


def speed_from_velocity(particles: strikes.Particles, velocity_m_s: float) -> float:
    """Eq. (3), second form: ``V_s = (16/25)^(1/5) c^(4/5) v_m^(1/5)``."""
    return float((16 / 25) ** 0.2 * particles.speed_constant_m_s**0.8 * velocity_m_s**0.2)


def force_coefficient(particles: strikes.Particles, speed_m_s: float, force_N: float) -> float:
    """Coefficient of Eq. (3), printed as 0.68, for a wave of this speed and peak force; for sound that of Eq. (4)."""
    return float(speed_m_s / (strikes.force_scale(particles) * force_N ** (1 / 6)))


def sound_speed(particles: strikes.Particles, force_N: float) -> float:
    """c_0 of Eq. (1): ``c_0 = (3/2)^(1/2) c xi_0^(1/4)`` with the strain under a static force."""
    return float(sqrt(1.5) * particles.speed_constant_m_s * particles.strain(force_N) ** 0.25)


def hertz_contact(particles: strikes.Particles, force_N: float) -> tuple[float, float]:
    """Radius ``(overlap R*)^(1/2)`` in m, peak pressure ``3 F / (2 pi radius^2)`` in Pa (Hertz 1882)."""
    radius_m = sqrt(particles.strain(force_N)) * particles.diameter_m / 2  # R* is a quarter of the diameter
    return radius_m, 3 * force_N / (2 * pi * radius_m**2)


def convergence_order() -> float:
    """Order in a/L with which accelerations of the lattice converge to those of Eq. (1), for three wave lengths."""
    coarse, fine = map(_long_wave_error, (64, 256))
    return float(np.log(coarse / fine) / np.log(4))


def _long_wave_error(beads: int) -> float:
    """Largest difference of accelerations divided by the largest one, for one period of a strongly modulated strain.

    In the closed chain ``m u_tt = F_j - F_{j+1}``; ``u_0 - u_1`` is the overlap of beads 0 and 1. The last of beads + 1
    displacements is that of bead 0, one period further.
    """
    p, mean, swing = ptfe_beads(), 0.01, 0.006
    place, length = np.arange(beads + 1) * p.diameter_m, beads * p.diameter_m
    wave_number = 2 * np.pi / length
    displacement = -mean * place - swing / wave_number * np.sin(wave_number * place)
    strain = mean + swing * np.cos(wave_number * place[:-1])
    force = hertz_force(p.stiffness, -np.diff(displacement))
    lattice = (np.roll(force, 1) - force) / p.mass_kg
    return float(np.abs(lattice - long_wave_acceleration(p, strain, length)).max() / np.abs(lattice).max())


def precompressed_discrete() -> float:
    """Largest deviation of Eq. (4) from the exact wave of the discrete chain, for 0.1 to 1e4 static forces."""
    by_wave = ((speed_by_eq4(1 + size), _wave(size).speed * ptfe_beads().diameter_m) for size in SWEPT_AMPLITUDES)
    return max(abs(theirs / exact - 1) for theirs, exact in by_wave)


@cache
def _wave(amplitude: float, modulus_MPa: float = 1460) -> travelling_wave.PrecompressedWave:
    """Exact wave of a given dynamic force, divided by the static force."""
    chain = case_of("table1", f"materials.ptfe.youngs_modulus={modulus_MPa} MPa").chain
    return solve_at_amplitude(float(chain.stiffness[1]), float(chain.mass_kg[0]), STATIC_N, amplitude)


def beta(amplitude: float) -> float:
    """Beta of a wave of a given dynamic force, divided by the static force."""
    return _wave(amplitude).beta


def beta_spread() -> float:
    """Largest relative difference of beta between 600, 1000 and 1460 MPa, per cent."""
    betas = np.array([[_wave(each, modulus).beta for modulus in quoted().ptfe_moduli_MPa] for each in AMPLITUDES])
    return float(100 * (np.ptp(betas, axis=1) / betas.mean(axis=1)).max())


def width_at_half(amplitude: float) -> float:
    """Width at half the peak of a wave of a given dynamic force divided by the static force, in diameters."""
    wave = _wave(amplitude)
    return float(np.ptp(wave.place[wave.force_N > wave.force_N.max() / 2]))


def wave_width(of: str, share: float) -> float:
    """Width of the exact wave at a share of its peak, of the averaged or of the contact force, in diameters."""
    return solve_travelling_wave().width(share, averaged=of == "average")


def averaging_lowers() -> float:
    """Peak of the averaged force divided by that of the contact force."""
    return 1 / solve_travelling_wave().contact_over_average


def averaging_widens(share: float) -> float:
    """Width of the averaged force at a share of its peak divided by that of the contact force."""
    return wave_width("average", share) / wave_width("contact", share)


def energy_in_five(outer_share: float) -> float:
    """Largest share of the energy in five neighbouring beads, per cent.

    Kinetic energy of the five, energy of the four contacts between them, and a share of that of the two outer contacts.
    """
    wave = solve_travelling_wave()
    velocity = CubicSpline(wave.place, wave.velocity)

    def energy(centre: float, beads: int) -> float:
        # bead j at place j, contacts half a bead to either side
        place = np.arange(beads) - (beads - 1) / 2 + centre
        contact = np.arange(beads + 1) - beads / 2 + centre
        weight = np.ones(beads + 1)
        weight[[0, -1]] = outer_share
        kinetic = 0.5 * (velocity(place) ** 2).sum()
        return float(kinetic + 0.4 * (weight * np.maximum(wave.curve(contact), 0.0) ** (5 / 3)).sum())

    centres = np.linspace(-0.5, 0.5, 101)
    return 100 * max(energy(centre, 5) / energy(centre, 15) for centre in centres)


def strain_power(power: float) -> float:
    """Power of the speed in the peak overlap of exact waves of a chain with ``F ~ overlap^power``, at two speeds."""
    slow, fast = (float(fixed_point(power, speed)[1].max()) for speed in (1.0, 2.0))
    return float(np.log2(fast / slow))


def _sound() -> float:
    """Speed of sound of the discrete chain under the static force, beads per second."""
    p = ptfe_beads()
    return travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N)


def least_mach() -> float:
    """Smallest speed of exact waves divided by the speed of sound, for 0.1 to 1e4 static forces."""
    return min(_wave(amplitude).speed for amplitude in SWEPT_AMPLITUDES) / _sound()


def weakly_nonlinear() -> float:
    """Speed above that of sound of an exact wave of a tenth of the static force, divided by that of the KdV soliton.

    The soliton of this chain's KdV equation has ``V = c_0 [1 + (xi_m - xi_0) / (12 xi_0)]``, as Eq. (4) to first order.
    """
    amplitude = 0.1
    strain_above = (1 + amplitude) ** (2 / 3) - 1  # divided by the static one
    return float((_wave(amplitude).speed / _sound() - 1) / (strain_above / 12))


@cache
def paper_numbers() -> dict[str, float]:
    """Values by the id of the statement, each in the unit of the statement."""
    return _of_equations() | _of_materials() | _of_measurements()


def ptfe_beads() -> strikes.Particles:
    """The paper's beads of 4.76 mm, E = 1.46 GPa."""
    return strikes.particles_of(case_of("table1"))


def _of_equations() -> dict[str, float]:
    """Statements on Eqs. (1) to (5) and (7)."""
    p, y = ptfe_beads(), np.linspace(-np.pi, np.pi, 1001)
    lattice_sound = travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N) * p.diameter_m
    speeds = [speed_from_strain(p, strain) for strain in (STRAIN, 2 * STRAIN)]
    peak = peak_strain(p, SPEED_M_S)
    caps, gauge = quoted().sensor_caps_g, quoted().sensor_gauge_g
    # momentum of cap, gauge and cap under F_1 = 3 and F_2 = 1: unknown are F_3, F_4 and the acceleration
    parts = np.array([[1.0, 0.0, caps / 2], [1.0, -1.0, -gauge], [0.0, 1.0, -caps / 2]])
    third, fourth, _ = np.linalg.solve(parts, [3.0, 0.0, 1.0])
    return {
        "eq1-c": sqrt(p.stiffness * p.diameter_m**2.5 / p.mass_kg) / p.speed_constant_m_s,
        "eq1-c0": lattice_sound / (p.speed_constant_m_s * p.strain(STATIC_N) ** 0.25),
        "c-not-of-lattice": lattice_sound / p.speed_constant_m_s,
        "eq2-solves-eq1": stationary_residual(1.5),
        "cubic-harmonic": stationary_residual(3),
        "eq2-length": HUMP_LENGTH,
        "eq2-first-form": float(np.log(2) / np.log(speeds[1] ** 2 / speeds[0] ** 2)),
        "eq2-harmonics": float(np.abs(np.cos(y) ** 4 - (3 + np.cos(4 * y) + 4 * np.cos(2 * y)) / 8).max()),
        "eq2-wavelength-short": 2 * pi / (4 * HUMP_WAVE_NUMBER),
        "eq2-wavelength-long": 2 * pi / (2 * HUMP_WAVE_NUMBER),
        "eq3-strain": SPEED_M_S / (p.speed_constant_m_s * peak**0.25),
        "eq3-velocity": SPEED_M_S / (p.speed_constant_m_s**0.8 * (SPEED_M_S * peak) ** 0.2),
        "eq3-force": force_coefficient(p, speeds[0], p.force_N(STRAIN)),
        "eq4-coefficient": force_coefficient(p, sound_speed(p, STATIC_N), STATIC_N),
        "eq4-weak": speed_by_eq4(1 + 1e-4) / sound_speed(p, STATIC_N),
        "eq4-strong": speed_by_eq4(1e12) / strikes.speed_from_force(p, 1e12 * STATIC_N),
        "narrow-interval": max(100 * (speed_by_eq4(1.1 * f) / speed_by_eq4(f) - 1) for f in (2.0, 10.0, 100.0, 1000.0)),
        "eq5-share": (third - fourth) / 2.0,
        "eq5-average": (third + fourth) / 4.0,
        "eq7-law": float(case_of("table1").chain.stiffness[1]) / p.stiffness,
    }


def speed_by_eq4(force_over_static: float) -> float:
    """Speed of Eq. (4) in m/s for a peak force, static part included, divided by the static force."""
    return strikes.precompressed_speed(ptfe_beads(), force_over_static * STATIC_N, STATIC_N)


def _of_materials() -> dict[str, float]:
    """Statements on moduli, masses, and the contact at 5 N."""
    p, paper, density = ptfe_beads(), quoted(), _density("ptfe")
    small = strikes.particles_of(case_of("fig6b"))
    (radius_m, peak_Pa), (small_radius_m, small_peak_Pa) = (hertz_contact(each, CONTACT_N) for each in (p, small))
    # E = 3 rho c_b^2 (1 - 2 nu) with a bulk sound speed c_b
    bulk_speeds = np.array([paper.ptfe_hugoniot_m_s, paper.ptfe_ultrasound_m_s])
    stiff, soft = (3 * density * bulk_speeds**2 * (1 - 2 * p.poisson_ratio)).tolist()
    strain = peak_Pa / p.youngs_modulus_Pa
    return {
        "modulus-hugoniot": stiff / 1e9,
        "modulus-ultrasound": soft / MICRO,
        "modulus-ratio": stiff / soft,
        "modulus-above-normal": sorted(paper.ptfe_moduli_MPa)[1] / NORMAL_MODULUS_MPA,
        "nylon-modulus": 6e-3 * min(paper.ptfe_moduli_MPa),
        "bulk-speed": p.speed_constant_m_s / paper.ptfe_hugoniot_m_s,
        "bead-mass": _ball_g("ptfe", 4.76e-3),
        "small-bead-mass": _ball_g("ptfe", 2.38e-3),
        "fig6-ball": _ball_g("ptfe", 5e-3),
        "steel-ball": _ball_g("stainless-steel", 2e-3),
        "sensor-mass": paper.sensor_mass_g,
        "sensor-mass-close": 1e-3 * paper.sensor_mass_g / p.mass_kg,
        "plate-mass": 1e-6 * PZT_KG_M3 * paper.sensor_gauge_side_mm**2 * paper.sensor_gauge_thickness_mm,
        "fig5-mass-ratio": _striker_over_bead("fig5"),
        "fig6-mass-ratio": _striker_over_bead("fig6b"),
        "contact-stress": peak_Pa / MICRO,
        "contact-strain": strain,
        "contact-depth": radius_m * MICRO,
        "contact-strain-rate": strain / (paper.table1["measured_duration_us"][0] / MICRO),
        "contact-radius": small_radius_m / radius_m,
        "contact-by-size": small_peak_Pa / peak_Pa,
    }


def _of_measurements() -> dict[str, float]:
    """Statements on measured speeds, widths and amplitudes."""
    p, paper, table = ptfe_beads(), quoted(), quoted().table1
    by_theory = strikes.Particles(600e6, p.poisson_ratio, _density("ptfe"), p.diameter_m)
    slow_m_s = speed_from_velocity(by_theory, 0.2)
    force_N, measured_us, speed_m_s, width, *_ = map(np.array, table.values())
    slowest, fastest = float(speed_m_s.min()), float(speed_m_s.max())
    by_time = measured_us / MICRO * speed_m_s / p.diameter_m
    large = width[force_N >= 0.6]
    return {
        "slow-wave": slow_m_s,
        "slower-than-gases": slow_m_s / HEAVY_GAS_M_S,
        "measured-speeds-from": slowest,
        "measured-speeds-to": fastest,
        "slower-than-bulk": fastest / paper.ptfe_ultrasound_m_s,
        "slower-than-sound-in-air": AIR_M_S / slowest,
        "slower-than-on-nylon": NYLON_M_S / slowest,
        "nylon-amplitude": NYLON_N / paper.smallest_force_N,
        "far-smaller": NYLON_N / paper.smallest_force_N,
        "strongly-nonlinear": min(table["force_N"]) / strikes.static_force(case_of("table1")),
        "speed-accuracy": 100 * 2 * paper.accuracy_sensor_position_m / (4 * p.diameter_m),
        "table1-measured-widths": float(np.abs(by_time - width).max()),
        "very-close-to-five": float(by_time[1]),
        "widths-close-to-five": float(large[np.abs(large - 5).argmax()]),
    }


def _density(material: str) -> float:
    """Nominal density of a material, from ``inputs/materials.toml``."""
    return case_of("fig6b").scene.materials[material].density or nan


def _ball_g(material: str, diameter_m: float) -> float:
    """Mass of a ball of the material's nominal density, g."""
    return 1e3 * _density(material) * pi / 6 * diameter_m**3


def _striker_over_bead(scene: str) -> float:
    chain = case_of(scene).chain
    return float(chain.mass_kg[-1] / chain.mass_kg[0])
