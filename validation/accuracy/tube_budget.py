"""The error budget and the predicted error of three-dimensional runs, by the in-repo Verlet with the engine's own law.

No exact motion is known here: the true value is extrapolated (Richardson) from the in-repo scheme at the step and at
half and a quarter of it, with the order that these three show. Traces are compared only as long as rounding lets them.
"""

from dataclasses import asdict, dataclass, replace
from math import log2
from threading import Lock
from typing import Any

import numpy as np

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.integrator_arrays import tube_arrays_of
from drivers.chain.trace import Sideways, Trace, make_sideways_trace, until
from drivers.engines import load_engine
from drivers.engines._sums import towards_axis
from postproc.read.residual import residual
from validation.accuracy.error_measures import FORCE, quantities
from validation.accuracy.parts import Parts
from validation.accuracy.rounding import comparable
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.tube_chain import TubeChain, TubeMotion

MOST = 20_000_000  # bodies times steps of the finest run, some ten seconds
LEAST_ORDER, HIGHEST_ORDER = 0.5, 2.5  # that an extrapolation is made with
TURN_RAD = 1.0  # about the axis, for the run that only rounds otherwise


@dataclass(frozen=True)
class SidewaysRods:
    """What a case's runs are measured with, all of them cut where rounding alone parts two of them.

    Attributes:
        verlet: the in-repo scheme at the case's step with the engine's own law.
        half, quarter: of the step.
        order: by which the three converge.
        rounding: what rounding lets runs differ by, over the largest force.
        samples: until when they can be compared.
        shares: what rounding does to the forces at each sample of the case, likewise. Shape (samples of the case,).
    """

    verlet: Trace
    half: Trace
    quarter: Trace
    order: float
    rounding: float
    samples: int
    shares: Array

    @property
    def extrapolated_N(self) -> Array:
        """The forces at a step of zero. Shape (samples, bodies)."""
        return np.asarray(extrapolated(self.half.force_N, self.quarter.force_N, self.order))


_last: dict[str, SidewaysRods] = {}
_making = Lock()


def trace_of_tube(case: Case, motion: TubeMotion) -> Trace:
    """A three-dimensional in-repo motion as a trace."""
    place = motion.place_m[:, :, :2]
    towards = towards_axis(place, motion.bore_N[:, :, :2])
    sideways = Sideways(place, motion.velocity_m_s[:, :, :2], motion.spin_rad_s, towards)
    friction = motion.bore_N[:, :, 2].sum(axis=1) if case.chain.lateral and case.chain.lateral.bore else None
    height, velocity = motion.place_m[:, :, 2], motion.velocity_m_s[:, :, 2]
    return make_sideways_trace(case.chain, case.sample_times_s, motion.force_N, height, velocity, friction, sideways)


def tube_verlet_of(case: Case, law: str, finer: int = 1) -> Trace:
    """The case by the in-repo scheme at its step, or a fraction of it."""
    return trace_of_tube(case, _motion(case, tube_arrays_of(case.chain), law, finer))


def rounded_otherwise(case: Case, law: str) -> Trace:
    """The same motion turned about the axis and twice as high, by a scheme that rounds it differently at each step."""
    chain = tube_arrays_of(case.chain)
    lift = float(np.abs(chain.place_m[:, 2]).max())
    turn = np.array([[np.cos(TURN_RAD), np.sin(TURN_RAD), 0], [-np.sin(TURN_RAD), np.cos(TURN_RAD), 0], [0, 0, 1]])
    moved = replace(
        chain,
        place_m=chain.place_m @ turn + np.array([0, 0, lift]),
        velocity_m_s=chain.velocity_m_s @ turn,
        wall_m=chain.wall_m + lift,
    )
    motion = _motion(case, moved, law, 1)
    place = (motion.place_m - np.array([0, 0, lift])) @ turn.T
    bore, velocity, spin = (values @ turn.T for values in (motion.bore_N, motion.velocity_m_s, motion.spin_rad_s))
    return trace_of_tube(case, TubeMotion(motion.force_N, bore, place, velocity, spin, motion.extremes))


def _motion(case: Case, chain: TubeChain, law: str, finer: int) -> TubeMotion:
    scene = case.scene
    with np.errstate(all="ignore"):  # too large a step blows up
        return integrate_tube(chain, scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples, law)


def sideways_rounding(case: Case, law: str = TOTAL) -> Array:
    """What rounding does to the forces at each sample, in N. Shape (samples,)."""
    return np.asarray(np.abs(rounded_otherwise(case, law).force_N - tube_verlet_of(case, law).force_N).max(axis=1))


def why_unmeasured(case: Case) -> str:
    """Why nothing can be measured of a three-dimensional case; empty where it can."""
    lateral = case.chain.lateral
    if lateral is not None and lateral.bore is not None and lateral.bore.sides is not None:
        return "not measured: the in-repo scheme has a true cylinder, no bore of flat sides"
    if 4 * case.chain.bodies * case.scene.steps > MOST:
        return f"not measured: at a quarter of the step this is more than {MOST:g} bodies times steps"
    return ""


def sideways_rods(case: Case, law: str) -> SidewaysRods:
    """The yardsticks of a case for engines of that law; those asked for last are kept."""
    key = f"{law} {load_engine('verlet').render(case).sha256} {case.layout}"
    with _making:
        if key not in _last:
            verlet, half, quarter = (tube_verlet_of(case, law, finer) for finer in (1, 2, 4))
            shares = np.nan_to_num(residual(rounded_otherwise(case, law), verlet), nan=np.inf)
            rounding, samples = comparable(shares)
            verlet, half, quarter = (until(trace, samples) for trace in (verlet, half, quarter))
            _last.clear()
            _last[key] = SidewaysRods(verlet, half, quarter, order_of(verlet, half, quarter), rounding, samples, shares)
        return _last[key]


def order_of(coarse: Trace, half: Trace, quarter: Trace) -> float:
    """The order by which the forces of three steps converge, by their largest differences."""
    first = float(np.nan_to_num(np.abs(coarse.force_N - half.force_N).max(), nan=np.inf))
    second = float(np.nan_to_num(np.abs(half.force_N - quarter.force_N).max(), nan=np.inf))
    if not (first and second and np.isfinite(first) and np.isfinite(second)):
        return 2.0
    return min(max(log2(first / second), LEAST_ORDER), HIGHEST_ORDER)


def extrapolated(half: Any, quarter: Any, order: float) -> Any:
    """A value at a step of zero: ``Q_4 + (Q_4 - Q_2) / (2^p - 1)``."""
    return quarter + (quarter - half) / (2**order - 1)


def sideways_budget(case: Case, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], str]:
    """The parts of the error of the force and of what gauges show, and what was not measured."""
    why = why_unmeasured(case)
    if why:
        return [], why
    rods = sideways_rods(case, load_engine(engine).shear)
    stages = (until(trace, rods.samples), rods.verlet, rods.half, rods.quarter)
    true = rods.extrapolated_N
    difference = np.nan_to_num(np.abs(stages[0].force_N - true), nan=np.inf)
    sample, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    largest = float(np.abs(true).max()) or 1.0
    values = [float(stage.force_N[sample, column]) / largest for stage in stages]
    where = f"contact {column + 1} at {trace.time_s[sample] * 1e6:g} us"
    found = [_parts(FORCE, values, rods.order, 1.0, where)]
    seen = [quantities(case, stage) for stage in stages]
    for name in seen[-1]:
        if all(name in stage for stage in seen):
            exact = abs(extrapolated(seen[2][name], seen[3][name], rods.order))
            if exact:
                found.append(_parts(name, [stage[name] / exact for stage in seen], rods.order))
    return [asdict(part) for part in found], _note(case, rods)


def _note(case: Case, rods: SidewaysRods) -> str:
    notes = [
        f"truncation by extrapolation from half and a quarter of the step, which converge with order {rods.order:.2g}",
        f"rounding is part of model: alone it makes up to {rods.rounding:.1g} of the force",
        "sampling not measured",
    ]
    if rods.samples < case.scene.samples:
        end = case.sample_times_s[rods.samples - 1]
        notes.append(f"measured until t = {end:g} s, from when on rounding alone parts two runs")
    return "; ".join(notes)


def _parts(quantity: str, stages: list[float], order: float, scale: float = 1.0, where: str = "") -> Parts:
    run, verlet, half, quarter = (value / scale for value in stages)
    true = extrapolated(half, quarter, order)
    return Parts(quantity, run - true, run - verlet, 0.0, verlet - true, 0.0, where)


def model_quantity(case: Case) -> str:
    """The name of the tolerance of a case's modelling error."""
    leveled = case.chain.lateral is not None and bool(np.isinf(case.chain.radius_m[-1]))
    return "level" if leveled else FORCE


def sideways_error(case: Case, law: str) -> Array:
    """Predicted force error at each comparable sample, over the largest force. Shape (samples,)."""
    rods = sideways_rods(case, law)
    exact = replace(rods.verlet, force_N=rods.extrapolated_N)
    return np.nan_to_num(residual(rods.verlet, exact), nan=np.inf)


def sideways_warnings(case: Case, engine: str, trace: Trace) -> list[str]:
    """An error to expect by the time step, and forces that the engine's own scheme and law do not explain."""
    if why_unmeasured(case):
        return []
    adapter = load_engine(engine)
    rods, found = sideways_rods(case, adapter.shear), []
    error, limit = sideways_error(case, adapter.shear), tolerance("warning", "force").limit
    if (error > limit).any():
        since = case.sample_times_s[int(np.argmax(error > limit))]
        found.append(
            f"forces are predicted to be off by up to {error.max():.2g} of the largest, by more than {limit:g} from"
            f" t = {since:g} s on, by the time step"
        )
    allowed = max(tolerance("model", model_quantity(case)).limit, rods.rounding)
    apart = residual(until(trace, rods.samples), rods.verlet)
    if not adapter.in_repository and not (apart <= allowed).all():
        since = case.sample_times_s[int(np.argmax(~(apart <= allowed)))]
        found.append(
            f"forces differ from velocity Verlet at the same step by {apart.max():.2g} of the largest, from"
            f" t = {since:g} s on, where rounding explains {allowed:.1g}: what ran is not what the scene says"
        )
    return found
