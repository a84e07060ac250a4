"""Independent integrator for chains with the power law of damping, or with damping ``C d^p d'``.

It shares nothing with ``validation.reference``: scipy's DOP853 at a relative tolerance of 1e-13, restarted where a
contact closes, lets go (zero force), holds again, or where its closing speed changes sign. Between these events the
state of the contacts is fixed. Events are located on the interpolant of a step, then by integrating up to them.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq

from validation.reference.hertz_chain import HertzChain

Array = NDArray[np.float64]
RTOL = 1e-13
OPEN, HOLDS, LET_GO = 0, 1, 2
EVENT_TOLERANCE = 1e-13  # of the scale of the function that changes sign
NEWTON_STEPS = 3


class ByPower:
    """Motion of a chain, in dimensionless lengths, speeds and times."""

    def __init__(self, chain: HertzChain) -> None:
        speed = max(float(np.abs(chain.velocity_m_s).max()), 1e-3)
        length = (1.25 * chain.mass_kg.max() * speed**2 / chain.stiffness.max()) ** 0.4
        self.time = length / speed
        self.force = chain.mass_kg.max() * speed**2 / length
        self.n, self.alpha, power = chain.mass_kg.size, chain.alpha or 1.0, 0.0 if chain.alpha else chain.overlap_power
        self.power = power
        self.mass, self.load = chain.mass_kg / chain.mass_kg.max(), chain.load_N / self.force
        self.k = chain.stiffness * length**1.5 / self.force
        self.gamma = chain.damping * speed**self.alpha * length**power / self.force
        self.now = 0.0
        self.state = np.concatenate([chain.overlap_m / length, chain.velocity_m_s / speed])
        overlap, closing = self.state[: self.n], self.closing(self.state)
        touches = (overlap > 0) | (overlap == 0) & (closing >= 0)
        self.mode = np.where(touches, np.where(self.raw(self.state) >= 0, HOLDS, LET_GO), OPEN)
        self.sense = np.sign(closing)

    def closing(self, state: Array) -> Array:
        return np.concatenate([[0.0], state[self.n : -1]]) - state[self.n :]

    def raw(self, state: Array) -> Array:
        """Forces of contacts if all were closed and could pull."""
        closing, overlap = self.closing(state), np.maximum(state[: self.n], 0)
        lost = overlap**self.power * np.sign(closing) * np.abs(closing) ** self.alpha
        return np.asarray(self.k * overlap**1.5 + self.gamma * lost)

    def rate(self, _: float, state: Array) -> Array:
        force = np.where((self.mode == HOLDS) & (self.k > 0), self.raw(state), 0.0)
        net = force - np.append(force[1:], 0.0) + self.load
        return np.concatenate([self.closing(state), net / self.mass])

    def solver(self, until: float) -> DOP853:
        return DOP853(self.rate, self.now, self.state, until, rtol=RTOL, atol=1e-17)

    def watched(self, state: Array) -> Array:
        """Functions that are positive until an event of each contact, and until its turning point. Shape (2, n)."""
        first = np.select(
            [self.mode == OPEN, self.mode == HOLDS], [-state[: self.n], self.raw(state)], -self.raw(state)
        )
        first = np.where((self.mode == LET_GO) & (state[: self.n] < 0), 1.0, first)
        return np.array([np.where(self.k > 0, first, 1.0), self.closing(state) * self.sense])

    def after(self, until: float) -> Array:
        """State at a time within the next step."""
        solver = self.solver(until)
        while solver.status == "running":
            solver.step()
        return np.asarray(solver.y)

    def advance(self, until: float) -> None:
        """Integrate to a time, event by event."""
        while self.now < until:
            solver = self.solver(until)
            while solver.status == "running":
                solver.step()
                event = self.event_of(solver)
                if event is not None:
                    break
                self.now, self.state = float(solver.t), solver.y
                opened = (self.mode == LET_GO) & (self.state[: self.n] < 0)
                if opened.any():
                    self.mode[opened] = OPEN

    def event_of(self, solver: DOP853) -> tuple[int, int] | None:
        """First event of a step; the motion is advanced to it."""
        begin, end = self.watched(self.state), self.watched(solver.y)
        smooth = (self.mode != HOLDS) | (self.sense == 0)
        end[1][smooth] = 1.0
        self.sense[smooth] = np.sign(self.closing(solver.y))[smooth]
        found, between = None, solver.dense_output()
        for kind, contact in np.argwhere(end < -EVENT_TOLERANCE):

            def value(at: float, kind: int = kind, contact: int = contact) -> float:
                return float(self.watched(between(at))[kind, contact])

            if begin[kind, contact] <= 0:
                time = self.now
            else:
                time = brentq(value, self.now, float(solver.t), xtol=1e-15, rtol=1e-15)
            if found is None or time < found[0]:
                found = (time, int(kind), int(contact))
        if found is None:
            return None
        time, kind, contact = found
        for _ in range(NEWTON_STEPS):
            state = self.after(time) if time > self.now else self.state
            change = np.array([self.watched(state + h * self.rate(0, state))[kind, contact] for h in (-1e-7, 1e-7)])
            slope = (change[1] - change[0]) / 2e-7
            step = -self.watched(state)[kind, contact] / slope if slope < 0 else 0.0
            time = min(max(time + step, self.now), float(solver.t))
        if time > self.now:
            self.state, self.now = self.after(time), time
        if kind == 1:
            self.sense[contact] *= -1
        else:
            self.mode[contact] = LET_GO if self.mode[contact] == HOLDS else HOLDS
            self.sense[contact] = np.sign(self.closing(self.state)[contact])
        return kind, contact

    def forces_N(self) -> Array:
        return np.asarray(np.where(self.mode == HOLDS, np.maximum(self.raw(self.state), 0.0), 0.0) * self.force)


def forces_at(chain: HertzChain, times_s: Array) -> Array:
    """Contact forces at increasing times. Shape (times, contacts)."""
    motion, forces = ByPower(chain), []
    for time in times_s:
        motion.advance(float(time) / motion.time)
        forces.append(motion.forces_N())
    return np.array(forces)
