"""Independent integrator in 40 digits, to measure the error of the reference.

It shares nothing with ``validation.reference``: Taylor series of order 30 in multiple-precision numbers (gmpy2), with
its own step control and its own treatment of contacts.
"""

from collections.abc import Callable, Iterator
from functools import partial

import gmpy2
import numpy as np
from gmpy2 import mpfr

from drivers.chain.chain import Chain
from validation.reference.hertz_chain import HertzChain

DIGITS, ORDER = 40, 30
TRUNCATION = 1e-22  # local, of the scales of overlap and velocity
HOP_S = 1e-14  # within this time of an opening or closing a contact counts as open: its impulse is below 1e-20
HOP_DAMPED_S = 1e-20  # the same with damping, where forces begin with the fourth root of time
HALVINGS = 120
SAMPLES = 40


def random_chain(
    kind: str, seed: int, bodies: int = 6
) -> tuple[HertzChain, "np.ndarray[tuple[int], np.dtype[np.float64]]"]:
    """Random struck chain and its sample times: with ``light`` beads, a ``flat`` striker, or ``gaps`` and damping."""
    random = np.random.default_rng([seed, len(kind)])
    mass = 1e-4 * (1 + 0.05 * random.standard_normal(bodies))
    stiffness = 1e9 * random.uniform(0.5, 2.0, bodies)
    overlap, velocity, load = np.zeros(bodies), np.zeros(bodies), np.zeros(bodies)
    velocity[-1] = -random.uniform(0.1, 1.0)
    if kind == "flat":
        mass[-1], stiffness[-1] = 1e-4 * random.uniform(0.3, 20), 1e9 * random.uniform(0.03, 3)
    if kind != "gaps":
        light = random.choice(bodies - 1, 2, replace=False)
        mass[light] *= 10 ** random.uniform(-2.5 if kind == "light" else -1.3, -0.5, 2)
        return HertzChain(mass, stiffness, overlap, velocity, load), np.linspace(0, 1e-4, SAMPLES + 1)
    overlap[:-1] -= 10 ** random.uniform(-8, -6, bodies - 1)
    damping = random.uniform(0.01, 0.3) * np.sqrt(1.25 * mass * stiffness)
    return HertzChain(mass, stiffness, overlap, velocity, load - 1e-3, damping), np.linspace(0, 5e-5, SAMPLES + 1)


class Taylor:
    """Motion of a chain, step by step."""

    def __init__(self, chain: Chain | HertzChain) -> None:
        self.mass = [mpfr(float(x)) for x in chain.mass_kg]
        self.stiffness = [mpfr(float(x)) for x in chain.stiffness]
        self.load = [mpfr(float(x)) for x in chain.load_N]
        self.damping = [mpfr(float(x)) for x in getattr(chain, "damping", np.zeros(len(self.mass)))]
        self.overlap = [mpfr(float(x)) for x in chain.overlap_m]
        self.velocity = [mpfr(float(x)) for x in chain.velocity_m_s]
        self.closed = [x > 0 for x in self.overlap]
        self.n = len(self.mass)
        self.time = mpfr(0)
        fastest = max(abs(float(x)) for x in self.velocity)
        stiffest = max(float(x) for x in self.stiffness)
        heaviest = max(float(x) for x in self.mass)
        self.scales = ((1.25 * heaviest * fastest**2 / stiffest) ** 0.4, fastest)

    def series(self) -> tuple[list[list[mpfr]], list[list[mpfr]]]:
        """Taylor coefficients of overlaps and velocities at the present time."""
        n = self.n
        overlap = [[x] for x in self.overlap]
        velocity = [[x] for x in self.velocity]
        power: list[list[mpfr]] = [[] for _ in range(n)]  # of overlap^(3/2)
        quarter: list[list[mpfr]] = [[] for _ in range(n)]  # of overlap^(1/4)
        zero = mpfr(0)
        half = [mpfr(i) / 2 for i in range(5 * ORDER)]
        for order in range(ORDER):
            force = []
            for j in range(n):
                if not self.closed[j]:
                    force.append(zero)
                    continue
                d, q = overlap[j], power[j]
                if order == 0:
                    q.append(d[0] * gmpy2.sqrt(d[0]))
                else:  # q' d = (3/2) q d'
                    total = sum((half[5 * i - 2 * order] if 5 * i >= 2 * order else -half[2 * order - 5 * i])
                                * d[i] * q[order - i] for i in range(1, order + 1))  # fmt: skip
                    q.append(total / (order * d[0]))
                force.append(self.stiffness[j] * q[order])
                if self.damping[j]:  # 4 q' d = q d'
                    root = quarter[j]
                    if order == 0:
                        root.append(gmpy2.sqrt(gmpy2.sqrt(d[0])))
                    else:
                        total = sum((5 * i - 4 * order) * d[i] * root[order - i] for i in range(1, order + 1))
                        root.append(total / (4 * order * d[0]))
                    rates = [(velocity[j - 1][i] if j else zero) - velocity[j][i] for i in range(order + 1)]
                    force[-1] += self.damping[j] * sum(root[i] * rates[order - i] for i in range(order + 1))
            for j in range(n):
                net = force[j] - (force[j + 1] if j + 1 < n else zero) + (self.load[j] if order == 0 else zero)
                velocity[j].append(net / self.mass[j] / (order + 1))
                below = velocity[j - 1][order] if j else zero
                overlap[j].append((below - velocity[j][order]) / (order + 1))
        return overlap, velocity

    def longest_step(self, overlap: list[list[mpfr]], velocity: list[list[mpfr]]) -> float:
        """Longest step at which the last two terms are below the allowed truncation."""
        longest = 1.0
        for rows, scale in ((overlap, self.scales[0]), (velocity, self.scales[1])):
            for row in rows:
                for order in (ORDER - 1, ORDER):
                    size = abs(row[order]) / scale
                    if size > 0:
                        longest = min(longest, float(gmpy2.exp(gmpy2.log(mpfr(TRUNCATION) / size) / order)))
        return longest

    def advance(self, until: mpfr) -> None:
        """Take one step, at most to ``until``; it ends where an open contact closes."""
        overlap, velocity = self.series()
        h = min(mpfr(self.longest_step(overlap, velocity)), until - self.time)
        closing = -1
        for j in range(self.n):
            if not self.closed[j] and self.stiffness[j] > 0 and self.overlap[j] < 0 and value(overlap[j], h) > 0:
                h, closing = switch(partial(value, overlap[j]), h, False), j
        if closing >= 0:
            h += min(mpfr(HOP_DAMPED_S if self.damping[closing] else HOP_S), until - self.time - h)
        switching = -1
        for j in range(self.n):  # damped contacts that lose or regain their force
            if self.damping[j] and self.overlap[j] > 0:

                def grip(at: mpfr, j: int = j) -> mpfr:
                    gap, rate = value(overlap[j], at), (value(velocity[j - 1], at) if j else 0) - value(velocity[j], at)
                    spring = self.stiffness[j] * gap * gmpy2.sqrt(gmpy2.sqrt(gap)) if gap > 0 else 0
                    return spring + self.damping[j] * rate

                if self.closed[j] != (grip(h) > 0) and (self.closed[j] or value(overlap[j], h) > 0):
                    h, switching = switch(grip, h, self.closed[j]), j
        self.overlap = [value(row, h) for row in overlap]
        self.velocity = [value(row, h) for row in velocity]
        self.time = until if until - self.time == h else self.time + h
        for j in range(self.n):
            rate = (self.velocity[j - 1] if j else 0) - self.velocity[j]
            if self.damping[j] and self.overlap[j] > 0 and (self.closed[j] or j == switching):
                self.closed[j] ^= j == switching
                continue
            near = abs(self.overlap[j]) < HOP_S * abs(rate)
            if self.closed[j] and (self.overlap[j] <= 0 or (near and rate < 0)):
                self.closed[j] = False
            elif not self.closed[j] and self.overlap[j] > 0 and rate > 0:
                self.closed[j] = True

    def forces(self) -> list[mpfr]:
        """Contact forces at the present time."""
        found = []
        for j, d in enumerate(self.overlap):
            root = gmpy2.sqrt(d) if d > 0 else mpfr(0)
            rate = (self.velocity[j - 1] if j else 0) - self.velocity[j]
            found.append(max(self.stiffness[j] * d * root + self.damping[j] * gmpy2.sqrt(root) * rate, mpfr(0)))
        return found


def value(row: list[mpfr], h: mpfr) -> mpfr:
    """Value of a series at h."""
    total = mpfr(0)
    for coefficient in reversed(row):
        total = total * h + coefficient
    return total


def switch(function: Callable[[mpfr], mpfr], high: mpfr, falling: bool) -> mpfr:
    """Argument at which a function changes sign, by bisection."""
    low = mpfr(0)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if (function(middle) > 0) != falling else (middle, high)
    return high


def forces_at(
    chain: Chain | HertzChain, times: "np.ndarray[tuple[int], np.dtype[np.float64]]"
) -> Iterator[list[float]]:
    """Contact forces at increasing times."""
    with gmpy2.context(gmpy2.get_context(), precision=int(DIGITS * 3.33)):
        motion = Taylor(chain)
        # a striker that just touches: step over the singular start
        hopping = [j for j in range(motion.n) if motion.overlap[j] == 0 and chain.velocity_m_s[j] < 0]
        for until in times:
            if until and hopping:
                motion.advance(mpfr(HOP_DAMPED_S if any(motion.damping) else HOP_S))
                hopping = []
            while motion.time < until:
                motion.advance(mpfr(float(until)))
            yield [float(force) for force in motion.forces()]
