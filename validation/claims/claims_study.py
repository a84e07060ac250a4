"""The paper's statements: computed, judged, told.

A claim names the function that computes it, ``module.function`` in ``validation/claims``, and its ``arguments``. One of
``run`` is asked for every engine, one of ``table`` reads the solved Table 1; into others no simulated chain enters.
"""

import inspect
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from math import isnan, nan
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.engines import REFERENCE, in_order, installed_codes
from drivers.run.run import workers
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.quoted import quoted
from postproc.paper.simulate import exact, run_codes
from postproc.paper.strikes import solve_table1
from validation.claims import equations, simulated
from validation.claims.simulated import Run
from validation.studies import Options, Study, Tables, rows_in

REPRODUCED, DIFFERS, EXPERIMENT_ONLY = "reproduced", "differs", "experiment only"
MODULES = {"equations": equations, "simulated": simulated}


class Claim(Part):
    """A statement of the paper; see the head of the file for the keys."""

    id: str
    where: str
    quote: str
    compute: str = ""
    arguments: dict[str, float | str] = Field(default_factory=dict)
    how: str = ""
    quoted: Annotated[float, Field(allow_inf_nan=False)]
    unit: str = ""
    relation: Literal["equals", "at most", "at least"] = "equals"
    within: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    because: str = ""
    explained: str = ""
    experiment: bool = False
    ours: bool = False
    arithmetic: bool = False
    note: str = ""

    def holds_for(self, value: float) -> bool:
        """Whether a computed value agrees with the statement; NaN does not."""
        if self.relation == "at most":
            return value <= self.quoted
        if self.relation == "at least":
            return value >= self.quoted
        return abs(value - self.quoted) <= (self.within or 0.0)


class ClaimsFile(Part):
    """The file."""

    claim: Annotated[tuple[Claim, ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True)
class Judged:
    """A claim with what came out."""

    claim: Claim
    computed: dict[str, float]  # by engine, else under ``reference``; empty where nothing is computed
    how: str  # what was computed

    @property
    def value(self) -> float:
        """The reference's value."""
        return self.computed.get(REFERENCE, float("nan"))

    @property
    def verdict(self) -> str:
        """By the reference's value."""
        if self.claim.experiment:
            return EXPERIMENT_ONLY
        return REPRODUCED if self.claim.holds_for(self.value) else DIFFERS

    @property
    def fault(self) -> str:
        """Why this cannot stand: a difference that nobody explained or an explanation without one, engines apart."""
        if self.verdict == DIFFERS and not self.claim.explained:
            return f"differs without an explanation: {self.value:.6g}, quoted {self.claim.quoted:g}"
        if self.verdict == REPRODUCED and self.claim.explained:
            return "is reproduced, but a difference is explained"
        other = [e for e, v in self.computed.items() if self.claim.holds_for(v) != self.claim.holds_for(self.value)]
        return f"{', '.join(other)} disagree with the reference" if other and not self.claim.experiment else ""


def read_claims(path: Path = paths.CLAIMS) -> tuple[Claim, ...]:
    """The claims of the file.

    Raises:
        InputError: anything wrong with it, a claim that nothing computes included.
    """
    where = paths.shown(path)
    claims = validate(ClaimsFile, read_toml(path), where).claim
    counts = Counter(claim.id for claim in claims)
    for claim in claims:
        key = f"claim {claim.id}"
        if counts[claim.id] > 1:
            raise InputError(where, key, "the same id twice", "an id of its own for each claim")
        function = function_of(claim)
        if function is None and (claim.compute or not claim.experiment):
            found = shorten(claim.compute) if claim.compute else "nothing"
            raise InputError(where, f"{key}: compute", found, f"module.function of {', '.join(MODULES)}")
        amplitude, amplitudes = claim.arguments.get("force_N"), quoted().table1.force_N
        if amplitude is not None and amplitude not in amplitudes:
            allowed = ", ".join(f"{each:g}" for each in amplitudes)
            raise InputError(where, f"{key}: arguments.force_N", str(amplitude), allowed)
        given = parameters_of(function) & {"run", "table"}  # whose arguments are not the claim's
        try:
            if function:
                inspect.signature(function).bind(*given, **claim.arguments)
        except TypeError as error:
            raise InputError(where, f"{key}: arguments", str(error), f"those of {claim.compute}") from error
        if claim.experiment:
            continue
        if claim.relation == "equals" and claim.within is None:
            raise InputError(where, key, "no within", "a tolerance")
        if not claim.because:
            raise InputError(where, key, "no because", "the reason of the tolerance")
    return claims


def function_of(claim: Claim) -> Callable[..., Any] | None:
    """What computes a claim; None where nothing of that name does."""
    module, _, name = claim.compute.partition(".")
    function = getattr(MODULES.get(module), name, None)
    public = inspect.isfunction(function) and function.__module__.endswith(f".{module}") and not name.startswith("_")
    return function if public else None


def parameters_of(function: Callable[..., Any] | None) -> set[str]:
    """Names of a function's parameters; none of no function."""
    return set(inspect.signature(function).parameters) if function else set()


def judge_all(runs: Path = paths.RUNS) -> list[Judged]:
    """Computes and judges every claim; what simulations enter by every engine, the codes side by side.

    Raises:
        RunError: a run failed.
    """
    claims, table = read_claims(), solve_table1(runs)
    functions = {claim.id: partial(each, **claim.arguments) for claim in claims if (each := function_of(claim))}
    engines = (REFERENCE, *installed_codes())

    def compute(engine: str) -> dict[str, float]:
        run: Run = exact if engine == REFERENCE else lambda case: run_codes({engine: [case]}, runs)[engine][0]
        return {name: each(run) for name, each in functions.items() if "run" in parameters_of(each)}

    with workers(len(engines)) as pool:
        found = dict(zip(engines, pool.map(compute, engines), strict=True))
    judged = []
    for claim in claims:
        function = functions.get(claim.id)
        if function is None:
            computed = {}
        elif "table" in parameters_of(function):
            computed = function(table)
        elif "run" in parameters_of(function):
            computed = {engine: values[claim.id] for engine, values in found.items()}
        else:
            computed = {REFERENCE: function()}
        how = claim.how or inspect.getdoc(function and function.func) or ""
        judged.append(Judged(claim, computed, " ".join(how.replace("``", "").split())))
    return judged


RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}


@dataclass(frozen=True)
class Row:
    """A claim with what came out, as the table has it."""

    id: str
    where: str
    quote: str
    relation: str
    quoted: float
    number_is: str  # whose reading of the paper's words the quoted number is
    unit: str
    kind: str
    within: float
    because: str
    computed: Mapping[str, float]  # by engine
    difference: float  # the reference's value less the quoted one
    verdict: str
    why: str
    how: str  # what was computed


def measure(options: Options) -> dict[str, list[Row]]:
    """Rows of all claims.

    Raises:
        RunError: a run failed.
    """
    return {"claims": [row_of(judged) for judged in judge_all(options.runs)]}


def row_of(judged: Judged) -> Row:
    """A judged claim as the table has it."""
    claim = judged.claim
    same = ("id", "where", "quote", "relation", "quoted", "unit", "because")
    return Row(
        **{name: getattr(claim, name) for name in same},
        number_is="ours" if claim.ours else "the paper's",
        kind="arithmetic" if claim.arithmetic else "computed",
        within=nan if claim.within is None else claim.within,
        computed=judged.computed,
        difference=judged.value - claim.quoted,
        verdict=judged.verdict,
        why=claim.explained or claim.note,
        how=judged.how,
    )


def judged_in(tables: Tables) -> list[Judged]:
    """The claims of ``inputs/paper/claims.toml`` with what the table says came out.

    Raises:
        InputError: the table is of other claims.
    """
    rows, claims = rows_in(tables["claims"], Row), read_claims()
    if [row.id for row in rows] != [claim.id for claim in claims]:
        found = f"not the claims of {paths.shown(paths.CLAIMS)}"
        raise InputError("claims.csv", "id", found, "the table that make claims writes")
    return [Judged(claim, dict(row.computed), row.how) for claim, row in zip(claims, rows, strict=True)]


def sentences(tables: Tables) -> list[str]:
    """Statements that differ, and how many there are of each verdict."""
    judged = judged_in(tables)
    counts = Counter(each.verdict for each in judged)
    plain = sum(each.claim.arithmetic for each in judged if each.verdict == REPRODUCED)
    reproduced = f"{counts[REPRODUCED]} reproduced ({plain} of them by plain arithmetic)"
    differ = [
        f"{each.claim.id}: quoted {each.claim.quoted:g}, computed {each.value:.4g} {each.claim.unit}: "
        f"{each.claim.explained}"
        for each in judged
        if each.verdict == DIFFERS
    ]
    return [*differ, f"{reproduced}, {counts[DIFFERS]} differ, {counts[EXPERIMENT_ONLY]} of the experiment only"]


def missed(tables: Tables) -> list[str]:
    """Claims that cannot stand."""
    return [f"{each.claim.id}: {each.fault}" for each in judged_in(tables) if each.fault]


def section(tables: Tables) -> dict[str, Any]:
    """The rows by verdict, the differing ones first, and the engines in them."""
    judged_in(tables)
    rows: dict[str, list[dict[str, Any]]] = {verdict: [] for verdict in (DIFFERS, REPRODUCED, EXPERIMENT_ONLY)}
    table = rows_in(tables["claims"], Row)
    for row in table:
        rows[row.verdict].append(_cells(row))
    return {"rows": rows, "engines": in_order({engine for row in table for engine in row.computed})}


def _cells(row: Row) -> dict[str, Any]:
    computed = row.computed.get(REFERENCE, nan)
    # more digits than four only where the tolerance looks at them
    digits = 8 if 0 < row.within < 1e-4 * abs(row.quoted) else 4
    return asdict(row) | {
        "ours": "our criterion" if row.number_is == "ours" else "",
        "kind": "plain arithmetic" if row.kind == "arithmetic" else "",
        "quoted": f"{RELATIONS[row.relation]}{row.quoted:.8g}",
        "within": f"± {row.within:g}" if not isnan(row.within) and row.relation == "equals" else "",
        "computed": "–" if isnan(computed) else f"{computed:.{digits}g}",
        "why": row.why or row.because,
    }


STUDY = Study("claims", "the paper's statements, computed", {"claims": Row}, measure, sentences, section, missed=missed)
