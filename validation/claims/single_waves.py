"""Claims on single waves: under strikes, in Fig. 4, Table 1 and Fig. 3, alone and in collisions."""

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.chain.chain import Array
from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, exact
from postproc.paper.strikes import (
    contact_peak,
    deviations,
    engines_of,
    sensor_amplitude,
    speed_between_sensors,
    static_force,
)
from postproc.read.sensors import sensor_average
from postproc.read.signals import integral, peaks
from validation.claims.chains import (
    COARSE,
    LONG_DURATION,
    MICRO,
    UNCOMPRESSED,
    Run,
    SolvedTable,
    ratio_of,
    striker_speed_for,
    struck,
    waves,
)
from validation.reference.travelling_wave import solve_at_amplitude

WIDTH = "bead_5_width_4pct_diameters"
READINGS = {"average of the sensors": sensor_amplitude, "contact force": contact_peak}  # of F_m in Table 1
ROWS = {"large": slice(0, 2), "small": slice(2, None)}  # of the table: 5 and 2 N; 0.6, 0.1 and 0.06 N


def exponent(run: Run) -> float:
    """Exponent of the force in the speed, from two strikes without gravity, a factor of ten apart."""
    strikes = [run(case_of("table1", *UNCOMPRESSED, f"striker.speed={speed} m/s")) for speed in (0.2, 2.0)]
    speeds, forces = [*map(speed_between_sensors, strikes)], [*map(contact_peak, strikes)]
    return float(np.log(speeds[1] / speeds[0]) / np.log(forces[1] / forces[0]))


def width_by_amplitude(run: Run, low_N: float, high_N: float) -> float:
    """Width at 4 % without gravity under the strike for 0.06 N divided by that for 5 N."""
    low, high = (struck(run, force, *UNCOMPRESSED, LONG_DURATION).values[WIDTH] for force in (low_N, high_N))
    return low / high


def width_by_modulus(run: Run, force_N: float) -> float:
    """Width at 4 % with gravity for the softest modulus divided by that for the hardest, at strikes of equal force."""
    soft, hard = min(quoted().ptfe_moduli_MPa), max(quoted().ptfe_moduli_MPa)
    speed = striker_speed_for(force_N) * (hard / soft) ** (1 / 3)  # F ~ k^(2/5) v^(6/5)
    settings = (f"materials.ptfe.youngs_modulus={soft} MPa", f"striker.speed={speed!r} m/s")
    return run(case_of("table1", *settings)).values[WIDTH] / struck(run, force_N).values[WIDTH]


def width_by_gravity(run: Run, force_N: float) -> float:
    """Width at 4 % with gravity divided by that without, under the strike for 0.06 N in Table 1."""
    heavy, bare = (struck(run, force_N, LONG_DURATION, *off).values[WIDTH] for off in ((), UNCOMPRESSED))
    return heavy / bare


def speed_by_gravity(run: Run, force_N: float) -> float:
    """Speed with gravity divided by that of the exponent 1/6 without it at the same peak force, less 1, per cent."""
    heavy, bare = (struck(run, force_N, LONG_DURATION, *off) for off in ((), UNCOMPRESSED))
    same_force = speed_between_sensors(bare) * (contact_peak(heavy) / contact_peak(bare)) ** (1 / 6)
    return float(100 * (speed_between_sensors(heavy) / same_force - 1))


def theory_and_chain(run: Run) -> float:
    """Largest deviation of Eq. (4) from simulated speeds with gravity, at strikes of 0.015 to 5 m/s, per cent."""
    errors = []
    for speed in (0.015, 0.1, 0.7, 5.0):
        motion = run(case_of("table1", f"striker.speed={speed} m/s"))
        particles = theory.particles_of(motion.case)
        long_wave = theory.precompressed_speed(particles, contact_peak(motion), static_force(motion.case))
        errors.append(abs(long_wave / speed_between_sensors(motion) - 1))
    return 100 * max(errors)


def contact_force(run: Run, force_N: float) -> float:
    """Simulated peak contact force divided by that of Eq. (6), beta being the solitary wave's."""
    motion = struck(run, force_N)
    chain, static, peak = motion.case.chain, static_force(motion.case), contact_peak(motion)
    wave = solve_at_amplitude(float(chain.stiffness[6]), float(chain.mass_kg[0]), static, peak / static - 1)
    return peak / theory.contact_force(wave.beta, sensor_amplitude(motion), static)


def _fig4(run: Run) -> Simulation:
    return run(case_of("fig4", UNTIL_REFLECTED))


def fig4(run: Run, observable: str, over: str = "", times: float = 1.0) -> float:
    """An observable of Fig. 4's chain, or its ratio to another, times a number."""
    return times * ratio_of(_fig4(run).values, observable, over)


def fig4_delay(run: Run) -> float:
    """Time from the peak in bead 9 to that in bead 5 of Fig. 4, microseconds."""
    values = _fig4(run).values
    return MICRO * (values["bead_5_arrival_s"] - values["bead_9_arrival_s"])


def speed_to_the_wall(run: Run) -> float:
    """Speed from bead 5 to the wall divided by that from bead 9 to bead 5 of Fig. 4, peak to peak."""
    motion = _fig4(run)
    lower = motion.case.layout.sensors[-1]
    to_wall = lower.height_m / (motion.values["wall_arrival_s"] - motion.values["bead_5_arrival_s"])
    return to_wall / speed_between_sensors(motion)


def _face(run: Run) -> tuple[Array, Array, Array]:
    """Times, F_3, and the mean of F_3 and F_4 in bead 5 while the incident wave passes; F_4 deviates as much as F_3."""
    motion, paper = _fig4(run), quoted()
    forces, time = motion.trace.force_N, motion.trace.time_s
    passing = np.abs(time - motion.values["bead_5_arrival_s"]) < 90e-6
    third, _ = theory.sensor_forces(forces[passing, 5], forces[passing, 4], paper.sensor_gauge_g / paper.sensor_mass_g)
    return time[passing], third, sensor_average(forces, 5)[passing]


def face_deviation(run: Run) -> float:
    """Largest deviation of F_3 and F_4 from their mean, where the mean exceeds 2 % of its peak, per cent."""
    _, third, mean = _face(run)
    seen = mean > 0.02 * mean.max()
    return float(100 * np.abs(third / mean - 1)[seen].max())


def face_deviation_at_peak(run: Run) -> float:
    """Deviation of F_3 and F_4 from their mean, at the peak of the mean, per cent."""
    time, third, mean = _face(run)
    return float(100 * abs(CubicSpline(time, third / mean - 1)(peaks(time, mean)[0].time_s)))


def reflection(run: Run, incident_N: float) -> float:
    """Wave that one bead of a sensor's mass reflects, five beads above it, for an incident wave of some force, N."""
    lighter = f"chain.bead=[{{ from_wall = 30, mass = '{quoted().sensor_mass_g} g' }}]"
    motion = run(
        case_of("table1", *UNCOMPRESSED, "chain.count=60", "chain.sensors=[]", "run.duration=1.6 ms", *COARSE, lighter)
    )
    incident, back = waves(motion, 35, at_least=2, prominence=1e-3)[:2]
    return incident_N * back.value / incident.value  # without gravity forces scale


def conservation_error(error: str, of: str = "") -> float:
    """An error on Fig. 4's scene, per cent."""
    values = exact(case_of("fig4")).values
    return 100 * values[error] / (values[of] if of else 1.0)


def single_wave(run: Run) -> float:
    """Second wave divided by the first, thirty beads below a striker like the beads, no gravity; 0 without one."""
    motion = run(case_of("table1", *UNCOMPRESSED, "chain.count=60", "run.duration=4 ms", *COARSE))
    train = waves(motion, 30, prominence=1e-6)
    return train[1].value / train[0].value if len(train) > 1 else 0.0


def collision(run: Run, beads: float, seen: str, away: float) -> float:
    """Secondary wave divided by the original waves that met, some contacts away, as a force or as a velocity.

    The waves meet at a contact if the number of beads is even, else at a bead.
    """
    count = round(beads)
    ends = f"chain.bead=[{{ from_wall = 1, velocity = '1 m/s' }}, {{ from_wall = {count}, velocity = '-1 m/s' }}]"
    chain = ("striker=", f"chain.count={count}", "chain.sensors=[]", ends, "run.duration=2.6 ms", *COARSE)
    motion = run(case_of("table1", *UNCOMPRESSED, *chain))
    place = (count + 1) // 2 + round(away)
    if seen == "force":
        # from above, from below, and the secondary one
        passing = waves(motion, place + 1, at_least=3, prominence=1e-3)
        return passing[2].value / passing[0].value
    velocity = motion.trace.velocity_m_s
    assert velocity is not None
    # the wave from below, and the secondary one
    upwards = peaks(motion.trace.time_s, velocity[:, place], prominence=1e-3)
    return upwards[1].value / upwards[0].value


def solved(table: SolvedTable, force_N: float, column: str, beads: float, force_is: str) -> dict[str, float]:
    """A column of Table 1 by every engine, for the strike of this amplitude."""
    rows = table(f"chain.count={beads:g}", READINGS[force_is])
    row = next(row for row in rows.to_dict("records") if row["force_N"] == force_N)
    return {engine: row[f"{engine}_{column}"] for engine in engines_of(rows)}


def misfit(modulus_MPa: float, forces: str, force_is: str) -> float:
    """Deviation of measured from simulated speeds at equal amplitudes, root mean square over some forces, per cent."""
    return float(100 * np.sqrt((deviations(modulus_MPa, READINGS[force_is])[ROWS[forces]] ** 2).mean()))


def misfit_ratio(modulus_MPa: float, other_MPa: float, forces: str, force_is: str = "average of the sensors") -> float:
    """Deviation of measured from simulated speeds for one modulus divided by that for another, over some forces."""
    return misfit(modulus_MPa, forces, force_is) / misfit(other_MPa, forces, force_is)


def nearest(forces: str, force_is: str) -> float:
    """Modulus for which simulated speeds agree best with the measured ones, MPa."""
    return min(quoted().ptfe_moduli_MPa, key=lambda modulus: misfit(modulus, forces, force_is))


def width_by_diameter(run: Run) -> float:
    """Width in diameters at 4 % on the smaller beads divided by that on the larger ones, without gravity."""
    small = ("diameter=2.38 mm", "mass=0.0157 g")
    settings = [f"{body}.{size}" for body in ("chain", "striker") for size in small]
    return (
        run(case_of("table1", *UNCOMPRESSED, *settings)).values[WIDTH]
        / run(case_of("table1", *UNCOMPRESSED)).values[WIDTH]
    )


def impulse_to_peak(run: Run) -> float:
    """Impulse on the wall up to the largest force, divided by the momentum of the steel ball that strikes it."""
    speed = 0.5
    ball = ("chain.count=1", "chain.material=stainless-steel", "chain.sensors=[]", "chain.mass=0.5 g", "striker=")
    moving = f"chain.bead=[{{ from_wall = 1, velocity = '-{speed} m/s' }}]"
    times = ("run.duration=60 us", "run.sample_interval=0.1 us", "run.time_step=0.01 us")
    motion = run(case_of("table1", "gravity=", *ball, moving, *times))
    time, force = motion.trace.time_s, motion.trace.force_N[:, 0]
    until_peak = CubicSpline(time, integral(time, force))(peaks(time, force)[0].time_s)
    return float(until_peak / (motion.case.chain.mass_kg[0] * speed))


def long_loading(run: Run) -> float:
    """Reading of a sensor bead between wall and a piston of 1 kg, divided by the force on the wall, peak by peak."""
    bead = ("chain.count=1", "chain.sensors=[{ from_wall = 1, mass = '0.116 g' }]")
    piston = ("striker.shape=flat", "striker.material=alumina", "striker.diameter=", "striker.mass=1 kg")
    slow = ("striker.speed=5 mm/s", "run.duration=20 ms", "run.sample_interval=5 us", "run.time_step=1 us")
    motion = run(case_of("table1", *bead, *piston, *slow))
    reading, wall = sensor_average(motion.trace.force_N, 1), motion.trace.force_N[:, 0]
    return peaks(motion.trace.time_s, reading)[0].value / peaks(motion.trace.time_s, wall)[0].value
