"""Waves that meet, that a wall turns back, that part behind a heavy striker: over the first wave that passes a contact.

A measure reads the maxima of contacts' forces, its theory the same ones of scipy's DOP853: a solver that shares nothing
with the engines nor with the integrators in this repository. In units of the first bead's mass, a stiffness and a time,
bodies from the wall upwards, velocities downwards:

    overlap_j' = v_j - v_(j-1),   m_j v_j' = F_(j+1) - F_j,   F_j = k_j max(overlap_j, 0)^(3/2)
"""

from functools import cache
from math import sqrt

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.contact_law import hertz_force
from drivers.chain.trace import Trace
from postproc.read.signals import first_peak, peaks
from validation.reference.travelling_wave import solve_travelling_wave

TOLERANCE = 1e-10  # of a step, relative: forces come out to 1e-8 of the largest
SAMPLES_PER_UNIT = 16  # a solitary wave takes four units to pass: peaks of quintics through them are good to 1e-8
REACH = 10.0  # beads from an exact wave's peak: beyond, it is less than the rounding of its largest force
COLLISION = {
    "middle_share": "largest force where the waves meet, over that of one wave",
    "outgoing_share": "peak of the wave that leaves, over that of the one that came",
    "secondary_share": "peak of the secondary wave, over that of the wave that came",
    "asymmetry": "largest difference of mirrored contacts' forces, over the wave's",
    "momentum_share": "largest momentum of the chain, over that of either half at first",
}
WALL = {
    "wall_peak_over_incident": "largest force on the wall over that of the wave that comes",
    "reflected_over_incident": "force of the wave that goes back over that of the wave that comes",
}
TRAIN = {
    f"wave_{number}_over_first": f"force of the {word} wave over the first's, 30 contacts below the striker's"
    for number, word in enumerate(("second", "third", "fourth", "fifth"), start=2)
}


def forces(mass: Array, stiffness: Array, overlap: Array, velocity_down: Array, duration: float) -> tuple[Array, Array]:
    """Times and the forces in all contacts, shape (samples, bodies), of a chain without loads.

    Raises:
        ArithmeticError: scipy gives up.
    """
    bodies = len(mass)
    above = np.zeros(bodies)
    rate = np.empty(2 * bodies)

    def force_of(overlaps: Array) -> Array:
        closed = np.maximum(overlaps, 0.0)
        return np.asarray(stiffness * closed * np.sqrt(closed))

    def rates(_: float, state: Array) -> Array:
        force, velocity = force_of(state[:bodies]), state[bodies:]
        rate[:bodies] = velocity
        rate[1:bodies] -= velocity[:-1]
        above[:-1] = force[1:]
        rate[bodies:] = (above - force) / mass
        return rate.copy()

    time = np.linspace(0.0, duration, int(SAMPLES_PER_UNIT * duration) + 2)
    start = np.concatenate([overlap, velocity_down])
    found = solve_ivp(rates, (0.0, duration), start, "DOP853", time, rtol=TOLERANCE, atol=TOLERANCE)
    if not found.success:
        raise ArithmeticError(f"scipy's DOP853: {found.message}")
    return time, force_of(found.y[:bodies].T)


def forces_of(chain: Chain, duration_s: float) -> tuple[Array, Array]:
    """The same of a chain of the project, in seconds and newtons.

    Raises:
        ArithmeticError: scipy gives up.
        ValueError: the chain has loads or damping, which this does not know.
    """
    if chain.load_N.any() or chain.damped or chain.lateral is not None:
        raise ValueError("a chain with loads, damping or sideways motion")
    mass, stiffness = float(chain.mass_kg[0]), float(chain.stiffness.max())
    speed = float(np.abs(chain.velocity_m_s).max())
    length = (mass * speed**2 / stiffness) ** 0.4  # of the unit in which all three are 1
    time, force = forces(
        chain.mass_kg / mass,
        chain.stiffness / stiffness,
        chain.overlap_m / length,
        -chain.velocity_m_s / speed,
        duration_s * speed / length,
    )
    return time * length / speed, hertz_force(force * stiffness, length)


@cache
def led_to_wall(beads: int, start: float, wall_stiffness: float, duration: float) -> tuple[Array, Array]:
    """Times and the forces in all contacts, shape (samples, beads), of an exact solitary wave that runs into a wall.

    Masses and stiffnesses are 1; in these units the wave's speed is 1 bead per unit of time.

    Args:
        beads: how many, counted from 1 at the wall; contact j lies half a bead below bead j.
        start: where the peak is at time 0, in beads.
        wall_stiffness: of contact 1, over that of the others.
        duration: in beads that the wave travels.
    """
    wave, place = solve_travelling_wave(), np.arange(1.0, beads + 1) - start

    def at(values: Array, places: Array) -> Array:
        return np.where(np.abs(places) <= REACH, CubicSpline(wave.place, values)(places), 0.0)

    stiffness = np.ones(beads)
    stiffness[0] = wall_stiffness
    overlap = np.cbrt(np.maximum(at(wave.force, place - 0.5), 0.0)) ** 2
    return forces(np.ones(beads), stiffness, overlap, at(wave.velocity, place), duration)


class Collision:
    """Two equal solitary waves that meet head on in the middle of a free chain.

    They meet at a contact where the number of beads is even, at a bead where it is odd. Each half then moves as if its
    wave ran into a wall: at a contact into one of stiffness ``2 sqrt(2) k``, since a wall sees half of the overlap; at
    a bead, which stays where it is, into one of stiffness k. What leaves are the two waves and a weak secondary one
    behind each, stronger from a contact than from a bead (Santibanez, Munoz, Caussarieu, Job and Melo, Phys. Rev. E 84,
    026604, 2011). A share of 0.0299 and one of 0.0085 of the wave are all there is: read nearer than 30 contacts from
    the middle they are still growing (0.0244 and 0.0064 after 5 contacts, 0.0267 and 0.0070 after 10, 0.0298 and 0.0084
    after 20).
    """

    DISTANCE = 40  # contacts above the middle: the secondary wave has settled to 1e-4 of itself from 30 on
    PROMINENCE = 1e-3  # of the wave: the weakest secondary wave is 8.5e-3 of it
    HALF_BEADS = 120
    START = DISTANCE + 20.5  # bead of the half chain at which the exact wave starts
    LAST = 165.0  # beads that the wave travels until the secondary one has come by
    QUANTITIES = COLLISION
    SOURCE = "the exact solitary wave, integrated by scipy's DOP853 up to the wall that stands for the other half"

    def measure(self, case: Case, trace: Trace) -> dict[str, float]:
        """Peaks in the middle and ``DISTANCE`` contacts above it, over the incoming wave's there."""
        chain, force = case.chain, trace.force_N
        middle = (chain.beads + 1) // 2  # or just above the bead there
        if middle + self.DISTANCE >= chain.beads:
            raise ValueError(f"{chain.beads} beads: none {self.DISTANCE} contacts above the middle")
        beyond = force[:, middle + self.DISTANCE]
        inner = force[:, 1:]  # contact 1 of a free chain is none
        put_in = float(chain.mass_kg @ np.abs(chain.velocity_m_s)) / 2
        return self._shares(trace.time_s, force[:, middle], beyond) | {
            "asymmetry": float(np.abs(inner - inner[:, ::-1]).max() / beyond.max()),
            "momentum_share": float(np.abs(trace.momentum_N_s).max() / put_in),
        }

    def theory(self, case: Case) -> dict[str, float]:
        """Half of the chain with the exact solitary wave in it, before the wall that stands for the other half."""
        wall_stiffness = 2 * sqrt(2) if case.chain.beads % 2 == 0 else 1.0
        time, force = led_to_wall(self.HALF_BEADS, self.START, wall_stiffness, self.LAST)
        return self._shares(time, force[:, 0], force[:, self.DISTANCE]) | {"asymmetry": 0.0, "momentum_share": 0.0}

    def _shares(self, time_s: Array, middle_N: Array, beyond_N: Array) -> dict[str, float]:
        """The middle's peak, and what leaves, over the wave that came by; all of shape (samples,)."""
        passing, together = peaks(time_s, beyond_N, prominence=self.PROMINENCE), first_peak(time_s, middle_N)
        if len(passing) < 3 or together is None:
            raise ValueError(f"{len(passing)} waves within the run, three expected: incoming, outgoing, secondary")
        incoming, outgoing, secondary = (peak.value for peak in passing[:3])
        found = (together.value / incoming, outgoing / incoming, secondary / incoming)
        return dict(zip(self.QUANTITIES, found, strict=False))


class Wall:
    """A solitary wave that meets a wall: the peak force there and that of the wave that comes back.

    Both are read where the wave keeps its shape: at the lowest sensor's contact. The theory starts from the exact
    solitary wave instead of a strike.
    """

    DISTANCE = 10  # contacts above the sensor's at which the exact wave starts, and beads above that
    PROMINENCE = 0.02  # of the range: by so much a wave stands out
    QUANTITIES = WALL
    SOURCE = "the exact solitary wave of the discrete chain, led to the wall by scipy's DOP853"

    def measure(self, case: Case, trace: Trace) -> dict[str, float]:
        """Ratios from the maxima of two contacts."""
        return self._ratios(_lowest_sensor(case), trace.time_s, trace.force_N)

    def theory(self, case: Case) -> dict[str, float]:
        """From the exact solitary wave and the wall's stiffness over that of the contacts between beads."""
        chain, place = case.chain, _lowest_sensor(case)
        if chain.load_N.any():
            raise ValueError("a chain under load, in which no wave is the exact one")
        start = place + self.DISTANCE
        # it is back at the sensor after 2 place + DISTANCE beads; those at the wall linger
        duration = 2.0 * place + self.DISTANCE + 8.0
        stiffness = float(chain.stiffness[0] / chain.stiffness[1])
        return self._ratios(place, *led_to_wall(start + self.DISTANCE, start, stiffness, duration))

    def _ratios(self, place: int, time_s: Array, force_N: Array) -> dict[str, float]:
        """Ratios to the first wave that passes contact ``place``."""
        incident, wall = first_peak(time_s, force_N[:, place - 1]), first_peak(time_s, force_N[:, 0])
        if incident is None or wall is None:
            raise ValueError("no wave at the sensor or at the wall within run.duration")
        passing = peaks(time_s, force_N[:, place - 1], self.PROMINENCE)
        back = [peak.value for peak in passing if peak.time_s > wall.time_s]
        if not back:
            raise ValueError(f"no wave comes back to contact {place} within run.duration")
        return dict(zip(self.QUANTITIES, (wall.value / incident.value, max(back) / incident.value), strict=True))


def _lowest_sensor(case: Case) -> int:
    """The bead, whose contact below is read."""
    if case.scene.wall is None or not case.scene.chain.sensors:
        raise ValueError("no wall, or no sensor to read the wave at")
    return min(sensor.from_wall for sensor in case.scene.chain.sensors)


class Train:
    """A train of solitary waves behind a heavy striker.

    It is read thirty contacts below the striker's own: that contact lies under the thirtieth bead from the top. There
    the waves of a striker of up to four bead masses have parted to 1e-3 of their ratios; of eight, the fourth still
    gains 5 %.
    """

    DISTANCE = 30  # contacts below the striker's
    PROMINENCE = 1e-3  # of the range: by so much a wave stands out
    QUANTITIES = TRAIN
    SOURCE = "the same chain by scipy's DOP853 to 1e-10 a step, which shares no line with the integrators judged"

    def measure(self, case: Case, trace: Trace) -> dict[str, float]:
        """Ratios from the contact's maxima."""
        return self._ratios(case, trace.time_s, trace.force_N)

    def theory(self, case: Case) -> dict[str, float]:
        """The same of the same chain by another integrator."""
        return self._ratios(case, *forces_of(case.chain, float(case.sample_times_s[-1])))

    def _ratios(self, case: Case, time_s: Array, force_N: Array) -> dict[str, float]:
        column = case.chain.bodies - 1 - self.DISTANCE
        if case.scene.striker is None or column < 1:
            raise ValueError(f"no contact {self.DISTANCE} below a striker's")
        found = [peak.value for peak in peaks(time_s, force_N[:, column], self.PROMINENCE)]
        if len(found) < 2:
            raise ValueError(f"{len(found)} waves at contact {column + 1} within run.duration")
        return {name: value / found[0] for name, value in zip(self.QUANTITIES, found[1:], strict=False)}
