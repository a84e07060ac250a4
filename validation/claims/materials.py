"""Claims on materials, masses, contacts and measured numbers: arithmetic of the paper's numbers."""

from math import pi, sqrt

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from postproc.paper.strikes import static_force
from validation.claims.chains import ptfe_beads

FORCE_N = 5.0


def _density(material: str = "ptfe") -> float:
    """Nominal density of a material, from ``inputs/materials.toml``."""
    density = case_of("fig6b").scene.materials[material].density
    assert density is not None
    return density


def modulus(bulk_speed_m_s: float, unit_Pa: float, mass_g: float = 0.0) -> float:
    """Young's modulus for a bulk speed at the nominal density, or at the density of a bead of some mass."""
    density = 1e-3 * mass_g / (pi / 6 * ptfe_beads().diameter_m ** 3) if mass_g else _density()
    return theory.bulk_modulus_to_youngs(bulk_speed_m_s, ptfe_beads().poisson_ratio, density) / unit_Pa


def modulus_ratio() -> float:
    """Ratio of the two moduli: the ratio of the squared speeds, as the density cancels."""
    return (quoted().ptfe_hugoniot_m_s / quoted().ptfe_ultrasound_m_s) ** 2


def peak_stress() -> float:
    """Hertz's peak pressure at 5 N, MPa."""
    return theory.hertz_contact(ptfe_beads(), FORCE_N)[1] / 1e6


def strain() -> float:
    """The peak pressure over Young's modulus."""
    p = ptfe_beads()
    return theory.hertz_contact(p, FORCE_N)[1] / p.youngs_modulus_Pa


def strain_depth() -> float:
    """Radius of the contact at 5 N, the decay length of strains, micrometres."""
    return theory.hertz_contact(ptfe_beads(), FORCE_N)[0] * 1e6


def strain_rate(times: float) -> float:
    """The strain over the measured duration at 5 N, or over a share of it, 1/s."""
    return strain() / (times * quoted().table1.measured_duration_us[0] * 1e-6)


def slow_wave() -> float:
    """Speed by Eq. (3) at a particle velocity of 0.2 m/s, 600 MPa and the nominal density, m/s."""
    p = theory.Particles(600e6, ptfe_beads().poisson_ratio, _density(), ptfe_beads().diameter_m)
    return theory.speed_from_velocity(p, 0.2)


def over_slowest(speed_m_s: float) -> float:
    """A speed over that of the slowest measured wave."""
    return speed_m_s / min(quoted().table1.measured_speed_m_s)


def sensor_mass() -> float:
    """Mass of two caps and a gauge, g."""
    return quoted().sensor_mass_g


def ball(material: str, diameter_m: float) -> float:
    """Mass of a ball of the material's nominal density, g."""
    return 1e3 * _density(material) * pi / 6 * diameter_m**3


def over_smallest(newtons: float) -> float:
    """A force over the smallest measured one, 0.03 N."""
    return newtons / quoted().smallest_force_N


def speed_accuracy(added: str) -> float:
    """Errors of 1 mm of two sensors over their distance, added in squares or linearly, per cent."""
    together = {"in squares": sqrt(2), "plainly": 2.0}[added]
    return 100 * together * quoted().accuracy_sensor_position_m / (4 * ptfe_beads().diameter_m)


def bulk_speed() -> float:
    """C of Eq. (1) over the bulk sound speed of 1.68 km/s."""
    return ptfe_beads().speed_constant_m_s / quoted().ptfe_hugoniot_m_s


def mass_ratio(scene: str) -> float:
    """Striker mass over bead mass of a scene."""
    chain = case_of(scene).chain
    return float(chain.mass_kg[-1] / chain.mass_kg[0])


def measured_widths() -> float:
    """Largest difference between the table's measured L/2R and its duration times speed over 2R."""
    table = quoted().table1
    columns = zip(table.measured_duration_us, table.measured_speed_m_s, table.measured_width_diameters, strict=True)
    return max(abs(1e-6 * time * speed / ptfe_beads().diameter_m - width) for time, speed, width in columns)


def table_speed(which: str) -> float:
    """Slowest or fastest wave of Table 1, m/s."""
    return {"slowest": min, "fastest": max}[which](quoted().table1.measured_speed_m_s)


def over_bulk(speed_m_s: float) -> float:
    """The fastest measured wave over a bulk sound speed."""
    return max(quoted().table1.measured_speed_m_s) / speed_m_s


def modulus_over(modulus_MPa: float, other_MPa: float) -> float:
    """One modulus over another."""
    return modulus_MPa / other_MPa


def nylon_modulus(ptfe_MPa: float) -> float:
    """Six times a modulus of PTFE, GPa."""
    return 6e-3 * ptfe_MPa


def plate_mass(density_kg_m3: float) -> float:
    """Mass of a sensor's plate of the quoted size, g."""
    paper = quoted()
    return 1e-6 * density_kg_m3 * paper.sensor_gauge_side_mm**2 * paper.sensor_gauge_thickness_mm


def contact_radius() -> float:
    """Hertz's contact radius of the smaller beads over that of the larger ones under the same force."""
    large, small = (theory.particles_of(case_of(scene)) for scene in ("table1", "fig6b"))
    return theory.hertz_contact(small, FORCE_N)[0] / theory.hertz_contact(large, FORCE_N)[0]


def over_static() -> float:
    """The smallest amplitude of Table 1 over the static force between the sensors."""
    return min(quoted().table1.force_N) / static_force(case_of("table1"))


def static_at_wall(scene: str) -> float:
    """Static force on the wall over the weight of a scene's beads."""
    case = case_of(scene)
    weight = float(case.chain.mass_kg[: case.chain.beads].sum()) * case.scene.gravity
    return float(case.chain.force_N[0]) / weight
