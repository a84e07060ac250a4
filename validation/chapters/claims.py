"""Published numbers: statements of the paper, and cases beyond it; read from files, computed, judged, reported.

``inputs/paper/claims.toml`` holds the statements. Each names the function that computes it, ``module.function`` of
``validation.claims``. ``inputs/independent.toml`` holds the cases. Each names a scene or a study and a measure of
``linear_waves`` or ``strong_waves``.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from math import isnan, nan
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pandas as pd
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError, InputProblem, RunError
from drivers.base.messages import shorten, validate
from drivers.batch.study import read_study, seen_from
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, expected_engines, installed_codes
from drivers.run.run import run_many
from drivers.run.run_folder import EndedRun
from drivers.scene.model import Part, Positive
from drivers.scene.read_scene import apply_settings, read_toml
from postproc.read.motion import Simulation, exact, trace_with_state
from validation.accuracy.plan import plan_case, planned_case
from validation.chapters import Options
from validation.checks import DIFFERS, FAIL, NOT_RUN, PASS, REPRODUCED, Check, pass_or_fail, without_run, worst_of
from validation.claims import chains, equations, linear_waves, strong_waves
from validation.compare.comparison import absences
from validation.report.parts import Chapter, Shown

Kind = Literal["physics", "fitted", "certain", "arithmetic", "case"]
PHYSICS, FITTED, CERTAIN, ARITHMETIC, CASE = get_args(Kind)
UNITS = {"_m_s": "m/s", "_N": "N", "_Hz": "Hz", "_s": "s", "_m": "m", "_rad": "rad", "_diameters": "diameters"}

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}
GROUPS = {  # kinds of statements that are counted apart
    FITTED: "decided by the fitted law of dissipation, by its form or its parameters",
    CERTAIN: "true by similarity, construction or a bound: these check the simulations",
    ARITHMETIC: "arithmetic of the paper's own numbers",
}
FORCE, DELAY = "fig4-amplitudes-agree", "fig4-times-agree"  # statements of the first sentence
SHOWN = ["statement", "published", "computed", "reason"]
DIFFERENCE = (
    "A statement differs if the computation, done right, gives another number than the paper prints: a finding about"
    " the paper, not a failed run. If a sentence can be read in several ways, one is judged, and all are listed."
)
FURTHEST = "Found: the value of the engine furthest from the published one, in shares of the allowed error."

Id = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$", max_length=60)]
Words = Annotated[str, Field(min_length=1)]
Arguments = dict[str, float | str | bool]
Tables = Annotated[tuple[dict[str, Any], ...], Field(strict=False)]


class Reading(Part):
    """One way to read a sentence, or a case of a study.

    Attributes:
        words: the reading, in a few words; empty for a sentence with one meaning.
        arguments: arguments of the claim's function, in addition to those of the claim.
        favoured: reason why this reading is judged; empty for the others.
    """

    words: str = ""
    arguments: Arguments = Field(default_factory=dict)
    favoured: str = ""


Readings = Annotated[tuple[Reading, ...], Field(strict=False, min_length=2)]  # of one sentence


class Claim(Part):
    """A published number; the heads of the files explain the keys.

    Attributes:
        kind: ``case`` for a number of a case beyond the paper.
        expected: the published number; None for that of the measure's theory.
        within, absolute: allowed error, as a share of the expected number or in its unit.
    """

    id: Id
    source: Words
    kind: Kind = "case"
    measure: str = ""
    expected: float | None = None
    within: Positive | None = None
    absolute: Positive | None = None
    reason: Words
    relation: Literal["equals", "at most", "at least"] = "equals"
    unit: str = ""
    # of a statement
    quote: str = ""
    arguments: Arguments = Field(default_factory=dict)
    how: str = ""
    explained: str = ""
    cause: str = ""
    our_criterion: bool = False
    readings: Annotated[tuple[Reading, ...], Field(strict=False)] = (Reading(favoured="the only one"),)
    shared_readings: str = ""
    # of a case
    title: str = ""
    scene: str | None = None
    study: str | None = None
    set: tuple[str, ...] = Field(default=(), strict=False)
    quantity: str = ""
    file: str = ""

    @property
    def against(self) -> str:
        """Origin of the expected number."""
        return "theory" if self.expected is None else "quoted"

    @property
    def favoured(self) -> Reading:
        """The judged reading."""
        return next(reading for reading in self.readings if reading.favoured)

    @property
    def limit(self) -> float:
        """Allowed error."""
        return self.within or self.absolute or 0.0

    def error(self, value: float, expected: float) -> float:
        """Deviation of a computed value, relative or absolute like the limit; NaN for NaN."""
        off = value - expected
        if self.relation != "equals":
            return max(off if self.relation == "at most" else -off, 0.0)  # of NaN and 0 the first: NaN
        return abs(off) / abs(expected) if self.within else abs(off)


class ClaimsFile(Part):
    """A file of published numbers: rows of a ``group`` are claims with the group's keys, so are checks of a ``case``.

    Attributes:
        measure: source and description of the quantities of each measure of cases.
    """

    readings: dict[str, Readings] = Field(default_factory=dict)
    named_causes: dict[str, str] = Field(default_factory=dict)
    measure: dict[str, dict[str, str]] = Field(default_factory=dict)
    claim: Tables = ()
    group: Tables = ()
    case: Tables = ()
    untested: Tables = ()


def read_file(path: Path) -> ClaimsFile:
    """Tables of a file; InputError for one that is wrong."""
    return validate(ClaimsFile, read_toml(path), path)


@cache
def measures() -> dict[str, dict[str, str]]:
    """Description of each quantity by name, and ``source`` of the theory, by measure of cases."""
    return read_file(paths.INDEPENDENT).measure


def read_claims(path: Path = paths.CLAIMS) -> tuple[Claim, ...]:
    """Claims of a file, with shared readings in each claim and scenes as they are seen from here.

    Raises:
        InputError: anything in the file is wrong, such as a claim without a function.
    """
    file, where = read_file(path), paths.shown(path)
    entries = [*file.claim, *(row for group in file.group for row in _rows(group, "rows", where))]
    ids = Counter(str(entry.get("id")) for entry in (*entries, *file.case))
    entries += [row for case in file.case for row in _rows(case, "check", where)]
    if not entries:
        raise InputError(where, "case", "missing key")
    claims: list[Claim] = []
    for entry in entries:
        claim = validate(Claim, entry, where, f"{entry.get('kind', CASE)} {entry.get('id')}: ")
        update: dict[str, Any] = {"file": where, "readings": file.readings.get(claim.shared_readings, claim.readings)}
        update |= {name: seen_from(path, value) for name in ("scene", "study") if (value := getattr(claim, name))}
        update["unit"] = next((unit for ending, unit in UNITS.items() if claim.quantity.endswith(ending)), claim.unit)
        claim = claim.model_copy(update=update)
        place = f"{claim.kind} {claim.id}"
        if ids[claim.id] > 1:
            raise InputError(where, place, "id used twice")
        for key, found, allowed in _problems(claim, file, claims):
            raise InputError(where, f"{place}: {key}".removesuffix(": "), found, allowed)
        claims.append(claim)
    return tuple(claims)


def _rows(table: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    """Rows of a group or a case, each with the keys of the table."""
    rows = table.get(key)
    if not rows or not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        found = f"missing key {key}" if rows is None else shorten(rows)
        raise InputError(where, f"{table.get('kind', CASE)} {table.get('id', key)}", found, "a list of tables")
    return [{name: value for name, value in table.items() if name != key} | row for row in rows]


def _problems(claim: Claim, file: ClaimsFile, before: Sequence[Claim]) -> Iterator[InputProblem]:
    """Problems of a claim as a whole: key, value found, values allowed."""
    if claim.kind == CASE:
        described, check = measures().get(claim.measure, {}), f"check {claim.quantity}"
        for key, names in (("", ("scene", "study")), (check, ("within", "absolute"))):
            given = [name for name in names if getattr(claim, name) is not None]
            if not given:
                yield key, f"missing key {' or '.join(names)}", ""
            if len(given) > 1:
                yield key, f"keys {' and '.join(names)}; give one of them", ""
        if not described:
            yield "measure", shorten(claim.measure), ", ".join(measures())
        if claim.quantity not in described or claim.quantity == "source":
            yield "check.quantity", shorten(claim.quantity), ", ".join(sorted(described.keys() - {"source"}))
        if claim.expected == 0 and claim.within:
            yield check, "within with expected = 0: no error is relative to 0; give absolute", ""
        if (claim.id, quantity_of(claim)) in {(each.id, quantity_of(each)) for each in before}:
            yield check, "check given twice", "each quantity once with expected and once without"
        return
    if claim.kind == ARITHMETIC and claim.id not in equations.paper_numbers():
        yield "", "no value of this id in equations.paper_numbers", ""
    if claim.kind != ARITHMETIC and function_of(claim) is None:
        yield "measure", shorten(claim.measure), "module.function of this folder"
    if claim.expected is None or (claim.relation == "equals" and not claim.absolute):
        yield "", f"missing key {'expected' if claim.expected is None else 'absolute, the tolerance'}", ""
    for key, known in (("shared_readings", file.readings), ("cause", file.named_causes)):
        if getattr(claim, key) not in {"", *known}:
            yield key, shorten(getattr(claim, key)), ", ".join(known) or "none"
    if (count := sum(bool(reading.favoured) for reading in claim.readings)) != 1:
        yield "readings", f"{count} favoured readings", "one, with the reason"


def function_of(claim: Claim, ending: str = "") -> Any:
    """Function that computes a claim, with the ending ``_theory`` its theory; None if there is no such function."""
    module, _, name = claim.measure.replace(" ", "_").rpartition(".")
    places = (place for place in (linear_waves, strong_waves, equations, chains) if place.__name__.endswith(module))
    return next((getattr(place, name + ending) for place in places if hasattr(place, name + ending)), None)


@cache
def cases_of(scene: str | Path | None, study: str | Path | None, settings: tuple[str, ...]) -> dict[str, Case]:
    """Cases of a number, by label: its scene, or all cases of its study, with settings.

    Raises:
        InputError: a scene, study or setting is wrong.
    """
    if scene:
        return {"": planned_case(scene, *settings)}
    file = read_study(study or "")
    apply_settings(file.base, settings)
    return {file.label(number): plan_case(file.case(number)) for number in range(1, file.count + 1)}


IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, VERLET: verlet_of}


def posed(claim: Claim) -> dict[str, Reading | Case]:
    """Ways to compute a claim, by their words: readings of a statement, or cases.

    Raises:
        InputError: a case is wrong, or an expected value is missing and no theory gives it.
    """
    if claim.kind != CASE:
        return {reading.words: reading for reading in claim.readings}
    cases, place = cases_of(claim.scene, claim.study, claim.set), f"case {claim.id}"
    try:
        theories = [_theory(function_of(claim, "_theory"), case) for case in cases.values()]
    except (ValueError, ArithmeticError) as error:
        raise InputError(claim.file, place, str(error), f'a case for the measure "{claim.measure}"') from error
    if claim.expected is None and any(claim.quantity not in theory for theory in theories):
        found = "missing key expected; no theory gives the value"
        raise InputError(claim.file, f"{place}: check {claim.quantity}", found)
    return {**cases}


@cache
def _theory(theory: Callable[[Case], dict[str, float]], case: Case) -> dict[str, float]:
    return theory(case)


def quantity_of(claim: Claim, words: str = "") -> str:
    """Quantity of the checks of a claim in a reading, or on a case of a study."""
    of_case = f"{claim.quantity} against {claim.against}"
    name = of_case if claim.kind == CASE else claim.measure or claim.kind
    return f"{name} ({words})" if words else name


def check_of(claim: Claim, words: str, engine: str, value: float, expected: float) -> Check:
    """Verdict on a value; the scene is the id of the claim, and a difference has its explanation in ``where``."""
    error, unit = claim.error(value, expected), f" {claim.unit}".rstrip()
    verdict = pass_or_fail(error, claim.limit)
    if claim.kind == CASE:
        found = "not visible in the run" if isnan(value) else f"found {value:.8g}{unit}"
        source = measures()[claim.measure]["source"] if claim.expected is None else claim.source
        where = f"{found}, expected {expected:.8g}{unit}: {source}"
    else:
        verdict = DIFFERS if verdict == FAIL else REPRODUCED
        where = f"{claim.source}: computed {value:.6g}, quoted {expected:g}{unit}"
        where += f": {claim.explained}" if verdict == DIFFERS and claim.explained else ""
    quantity = quantity_of(claim, words)
    return Check(claim.id, engine, quantity, error, claim.limit, claim.reason, where, verdict, value, expected)


def favoured(claim: Claim, checks: Sequence[Check]) -> dict[str, Check]:
    """Checks of the favoured reading of a statement, by engine; by ``reference`` only if no chain is simulated."""
    judged = quantity_of(claim, claim.favoured.words)
    return {check.engine: check for check in checks if check.quantity == judged}


def fault_of(claim: Claim, checks: Sequence[Check]) -> str:
    """Fault of a statement: a difference without an explanation, the reverse, or engines that disagree; else empty."""
    judged = favoured(claim, checks)
    check = judged[REFERENCE]
    if check.verdict == DIFFERS and not claim.explained:
        return f"differs without an explanation: {check.found:.6g}, quoted {claim.expected:g}"
    if check.verdict == REPRODUCED and claim.explained:
        return "is reproduced, but a difference is explained"
    other = [one.engine for one in judged.values() if one.verdict != check.verdict]
    other += [f"{one.engine} ({one.where})" for one in checks if one.verdict == FAIL]
    return f"{', '.join(other)} disagree with the reference" if other else ""


def judge(claims: Sequence[Claim], runs: Path = paths.RUNS) -> list[Check]:
    """Compute and judge claims, codes in parallel and finished runs reused.

    The reference computes the statements first; then the codes run all cases that it needed for them, and those of the
    cases beyond the paper. A code that needs another one, such as a strike of corrected speed, runs it when it does.

    Raises:
        InputError: a case is wrong, or a guard refuses it; nothing has been run.
    """
    asked: list[Case] = []  # for the value that is computed
    ended: dict[tuple[str, str], EndedRun] = {}

    def run_all(jobs: Iterable[tuple[Case, str]]) -> None:
        taken = {_key(*job): job for job in jobs if job[1] not in IN_REPO and not absences(job[0], [job[1]])}
        # the last of equal decks is run: those that keep the state come last
        keys = sorted(taken, key=lambda key: "state" in taken[key][0].scene.run.record)
        ended.update(zip(keys, run_many([taken[key] for key in keys], runs), strict=True))

    def run(case: Case, engine: str) -> Simulation:
        asked.append(case)
        if engine in IN_REPO:
            return Simulation(case, engine, IN_REPO[engine](case))
        if absent := absences(case, [engine]):
            raise RunError(absent[engine], NOT_RUN)
        if _key(case, engine) not in ended:
            run_all([(case, engine)])
        done = ended[_key(case, engine)]
        if not done.done:
            raise RunError(f"{done.record.status}: {done.record.reason}")
        # without the state if another case has the same run and records it
        return Simulation(case, engine, trace_with_state(done) if "state" in case.scene.run.record else done.trace)

    @cache
    def quantities(measure: Callable[[Case, Trace], dict[str, float]], case: Case, engine: str) -> dict[str, float]:
        return measure(case, run(case, engine).trace)

    def check(claim: Claim, words: str, way: Reading | Case, engine: str) -> Check:
        function, expected = function_of(claim), claim.expected or 0.0
        if isinstance(way, Case):
            value = quantities(function, way, engine).get(claim.quantity, nan)
            if claim.expected is None:
                expected = _theory(function_of(claim, "_theory"), way)[claim.quantity]
        elif claim.kind == ARITHMETIC:
            value = equations.paper_numbers()[claim.id]
        else:
            given = () if claim.measure.startswith("equations.") else (partial(run, engine=engine),)
            value = float(function(*given, **(claim.arguments | way.arguments)))
        return check_of(claim, words, engine, value, expected)

    ways = [(claim, words, way) for claim in claims for words, way in posed(claim).items()]
    checks, jobs = dict[Check, None](), list[tuple[Case, str]]()
    on_engines: list[tuple[Claim, str, Reading | Case, str]] = []
    for claim, words, way in ways:
        asked[:] = [way] if isinstance(way, Case) else []
        engines = expected_engines() if claim.kind == CASE else installed_codes()
        if claim.kind != CASE:
            checks[check(claim, words, way, REFERENCE)] = None
        if asked and (claim.kind == CASE or way is claim.favoured):
            on_engines += product([claim], [words], [way], engines)
            jobs += product(asked, engines)
    run_all(jobs)
    for claim, words, way, engine in on_engines:
        try:
            checks[check(claim, words, way, engine)] = None
        except (RunError, ValueError, ArithmeticError, IndexError) as error:
            verdict = NOT_RUN if isinstance(error, RunError) and error.status == NOT_RUN else FAIL
            checks[without_run(claim.id, engine, f"{words}: {error}".removeprefix(": "), verdict)] = None
    places = {claim.id: place for place, claim in enumerate(claims)}
    return sorted(checks, key=lambda check: places[check.scene])


def _key(case: Case, code: str) -> tuple[str, str]:
    return case.scene.model_dump_json(), code


def measure(options: Options) -> Chapter:
    """Judge the paper's statements and the shipped cases; with a file of own cases, these alone."""
    statements, cases = read_claims(), read_claims(options.file)
    taken = {claim.id for claim in statements}
    for claim in cases:
        if claim.kind != CASE or claim.id in taken:
            raise InputError(claim.file, f"case {claim.id}", "the id of a statement of the paper", "another id")
    claims = cases if options.file != paths.INDEPENDENT else (*statements, *cases)
    return chapter_of(claims, judge(claims, options.runs))


def chapter_of(claims: Sequence[Claim], checks: Sequence[Check]) -> Chapter:
    """Chapter on judged claims; its checks are those of the cases, and the faults of statements, of no engine."""
    own = {claim.id: [check for check in checks if check.scene == claim.id] for claim in claims}
    statements = {claim.id: claim for claim in claims if claim.kind != CASE}
    judged = [check for check in checks if check.scene not in statements]
    counts = Counter(check.verdict for check in judged)
    counted = f"cases beyond the paper: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    for name, claim in statements.items():
        if fault := fault_of(claim, own[name]):
            judged.append(replace(favoured(claim, own[name])[REFERENCE], engine="", where=fault, verdict=FAIL))
    rows = pd.DataFrame([_row(claim, own[claim.id]) for claim in claims])
    found = [*(findings(rows) if statements else ()), counted]
    return Chapter({"claims": pd.DataFrame(checks)}, found, shown=_shown(rows), checks=judged)


def _row(claim: Claim, checks: Sequence[Check]) -> dict[str, Any]:
    """A claim with its published and computed number, the verdict, other readings, reasons, and what is counted."""
    if claim.kind == CASE:
        missing = [check for check in checks if isnan(check.limit)]
        measured = [check for check in checks if check.quantity.startswith(quantity_of(claim))]
        judged = worst_of(measured) or max(missing, key=lambda check: check.verdict == FAIL)
        words, listed = measures()[claim.measure][claim.quantity], [judged.engine]
        reason = [f"error {judged.value:.1e}: {claim.reason}", *(f"{one.engine}: {one.where}" for one in missing)]
    else:
        exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
        judged = exact[quantity_of(claim, claim.favoured.words)]
        words = claim.quote
        how = claim.how or (function_of(claim).__doc__ or "").partition("\n")[0] if claim.kind != ARITHMETIC else ""
        listed = [how.replace("``", "")] if how else []
        for reading in claim.readings if claim.favoured.words else ():
            check = exact[quantity_of(claim, reading.words)]
            marked = reading.words + ", judged" * bool(reading.favoured)
            listed.append(f"{marked}: {_number(claim, check)}, {check.verdict}")
        reason = [claim.explained or claim.reason, *["our criterion"] * claim.our_criterion]
        reason += ["by the fitted law"] * (claim.kind == FITTED)
        reason += ["depends on the reading"] * (len({check.verdict for check in exact.values()}) > 1)
    within = f" ± {claim.absolute:g}" if claim.relation == "equals" and claim.absolute else ""
    share = f", within {claim.within:g} of it" if claim.within else ""
    return {
        "statement": "\n".join(filter(None, (words, claim.title, claim.source))),
        "published": f"{RELATIONS[claim.relation]}{judged.expected:.8g}{within} {claim.unit}".rstrip() + share,
        "computed": "\n".join([f"{judged.verdict} {_number(claim, judged)}", *listed]),
        "reason": "\n".join(reason),
        **claim.model_dump(include={"id", "kind", "our_criterion", "cause"}),
        **{name: getattr(judged, name) for name in ("verdict", "expected", "found")},
    }


def _number(claim: Claim, check: Check) -> str:
    """Computed number: eight digits for a tight tolerance, else four."""
    tight = 0 < claim.limit < 1e-4 * (1.0 if claim.within else abs(check.expected))
    return "–" if isnan(check.found) else f"{check.found:.{8 if tight else 4}g}"


def findings(rows: pd.DataFrame) -> list[str]:
    """Theory against experiment, the number of reproduced statements, causes of differences, and counts by kind."""
    good, physics = rows["verdict"] == REPRODUCED, rows["kind"] == PHYSICS
    numbers = {row["id"]: row for row in rows.to_dict("records")}
    force, delay = numbers[FORCE], numbers[DELAY]
    theirs, ours = (physics & (rows["our_criterion"] == our) for our in (False, True))

    def share(group: pd.Series) -> str:
        return f"{(group & good).sum()} of {group.sum()}"

    words = read_file(paths.CLAIMS).named_causes | {"": "other causes"}
    off = Counter(rows.loc[physics & ~good, "cause"])
    causes = "; ".join(f"{words[cause]} ({off[cause]})" for cause in words if off[cause])
    return [
        f"In Fig. 4 elastic theory gives {force['found']:.1f} times the measured force, and a wave that is"
        f" {100 * (delay['expected'] / delay['found'] - 1):.0f} % faster.",
        f"{share(physics)} statements of the paper that can fail on physics are reproduced: {share(theirs)} by a number"
        f" or direction of the paper, {share(ours)} by our criterion for its words.",
        f"{off.total()} differ: {causes}.",
        *(f"{text}: {share(rows['kind'] == kind)} reproduced" for kind, text in GROUPS.items()),
    ]


def _shown(rows: pd.DataFrame) -> list[Shown]:
    """Statements that differ, those that are reproduced, the paper's own numbers, those without a test, and cases."""
    cases, own = rows["kind"] == CASE, rows["kind"] == ARITHMETIC
    of_cases = f"Beyond the paper: {rows.loc[cases, 'id'].nunique()} cases with published or theoretical numbers"
    shown = [Shown(of_cases, FURTHEST, rows.loc[cases, SHOWN])]
    if cases.all():
        return shown
    differ, reproduced = (~cases & ~own & (rows["verdict"] == verdict) for verdict in (DIFFERS, REPRODUCED))
    untested = pd.DataFrame(read_file(paths.CLAIMS).untested)
    untested["quote"] += "\n" + untested.pop("source")
    return [
        Shown("", DIFFERENCE, rows.loc[differ, SHOWN]),
        Shown(f"Reproduced statements: {reproduced.sum()}", "", rows.loc[reproduced, SHOWN]),
        Shown(f"The paper's own numbers: {own.sum()}", "", rows.loc[own, SHOWN]),
        Shown(f"Not tested: {len(untested)}", "", untested.rename(columns={"quote": "statement"})),
        *shown,
    ]
