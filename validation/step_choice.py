"""The largest time step that keeps an accuracy, found by running the codes' own scheme on the very case.

Velocity Verlet in this repository costs about a fiftieth of a code's run at the same step, and errs by the same amount
to ten digits: the error that is predicted is one that was measured. The exact motion is followed only as exactly as
the accuracy asks.
"""

from dataclasses import dataclass
from math import ceil, inf, sqrt

import numpy as np

from drivers.case import Case
from drivers.chain import Array
from drivers.errors import InputError
from drivers.read_scene import MAX_STEPS
from postproc.residual import share_of_largest
from validation.errors import ENERGY, FORCE, Truth, errors_of, truth_of, verlet_of
from validation.reference.adaptive import LEAST_TOLERANCE
from validation.rounding import ROUNDING_MARGIN, rounding_error
from validation.stable_step import stable_step

LEAST_ACCURACY = 10 * LEAST_TOLERANCE
TRUTH_SHARE = 1e-2  # of the accuracy: how exact the exact motion has to be
LOOSEST_TRUTH = 1e-4
TOLERATED = 1 - TRUTH_SHARE  # of the accuracy: what the exact motion leaves
CLOSE = 1.2  # a step that is refused within this factor of the one that is taken ends the search
MOST_TRIES = 60
STALLED, SMALL = 0.5, 1e-2  # a small error that falls by less, with the step four times finer, has met its floor
CHEAPER = 16  # rounding is measured at a step so many times larger, where one as fine would cost too much
AFFORDABLE = 400_000  # bodies times steps of which rounding is measured as it is: some milliseconds


@dataclass(frozen=True)
class Rounding:
    """What the rounding of absolute heights is predicted to do to a case, as shares of the largest force.

    Attributes:
        share: shape (samples,): the largest up to each sample.
        steps_per_sample: at which it was measured; ``share`` is scaled from there as a random walk is.
    """

    share: Array
    steps_per_sample: int

    @property
    def allowance(self) -> float:
        """What engines may show of it by the end."""
        return ROUNDING_MARGIN * float(self.share[-1])


@dataclass(frozen=True)
class Choice:
    """A time step with the errors to expect.

    Attributes:
        case: at that step.
        wanted: the accuracy asked for, by quantity.
        errors: predicted truncation, and where samples limit it, by quantity.
        refused: the largest step found too coarse, in steps a sample; 0 where none was.
        stable_s: 2 / omega_max at the largest overlaps.
        trials: runs of the in-repo scheme.
    """

    case: Case
    wanted: dict[str, float]
    errors: dict[str, float]
    refused: int
    stable_s: float
    rounding: Rounding
    trials: int


class Chooser:
    """Chooses steps of one case; exact motions and trials are kept for the next question."""

    def __init__(self, case: Case, names: tuple[str, ...], strictest: float) -> None:
        """Follows the exact motion.

        Args:
            case: the case, at any step.
            names: of the quantities that will be asked for.
            strictest: the smallest accuracy that will be asked for.

        Raises:
            InputError: the case does not have a quantity, or its exact motion cannot be followed.
        """
        self.case = case
        self.names = names
        tolerance = min(max(TRUTH_SHARE * strictest, LEAST_TOLERANCE), LOOSEST_TRUTH)
        finer = any(name not in (FORCE, ENERGY) for name in names)
        try:
            self.truth: Truth = truth_of(case, tolerance, finer=finer)
        except ArithmeticError as error:
            raise InputError(case.scene.file, "run.accuracy", str(error), "run.time_step instead") from error
        self._check_names()
        self.stable_s = stable_step(case.chain, self.truth.trace.force_N.max(axis=0))
        self._errors: dict[int, dict[str, float]] = {}

    def _check_names(self) -> None:
        for name in self.names:
            if name not in (FORCE, ENERGY) and not self.truth.true.get(name):
                has = ", ".join([FORCE, ENERGY, *(each for each, value in self.truth.true.items() if value)])
                raise InputError(self.case.scene.file, f"run.accuracy.{name}", "nothing that this scene shows", has)

    def errors_at(self, steps_per_sample: int) -> dict[str, float]:
        """Errors of the codes' scheme, by quantity."""
        if steps_per_sample not in self._errors:
            case = self.case.at(steps_per_sample)
            with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
                self._errors[steps_per_sample] = errors_of(case, verlet_of(case), self.truth, self.names)
        return self._errors[steps_per_sample]

    def choose(self, wanted: dict[str, float]) -> Choice:
        """The fewest steps a sample with which all errors stay below what is wanted.

        Raises:
            InputError: no step keeps it; the attainable accuracy is named.
        """
        for name, share in wanted.items():
            if share < LEAST_ACCURACY:
                raise self._unattainable(name, share, LEAST_ACCURACY, "what the exact motion itself is known to")
            if name not in (FORCE, ENERGY) and self.truth.sampling_known:
                left = abs(self.truth.sampled.get(name, inf) / self.truth.true[name] - 1)
                if left >= share:
                    why = "what samples so far apart show, at any time step (sample_interval smaller: more)"
                    raise self._unattainable(name, share, 1.25 * left, why)

        def excess(steps: int) -> float:
            return max(error / (TOLERATED * wanted[name]) for name, error in self.errors_at(steps).items())

        samples = self.case.scene.samples - 1
        interval = self.case.scene.run.sample_interval
        steps = max(1, ceil(0.9 * interval / self.stable_s))
        refused, taken = steps - 1 if steps == 1 else 0, 0
        before, tries = (0, inf), 0
        while not (taken and (taken <= refused + 1 or taken <= CLOSE * refused or taken == 1)):
            if steps * samples > MAX_STEPS or tries > MOST_TRIES:
                self._give_up(wanted, before[0] or steps, f"with {MAX_STEPS} steps")
            found = excess(steps)
            tries += 1
            if found <= 1:
                taken = steps
            else:
                small = max(self.errors_at(steps).values()) < SMALL
                if small and steps >= 4 * before[0] > 0 and found > STALLED * before[1]:
                    self._give_up(wanted, steps, "what rounding leaves of it in double precision")
                refused = max(refused, steps)
                before = (steps, found)
            guess = ceil(1.002 * steps * sqrt(found)) if np.isfinite(found) else 2 * steps
            steps = _next(refused, taken, guess)
        return Choice(
            self.case.at(taken), wanted, self.errors_at(taken), refused, self.stable_s, self.rounding(taken), tries
        )

    def choose_with_room(self, wanted: dict[str, float]) -> Choice:
        """As ``choose``, with room for what rounding of heights may add, as long as it takes less than half."""
        choice = self.choose(wanted)
        rounding = choice.rounding.allowance
        tight = any(choice.errors[name] + rounding > share for name, share in wanted.items())
        if tight and 2 * rounding < min(wanted.values()):
            choice = self.choose({name: share - 1.1 * rounding for name, share in wanted.items()})
        return choice

    def rounding(self, steps_per_sample: int) -> Rounding:
        """What the rounding of heights does, measured where that is cheap; it grows as a random walk with the steps."""
        case = self.case.at(steps_per_sample)
        measured = steps_per_sample
        if case.chain.bodies * case.scene.steps > AFFORDABLE:
            first = ceil(0.5 * self.case.scene.run.sample_interval / self.stable_s)
            measured = min(steps_per_sample, max(first, steps_per_sample // CHEAPER, 1))
        error = share_of_largest(rounding_error(self.case.at(measured)), self.truth.trace)
        return Rounding(np.maximum.accumulate(error) * sqrt(steps_per_sample / measured), measured)

    def _give_up(self, wanted: dict[str, float], steps: int, why: str) -> None:
        errors = self.errors_at(steps)
        worst = max(wanted, key=lambda name: errors[name] / wanted[name])
        raise self._unattainable(worst, wanted[worst], 1.25 * errors[worst], why)

    def _unattainable(self, name: str, asked: float, attainable: float, why: str) -> InputError:
        return unattainable(self.case, name, asked, attainable, why)


def _next(refused: int, taken: int, guess: int) -> int:
    """Where to try next: at the guess, or where a refusal would end the search, inside what is not known yet."""
    if not taken:
        return max(refused + 1, guess)
    if guess >= taken:
        guess = min(taken - 1, ceil(taken / CLOSE))
    if guess <= refused:
        return refused + max(1, round((taken - refused) / 2))
    return min(guess, taken - 1)


def unattainable(case: Case, name: str, asked: float, attainable: float, why: str) -> InputError:
    """What to say of an accuracy that nothing gives."""
    key = "run.accuracy" if name == FORCE else f"run.accuracy.{name}"
    return InputError(case.scene.file, key, f"{asked:g}", f"at least {attainable:.2g} here, {why}")
