"""Sentence on the law of a wrong run: the measured values that are not the scene's, said as a pattern."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import floor, inf, log10
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array, stiffness_by
from drivers.chain.contact_law import hertz_stiffness
from drivers.chain.trace import Trace
from drivers.engines import EXACT, load_engine
from drivers.run.run import run_case
from drivers.run.run_folder import EndedRun
from drivers.scene.model import RIGID, Material
from drivers.scene.read_scene import read_toml
from postproc.read.motion import trace_with_state
from validation.accuracy import measured_law as law
from validation.accuracy.measured_law import SIGNIFICANCE, LawRow, measure_law
from validation.accuracy.motions import motions_of
from validation.checks import FAIL, Check

SAME = "the measured law, masses, loads and start are the scene's"
CLOSENESS = 0.02  # of a time step: agreement of a delay with half a step or one step
SMALL_SPEED = 1e-4  # relative error of a start speed that another fault may cause within a time step
MAX_GROUPS = 3  # of contacts or bodies, that are named


def diagnoses_of(
    case: Case, checks: Iterable[Check], finished: Mapping[str, EndedRun], refused: Mapping[str, Trace], runs: Path
) -> dict[str, str]:
    """Sentence on the law of each failed run and of each run that is not right, by engine.

    A finished run without positions is repeated to record them.

    Args:
        case: the scene.
        checks: checks of all engines.
        finished: finished runs by engine.
        refused: partial traces of failed runs by engine.
        runs: folder of the run folders.
    """
    wrong = [check for check in checks if check.verdict == FAIL and not check.quantity.startswith("error")]
    sentences = {}
    for engine in dict.fromkeys(check.engine for check in wrong):
        if engine in refused:
            sentences[engine] = law_sentence(case, engine, refused[engine])
        elif engine in finished:
            try:
                sentences[engine] = law_sentence(case, engine, _with_state(case, engine, finished[engine], runs))
            except (InputError, RunError) as error:
                sentences[engine] = f"law not measured: {error}"
    return sentences


def _with_state(case: Case, engine: str, run: EndedRun, runs: Path) -> Trace:
    trace = trace_with_state(run)
    if trace.height_m is not None:
        return trace
    timing = case.scene.run.model_copy(update={"record": ("forces", "state")})
    keeping = replace(case, scene=case.scene.model_copy(update={"run": timing}))
    return trace_with_state(run_case(keeping, engine, runs))


def law_sentence(case: Case, engine: str, trace: Trace) -> str:
    """Sentence on the measured values of a run that are not the scene's; or the reason why nothing was measured."""
    step_s = 0.0 if load_engine(engine).scheme == EXACT else case.scene.time_step_s
    try:
        rows, phrases = measure_law(case, trace, step_s), list[str]()
        wrong = {row.quantity: row for row in rows if row.differs}
        clock = wrong.get(law.INTERVAL)
        if clock and (law.RESISTANCE not in wrong or abs(clock.ratio - 1) > CLOSENESS):
            # other values at the true times
            phrases.append(f"a time step {_times(clock, 1)} times the scene's, with the scene's time stamps")
            rows = measure_law(case, replace(trace, time_s=clock.ratio * trace.time_s), clock.ratio * step_s)
            wrong = {row.quantity: row for row in rows if row.differs}
    except ValueError as error:
        return f"law not measured: {error}"
    if law.RESISTANCE in wrong:  # it changes all other values
        return "; ".join([*phrases, _of_resistance(engine, rows)])
    if _is_another_step(wrong):
        return phrases[0] if phrases else f"a time step {_times(wrong[law.EARLY_START], 1)} times the scene's"
    phrases += _of_clock(case, rows)
    if not phrases:
        phrases = [*_of_start(case, rows), *_of_contacts(case, engine, rows), *_of_bodies(case, rows)]
    return "; ".join(phrases) or _of_step(case, engine, trace)


def _steps_of(row: LawRow | None) -> float:
    """Delay of a row in time steps; 0 without the row."""
    return row.ratio - 1 if row else 0.0


def _is_another_step(wrong: Mapping[str, LawRow]) -> bool:
    """True if heights and velocities are off as for a step that differs from the one by which they were set back."""
    early = _steps_of(wrong.get(law.EARLY_START))
    return bool(early) and abs(early - 2 * _steps_of(wrong.get(law.LATE_VELOCITY))) < CLOSENESS


def _of_resistance(engine: str, rows: list[LawRow]) -> str:
    """Phrase on Cundall's non-viscous damping, which reduces the force on a body against its motion."""
    share = float(np.median([row.ratio - 1 for row in rows if row.quantity == law.RESISTANCE and row.differs]))
    default = load_engine(engine).defaults.local_damping
    same = f", the default of {engine.upper()}" if default and abs(share / default - 1) < CLOSENESS else ""
    return f"non-viscous damping of {share:.3g}{same}"


def _times(row: LawRow, least: int = 3) -> str:
    """Ratio of a row with the digits that its uncertainty leaves, and as many as show that it is not 1."""
    sure = floor(-log10(SIGNIFICANCE * row.uncertainty))
    apart = floor(-log10(abs(row.ratio - 1) or 1.0)) + 1
    return f"{row.ratio:.{min(max(least, min(sure, 6), apart), 15)}f}".rstrip("0").rstrip(".")


def _grouped(rows: Sequence[LawRow], quantity: str, noun: str, words: str, labels: Sequence[str]) -> Iterator[str]:
    """Phrases on places of equal ratio: all places, all of a label, or single ones.

    Args:
        rows: all measured rows.
        quantity: quantity of the phrase.
        noun: of a place, such as "contact".
        words: verb and object with ``{}`` for the ratio, such as "{verb} {} times as stiff".
        labels: label of each place, in the order of the places.
    """
    measured = [row for row in rows if row.quantity == quantity]
    groups: dict[str, list[int]] = {}
    for row in measured:
        if row.differs:
            groups.setdefault(_times(row), []).append(row.place)
    for ratio, places in [*groups.items()][:MAX_GROUPS]:
        kinds = {labels[place - 1] for place in places}
        alike = [row.place for row in measured if labels[row.place - 1] in kinds]
        if len(places) == len(measured) > 1:
            subject = f"all {noun}s"
        elif len(kinds) == 1 and len(places) == len(alike) > 1:
            subject = f"all {noun}s of {kinds.pop()}"
        elif len(places) > 1:
            subject = f"{noun}s {', '.join(map(str, places))}"
        else:
            subject = f"{noun} {places[0]} ({kinds.pop()})"
        yield f"{subject} {words.format(ratio)}"
    if len(groups) > MAX_GROUPS:
        yield f"and {sum(map(len, [*groups.values()][MAX_GROUPS:]))} other {noun}s by other factors"


def _of_clock(case: Case, rows: list[LawRow]) -> Iterator[str]:
    """Phrases on delays of samples and of velocities."""
    names = {
        law.EARLY_START: ("all samples are stamped", "early", "late"),
        law.LATE_SAMPLES: ("samples after the first are stamped", "late", "early"),
        law.LATE_VELOCITY: ("recorded velocities are", "late", "early"),
    }
    for row in (row for row in rows if row.quantity in names and row.differs):
        subject, ahead, behind = names[row.quantity]
        steps = abs(_steps_of(row))
        sizes = {0.5: "half a step", 1.0: "one step"}
        size = next((words for value, words in sizes.items() if abs(steps - value) < CLOSENESS), f"{steps:.3g} steps")
        delay_us = steps * case.scene.time_step_s * 1e6
        yield f"{subject} {size} ({delay_us:.3g} µs) {ahead if row.ratio > 1 else behind}"


def _of_start(case: Case, rows: list[LawRow]) -> Iterator[str]:
    """Phrases on speeds and overlaps at time 0, unless the samples have other times."""
    other = [row.quantity for row in rows if row.differs and row.quantity != law.START_SPEED]
    chain = case.chain
    least = SMALL_SPEED if other else 0.0
    for row in (row for row in rows if row.quantity == law.START_SPEED and row.differs and abs(row.ratio - 1) > least):
        name = "the striker" if case.scene.striker and row.place == chain.bodies else f"bead {row.place}"
        gained = chain.acceleration_m_s2[row.place - 1] * case.scene.time_step_s
        steps = (row.ratio - 1) * chain.velocity_m_s[row.place - 1] / (gained or inf)
        if abs(abs(steps) - 0.5) < CLOSENESS:
            yield f"{name} starts with its velocity half a step {'ahead' if steps > 0 else 'behind'}"
        else:
            yield f"{name} starts {f'with {_times(row)} of its speed' if abs(row.ratio) > SMALL_SPEED else 'at rest'}"
    pressed = [row for row in rows if row.quantity == law.START_OVERLAP and row.differs]
    if pressed and max(abs(row.ratio) for row in pressed) < 1e-6:
        gaps = any(chain.overlap_m[row.place - 1] < 0 for row in pressed)
        yield "bodies start without their gaps" if gaps else "bodies start just touching, not in equilibrium"
    else:
        yield from _grouped(rows, law.START_OVERLAP, "contact", "with {} times its overlap at the start", _pairs(case))


def _of_contacts(case: Case, engine: str, rows: list[LawRow]) -> Iterator[str]:
    """Phrases on stiffness and damping of contacts."""
    chain, labels = case.chain, _pairs(case)
    stiff = [*_grouped(rows, law.STIFFNESS, "contact", "{} times as stiff", labels)]
    yield from stiff[:-1]
    if stiff:
        yield stiff[-1] + _as_with(case, engine, [row for row in rows if row.quantity == law.STIFFNESS])
    if chain.damped:
        yield from _grouped(rows, law.DAMPING, "contact", "with {} times the dissipation", labels)
    else:
        ratios = [row.ratio - 1 for row in rows if row.quantity == law.DAMPING and row.differs]
        if ratios:
            yield f"{len(ratios)} contacts have a damping ratio of {np.median(ratios):.5g}, the scene has none"


def _of_bodies(case: Case, rows: list[LawRow]) -> Iterator[str]:
    """Phrases on masses, loads and resistance of bodies."""
    chain = case.chain
    heavy = {row.place: row.ratio for row in rows if row.quantity == law.MASS and row.differs}
    labels = ["bead"] * chain.beads + ["striker"] * (chain.bodies - chain.beads)
    for sensor in case.scene.chain.sensors:
        labels[sensor.from_wall - 1] = "sensor"
    noun = "bead" if all(place <= chain.beads for place in heavy) else "body"
    yield from _grouped(rows, law.MASS, noun, "has {} of its mass", labels)
    loads = [row for row in rows if row.quantity == law.LOAD]
    off = [abs(row.ratio - heavy.get(row.place, 1.0)) / row.uncertainty for row in loads]
    other = [row for row, share in zip(loads, off, strict=True) if row.differs and share > SIGNIFICANCE]
    if other and all(not replace(row, ratio=row.ratio + 1).differs for row in loads):
        yield "no gravity" if not chain.precompression_N else "no loads"
    elif len(other) == 1 and other[0].place == chain.beads and chain.precompression_N:
        force_N = -chain.load_N[chain.beads - 1] * other[0].ratio - chain.gravity_m_s2 * chain.mass_kg[chain.beads - 1]
        yield f"a precompression of {force_N:.3g} N in place of {chain.precompression_N:.3g} N"
    elif other:
        surest = max(other, key=lambda row: row.uncertainties_off)
        yield f"bodies carry other loads, body {surest.place} {_times(surest)} times its own"


def _pairs(case: Case) -> list[str]:
    """Materials of each contact, the lower one last: "ptfe with brass"."""
    below = [case.chain.wall or "no wall", *case.chain.materials[:-1]]
    return [f"{material} with {other}" for material, other in zip(case.chain.materials, below, strict=True)]


def _as_with(case: Case, engine: str, measured: list[LawRow]) -> str:
    """Clause on other materials that have the measured stiffnesses; empty if none has."""
    places = [row.place - 1 for row in measured]
    ratios = np.array([row.ratio for row in measured])
    for words, stiffness in _other_materials(case, engine):
        expected = stiffness[places] / case.chain.stiffness[places]
        if np.allclose(ratios, expected, rtol=1e-6, atol=0) and not np.allclose(expected, 1.0, rtol=1e-9, atol=0):
            return f", as with {words}"
    return ""


def _other_materials(case: Case, engine: str) -> Iterator[tuple[str, Array]]:
    """Contact stiffnesses with another wall, with other beads, and with constants that the code has by default."""
    chain, scene, defaults = case.chain, case.scene, load_engine(engine).defaults
    library = {name: validate(Material, table, name) for name, table in read_toml(paths.MATERIALS).items()}
    known = library | scene.materials
    used = list(dict.fromkeys([*chain.materials, *([chain.wall] if chain.wall in known else [])]))

    def with_materials(materials: Mapping[str, Material], wall: str | None = chain.wall) -> Array:
        under = scene.wall and scene.wall.model_copy(update={"material": wall})
        other = scene.model_copy(update={"materials": {**materials}, "wall": under})
        return stiffness_by(hertz_stiffness, other, list(chain.materials), chain.radius_m)

    for name in used:
        yield from ((f"{other} in place of {name}", with_materials(known | {name: known[other]})) for other in known)
    if chain.wall:
        yield from ((f"a wall of {other}", with_materials(known, other)) for other in (*known, RIGID))
    code, poisson, young = engine.upper(), defaults.poisson_ratio, defaults.youngs_modulus_Pa
    if chain.wall and defaults.wall_stiffness:
        factor = np.where(np.arange(chain.bodies) == 0, defaults.wall_stiffness, 1.0)
        yield f"{code}'s default law of a wall", factor * chain.stiffness
    if poisson is None or young is None:
        return
    ratio, modulus = f"Poisson's ratio of {poisson}", f"Young's modulus of {young / 1e9:g} GPa"
    both = {"poisson_ratio": poisson, "youngs_modulus": young}
    for words, keys in ((ratio, ["poisson_ratio"]), (modulus, ["youngs_modulus"]), (f"{modulus} and {ratio}", [*both])):
        for who, names in (("all materials", used), *((name, [name]) for name in used)):
            changed = {name: known[name].model_copy(update={key: both[key] for key in keys}) for name in names}
            yield f"{code}'s default {words} of {who}", with_materials(known | changed)


def _of_step(case: Case, engine: str, trace: Trace) -> str:
    """Sentence for a run with the scene's law: its error as a share of that of the scene's step."""
    motions = motions_of(case, engine)
    if motions.why_unknown:
        return SAME
    samples = min(len(motions.exact.time_s), len(trace.time_s))
    exact = motions.exact.force_N[:samples]
    off, expected = (motion.force_N[:samples] - exact for motion in (trace, motions.scheme_of(engine)))
    share = float((off * expected).sum() / ((expected**2).sum() or inf))
    left = float(np.abs(off - share * expected).max()) / (float(np.abs(off).max()) or inf)
    if not 0 < share < inf or left > 0.1 or abs(share - 1) < 1e-3:
        return SAME
    step_us = case.scene.time_step_s * 1e6
    other_us = step_us * share ** (1 / motions.order)
    return f"{SAME}; the error is {share:.3g} times the scheme's, as at a time step of {other_us:.3g} µs"
