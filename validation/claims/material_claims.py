"""What the paper says of materials, masses and contacts, computed from its own constants."""

from math import pi, sqrt

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of

FORCE_N = 5.0


def _particles() -> theory.Particles:
    return theory.particles_of(case_of("table1"))


def _density(material: str = "ptfe") -> float:
    """The nominal one, in ``inputs/materials.toml``."""
    density = case_of("fig6b").scene.materials[material].density
    assert density is not None
    return density


def modulus(bulk_speed_m_s: float, unit_Pa: float) -> float:
    """Young's modulus behind a bulk speed at the nominal density."""
    return theory.bulk_modulus_to_youngs(bulk_speed_m_s, _particles().poisson_ratio, _density()) / unit_Pa


def modulus_ratio() -> float:
    """The ratio of the two moduli, in which the density cancels: that of the speeds squared."""
    return (quoted().ptfe.hugoniot_m_s / quoted().ptfe.ultrasound_m_s) ** 2


def peak_stress() -> float:
    """Hertz's peak pressure at 5 N, MPa."""
    return theory.hertz_contact(_particles(), FORCE_N)[1] / 1e6


def strain() -> float:
    """The peak pressure over Young's modulus."""
    p = _particles()
    return theory.hertz_contact(p, FORCE_N)[1] / p.youngs_modulus_Pa


def strain_depth() -> float:
    """Radius of the contact at 5 N, over which strains die out, micrometres."""
    return theory.hertz_contact(_particles(), FORCE_N)[0] * 1e6


def strain_rate() -> float:
    """The strain over the measured duration at 5 N, 1/s."""
    return strain() / (quoted().table1.measured_duration_us[0] * 1e-6)


def slow_wave() -> float:
    """Speed by Eq. (3) at a particle velocity of 0.2 m/s, 600 MPa and the nominal density, m/s."""
    p = theory.Particles(600e6, _particles().poisson_ratio, _density(), _particles().diameter_m)
    return theory.speed_from_velocity(p, 0.2)


def over_slowest(speed_m_s: float) -> float:
    """A speed over the slowest measured wave's."""
    return speed_m_s / min(quoted().table1.measured_speed_m_s)


def sensor_mass() -> float:
    """Mass of two caps and a gauge, g."""
    return quoted().sensor.mass_g


def ball(material: str, diameter_m: float) -> float:
    """Mass of a ball of the material's nominal density, g."""
    return 1e3 * _density(material) * pi / 6 * diameter_m**3


def nylon_amplitude() -> float:
    """1 N over 0.03 N."""
    return 1.0 / 0.03


def speed_accuracy() -> float:
    """Independent errors of 1 mm in each of two sensors over their distance of four beads, per cent."""
    return 100 * sqrt(2) * quoted().accuracy.sensor_position_m / (4 * _particles().diameter_m)


def bulk_speed() -> float:
    """C of Eq. (1) over the bulk sound speed of 1.68 km/s."""
    return _particles().speed_constant_m_s / quoted().ptfe.hugoniot_m_s


def mass_ratio(scene: str) -> float:
    """Striker over bead of a scene."""
    chain = case_of(scene).chain
    return float(chain.mass_kg[-1] / chain.mass_kg[0])


def measured_widths() -> float:
    """Largest difference between the table's measured L/2R and its duration times speed over 2R."""
    table = quoted().table1
    columns = zip(table.measured_duration_us, table.measured_speed_m_s, table.measured_width_diameters, strict=True)
    return max(abs(1e-6 * time * speed / _particles().diameter_m - width) for time, speed, width in columns)
