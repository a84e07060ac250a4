"""What the paper says of materials, masses and contacts, computed from its own constants."""

from math import pi, sqrt

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of

SOUND_IN_AIR_M_S = 343.0  # 20 degrees C, 1 atm
NYLON_M_S = 235.0  # ref. 14 of the paper
FORCE_N = 5.0


def _particles() -> theory.Particles:
    return theory.particles_of(case_of("table1"))


def _nominal_density() -> float:
    density = case_of("table1").scene.materials["ptfe"].density
    assert density is not None
    return density


def _modulus(bulk_speed_m_s: float) -> float:
    """Young's modulus behind a bulk speed at the nominal density, Pa."""
    return theory.bulk_modulus_to_youngs(bulk_speed_m_s, _particles().poisson_ratio, _nominal_density())


def modulus_from_hugoniot() -> float:
    """E from the bulk speed 1.68 km/s and the nominal density, GPa."""
    return _modulus(quoted().ptfe.hugoniot_m_s) / 1e9


def modulus_from_ultrasound() -> float:
    """E from the bulk speed 1.139 km/s and the nominal density, MPa."""
    return _modulus(quoted().ptfe.ultrasound_m_s) / 1e6


def modulus_ratio() -> float:
    """The ratio of the two moduli, in which the density cancels: that of the speeds squared."""
    return (quoted().ptfe.hugoniot_m_s / quoted().ptfe.ultrasound_m_s) ** 2


def peak_stress() -> float:
    """Hertz's peak pressure at 5 N, MPa."""
    return theory.hertz_contact(_particles(), FORCE_N).peak_pressure_Pa / 1e6


def strain() -> float:
    """The peak pressure over Young's modulus."""
    p = _particles()
    return theory.hertz_contact(p, FORCE_N).peak_pressure_Pa / p.youngs_modulus_Pa


def strain_depth() -> float:
    """Radius of the contact at 5 N, over which strains die out, micrometres."""
    return theory.hertz_contact(_particles(), FORCE_N).radius_m * 1e6


def strain_rate() -> float:
    """The strain over the measured duration at 5 N, 1/s."""
    return strain() / (quoted().table1.measured_duration_us[0] * 1e-6)


def slow_wave() -> float:
    """Speed by Eq. (3) at a particle velocity of 0.2 m/s, 600 MPa and the nominal density, m/s."""
    p = theory.Particles(600e6, _particles().poisson_ratio, _nominal_density(), _particles().diameter_m)
    return theory.speed_from_velocity(p, 0.2)


def air_over_slowest() -> float:
    """Speed of sound in air over the slowest measured wave's."""
    return SOUND_IN_AIR_M_S / min(quoted().table1.measured_speed_m_s)


def nylon_over_slowest() -> float:
    """The slowest wave on nylon beads over the slowest one here."""
    return NYLON_M_S / min(quoted().table1.measured_speed_m_s)


def sensor_mass() -> float:
    """Mass of two caps and a gauge, g."""
    return quoted().sensor.mass_g


def _sphere_mass(material: str, diameter_m: float) -> float:
    """Mass of a ball of the material's density in ``inputs/materials.toml``, g."""
    density = case_of("fig6b").scene.materials[material].density
    assert density is not None
    return 1e3 * density * pi / 6 * diameter_m**3


def steel_ball() -> float:
    """Mass of a 2 mm ball of stainless steel, g."""
    return _sphere_mass("stainless-steel", 2e-3)


def bead() -> float:
    """Mass of a 4.76 mm ball of the nominal density, g."""
    return _sphere_mass("ptfe", 4.76e-3)


def small_bead() -> float:
    """Mass of a 2.38 mm ball of the nominal density, g."""
    return _sphere_mass("ptfe", 2.38e-3)


def large_ball() -> float:
    """Mass of a 5 mm ball of the nominal density, g."""
    return _sphere_mass("ptfe", 5e-3)


def nylon_amplitude() -> float:
    """1 N over 0.03 N."""
    return 1.0 / 0.03


def speed_accuracy() -> float:
    """Independent errors of 1 mm in each of two sensors over their distance of four beads, per cent."""
    return 100 * sqrt(2) * quoted().accuracy.sensor_position_m / (4 * _particles().diameter_m)


def bulk_speed() -> float:
    """C of Eq. (1) over the bulk sound speed of 1.68 km/s."""
    return _particles().speed_constant_m_s / quoted().ptfe.hugoniot_m_s


def fig5_mass_ratio() -> float:
    """Striker over bead of Fig. 5."""
    return _mass_ratio("fig5")


def fig6_mass_ratio() -> float:
    """Striker over bead of Fig. 6a, b."""
    return _mass_ratio("fig6b")


def _mass_ratio(scene: str) -> float:
    chain = case_of(scene).chain
    return float(chain.mass_kg[-1] / chain.mass_kg[0])


def measured_widths() -> float:
    """Largest difference between the table's measured L/2R and its duration times speed over 2R."""
    table = quoted().table1
    columns = zip(table.measured_duration_us, table.measured_speed_m_s, table.measured_width_diameters, strict=True)
    return max(abs(1e-6 * time * speed / _particles().diameter_m - width) for time, speed, width in columns)
