"""What is expected of a run: the exact motion, what its own scheme makes of it, and what rounding may add."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, IN_HEIGHTS, IN_OVERLAPS, Engine, load_engine
from postproc.read.residual import residual
from validation.accuracy.budget import LARGEST, TOO_LARGE, yardsticks
from validation.accuracy.error_measures import verlet_of
from validation.accuracy.rounding import ROUNDING_MARGIN, comparable, verlet_in_heights
from validation.accuracy.tube_budget import model_quantity, sideways_rods, tube_verlet_of, why_unmeasured
from validation.compare.comparison import shipped_name

ARRIVED = 1e-3  # of the largest force: the wave is there
AMPLIFIED = 100.0  # times what rounding made until the wave came to the wall: measured up to 56 on the shipped scenes
STILL = 1e-3  # of what is allowed: a contact whose force has changed by less has not felt the wave yet


@dataclass(frozen=True)
class Expected:
    """What a run on an engine is held against; shares are of the largest force.

    Attributes:
        exact_N: shape (samples, contacts).
        scheme: the run's own scheme at the same step.
        plain_N: forces of that scheme where it rounds otherwise, in overlaps; of three dimensions the same.
        rounding: the most that rounding has made until each sample. Shape (samples,).
        rounding_J: the most that it has made of kinetic energies; 0 where that is not known.
        samples: for how many a fault can be told from chaos.
        stated: by which a run may differ from its scheme.
        allowed: the same, and more where rounding by itself makes more.
        order: by which the scheme converges.
        of_N: the largest force of all samples, where these are but the first of them.
    """

    exact_N: Array
    scheme: Trace
    plain_N: Array
    rounding: Array
    rounding_J: float
    samples: int
    stated: Tolerance
    allowed: Tolerance
    order: float
    of_N: float | None = None

    @property
    def largest_N(self) -> float:
        """The largest force."""
        return self.of_N or float(np.abs(self.exact_N).max()) or 1.0

    @property
    def turned(self) -> int:
        """The sample at which the wave has come to the lowest contact; how many there are where it never does."""
        felt = np.flatnonzero(self.exact_N.any(axis=0))
        if not felt.size:
            return len(self.exact_N)
        lowest = self.exact_N[:, felt[0]]
        arrived = np.abs(lowest - lowest[0]) > ARRIVED * self.largest_N
        return int(np.argmax(arrived)) if arrived.any() else len(self.exact_N)

    def until(self, samples: int) -> "Expected":
        """The same of the first samples, which are all that a run that ended badly may have."""
        if samples >= len(self.exact_N):
            return self
        return replace(
            self,
            exact_N=self.exact_N[:samples],
            scheme=until(self.scheme, samples),
            plain_N=self.plain_N[:samples],
            rounding=self.rounding[:samples],
            samples=min(samples, self.samples),
            of_N=self.largest_N,
        )

    def multiplied(self, sample: int) -> float:
        """How often larger rounding is by then than when the wave came to the wall; 1 before."""
        if sample <= self.turned:
            return 1.0
        return float(self.rounding[sample] / max(self.rounding[self.turned], np.finfo(float).eps))

    def chaotic(self, sample: int) -> bool:
        """Whether the chain multiplies by then whatever there is; one body alone is never chaotic, it only adds up."""
        return self.exact_N.shape[1] > 1 and self.multiplied(sample) > AMPLIFIED

    @property
    def explained(self) -> Array:
        """What rounding may make until each sample, in another order of adding. Shape (samples,)."""
        return np.asarray(ROUNDING_MARGIN * self.rounding)

    def still(self, sample: int) -> float:
        """A contact whose force has changed by less has felt nothing until then but rounding."""
        return max(STILL * self.stated.limit, float(self.explained[sample]))


def why_not_known(case: Case) -> str:
    """Why that is not known of a case; empty where it is."""
    if case.chain.lateral is not None:
        return why_unmeasured(case)
    return TOO_LARGE if case.chain.bodies > LARGEST else ""


def expected_of(case: Case, engine: str) -> Expected:
    """What is expected of a run on that engine; of a three-dimensional case cut where rounding alone parts two runs.

    Raises:
        ArithmeticError: the exact motion cannot be followed, or the scheme blows up.
    """
    stated = tolerance("model", model_quantity(case), shipped_name(case))
    adapter = load_engine(engine)
    found = _straight(case, adapter, stated) if case.chain.lateral is None else _sideways(case, adapter, stated)
    if not (np.isfinite(found.scheme.force_N).all() and np.isfinite(found.scheme.kinetic_energy_J).all()):
        raise ArithmeticError("velocity Verlet at this step blows up")
    return found


def _straight(case: Case, adapter: Engine, stated: Tolerance) -> Expected:
    known = yardsticks(case)
    schemes = {EXACT: known.truth.trace, IN_HEIGHTS: known.heights, IN_OVERLAPS: known.verlet}
    shares = np.nan_to_num(residual(known.heights, known.verlet), nan=np.inf)
    rounding, samples = comparable(shares)
    rounding_J = np.abs(known.heights.kinetic_energy_J - known.verlet.kinetic_energy_J)[:samples]
    return Expected(
        exact_N=known.truth.trace.force_N,
        scheme=schemes[adapter.scheme],
        plain_N=known.verlet.force_N,
        rounding=np.maximum.accumulate(shares),
        rounding_J=float(rounding_J.max()),
        samples=samples,
        stated=stated,
        allowed=_allowed(stated, rounding),
        order=1.0 if case.chain.damping_ratio else 2.0,
    )


def _sideways(case: Case, adapter: Engine, stated: Tolerance) -> Expected:
    known = sideways_rods(case, adapter.shear)
    return Expected(
        exact_N=known.extrapolated_N,
        scheme=known.verlet,
        plain_N=known.verlet.force_N,
        rounding=np.maximum.accumulate(known.shares[: known.samples]),
        rounding_J=0.0,
        samples=known.samples,
        stated=stated,
        allowed=_allowed(stated, known.rounding),
        order=known.order,
    )


def _allowed(stated: Tolerance, rounding: float) -> Tolerance:
    reason = f"{ROUNDING_MARGIN:g} times what rounding does to this very scene"
    return stated if rounding <= stated.limit else Tolerance(rounding, reason)


def forces_of_scheme(case: Case, engine: str) -> Array:
    """Forces by an engine's scheme, which has a time step. Shape (samples, contacts)."""
    adapter = load_engine(engine)
    if case.chain.lateral is not None:
        return tube_verlet_of(case, adapter.shear).force_N
    scheme = verlet_in_heights if adapter.scheme == IN_HEIGHTS else verlet_of
    return scheme(case).force_N
