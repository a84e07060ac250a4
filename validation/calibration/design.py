"""``beads design``: the experiment that tells laws apart, or pins a parameter down, among many candidates.

A candidate is the scene of a fit with other values of the varied keys, or sensor beads elsewhere. Its gauges have the
noise, gains, uncertainties and intervals of those of the fit. Their data are made up by each law that holds, at the
parameters found and without noise. Each other law is fitted to them, and its chi-square is the difference in chi-square
to expect. Candidates fill their ranges evenly (Halton's sequence).
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from math import isfinite, nan, sqrt
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
import tomlkit
from scipy.stats import qmc

from drivers.base.errors import InputError
from drivers.base.terminal import following, text_table
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.run.execute import Place, execute
from drivers.scene.read_scene import apply_settings
from drivers.scene.settings import look_up, setting_texts, unit_of
from postproc.draw.plot import COLUMN_IN, GREY, pyplot
from postproc.read.alignment import Channel, averaged, change_at
from postproc.read.measured import MEASURED
from postproc.read.motion import Simulation, exact, read
from validation.calibration.command import Fitted, by_key, read_fits
from validation.calibration.fit import CLOSE_CHANGE, DECISIVE, Fit, minimise, rounded, weights_of
from validation.calibration.parameters import CUT, GAIN, TRIGGER, Free, stated
from validation.calibration.predict import CARRIED
from validation.calibration.problem import DEFAULT_CUT, LONGER, TOLERANCE, DataSet, Datum, Problem, changed, checked

CANDIDATES = 100
MAX_LONGER = 4  # doublings of a run until the wave has passed all gauges
PANEL_IN, HEAD_IN = 1.5, 0.7
SHOWN = 10  # printed experiments
SENSORS = "chain.sensors"
LEAST_DIFFERENCE = "smallest expected difference in chi-square of two laws"


@dataclass(frozen=True)
class Design:
    """Compared experiments.

    Attributes:
        table: A row for each candidate, the scene of the fit first: varied values in SI units, ``gauges``, the
            duration of the run, and ``expected``; then by pair of laws the expected chi-square, or by law the error of
            the parameter. NaN for a scene that is impossible.
        best: Row of the best candidate.
        scene: Text of its scene file.
        goal: What ``expected`` is.
    """

    table: pd.DataFrame
    best: int
    scene: str
    goal: str

    @property
    def keys(self) -> list[str]:
        """Varied keys."""
        return [*self.table.columns[: list(self.table.columns).index("gauges")]]


def design(
    fit: Fitted | str | Path,
    vary: Sequence[str] = (),
    gauges: str = "",
    pin: str = "",
    candidates: int = CANDIDATES,
    settings: Mapping[str, Any] | Sequence[str] = (),
) -> Design:
    """Compare experiments as ``beads design`` does.

    Args:
        fit: What ``fit`` returned, or its folder.
        vary: Varied keys, as ``striker.speed=0.05..2``.
        gauges: Beads between which the sensor beads are placed, as ``2..15``.
        pin: Parameter whose error is to be small; without it laws are to be told apart.
        candidates: Number of experiments.
        settings: As those of ``fit``, applied to all of them.

    Raises:
        InputError: The folder is not that of a fit, a key has no range, or there is nothing to decide.

    Examples:
        >>> import validation
        >>> found = validation.fit("example-measured", free=["contact.restitution"], quick=True, results=folder)
        >>> compared = design(found, ["striker.speed=0.5..4"], pin="contact.restitution", candidates=2)
        >>> compared.table["expected"].idxmin() == compared.best
        True
    """
    fitted = fit if isinstance(fit, Fitted) else read_fits(Path(fit))
    holding = {law: fitted.fits[law] for law in weights_of(fitted.fits)}
    fits = {law: fit for law, fit in holding.items() if pin in ("", *fit.values)}
    if not fits:
        known = dict.fromkeys(chain.from_iterable(fit.values for fit in holding.values()))
        raise InputError("design", "--pin", pin, ", ".join(known))
    if not pin and len(fits) < 2:
        raise InputError("design", "", f"one law that holds: {next(iter(fits))}", "--pin KEY, or a fit of further laws")
    first = next(iter(fits.values()))
    changes = [{}, *_candidates(first, vary, gauges, candidates)]  # first as measured
    keys = [key for key in changes[-1] if key != SENSORS]
    work = execute(partial(_row, fits, pin, keys, setting_texts(settings)), changes, Place(processes=True))
    rows = {id(change): row for change, row in following(work, "experiments", len(changes), "experiment")}
    table = pd.DataFrame([rows[id(change)] for change in changes])
    if table["expected"][1:].isna().all():
        raise InputError("design", "", f"no experiment can be computed: {table['problem'].iloc[-1]}")
    best = int(np.nanargmin(table["expected"]) if pin else np.nanargmax(table["expected"]))
    unit = next((free.unit for free in first.problem.free if free.label == pin), "")
    goal = f"standard error of {pin}{f' ({unit})' * bool(unit)}" if pin else LEAST_DIFFERENCE
    document: Any = tomlkit.parse(fitted.scenes(next(iter(fits)))[0].read_text(encoding="utf-8"))
    document.pop(MEASURED, None)
    if drive := look_up(document, "drive.file"):
        document["drive"]["file"] = str((fitted.folder / drive).resolve())
    document["title"] = f"Designed from {fitted.folder.name}: {goal} {table['expected'][best]:.3g}"
    chosen = changes[best] | {"run.duration": float(table["duration_s"][best])}
    apply_settings(document, [*(setting_texts(settings) if best else ()), *setting_texts(chosen)])
    return Design(table, best, tomlkit.dumps(document), goal)


def _candidates(fit: Fit, vary: Sequence[str], gauges: str, count: int) -> Iterator[dict[str, Any]]:
    """Changes of the scene: values by key, and the sensor beads, with their masses, between those of ``gauges``."""
    if not (vary or gauges):
        raise InputError("design", "", "nothing to vary", "--vary KEY=LOW..HIGH or --gauges LOW..HIGH")
    if count < 1:
        raise InputError("design", "--candidates", f"{count}", "1 or more")
    scene, axes = fit.problem.sets[0].scene, list[tuple[Free, bool]]()
    known = [free.key for free in fit.problem.free if free.key.startswith(CARRIED)]
    for key, text in by_key(vary, "--vary", "design").items():
        value = look_up(scene, key)
        if not isinstance(value, (int, float)) or isinstance(value, bool) or key in known:
            raise InputError("design", "--vary", key, "a key of the scene with a number that the fit has not found")
        axes.append((stated(text, Free(key, unit_of(key)), "design", "--vary"), isinstance(value, int)))
    sensors = [sensor for _, sensor in sorted(scene.chain.sensor_at.items(), reverse=True) if gauges]
    masses = [sensor.model_dump(include={"mass"}, exclude_none=True) for sensor in sensors]
    ends = stated(f"beads={gauges or '1..2'}", Free("beads", ""), "design", "--gauges")
    for draw in qmc.Halton(len(axes) + len(masses), scramble=False).random(count + 1)[1:]:  # the first one is a corner
        change: dict[str, Any] = {}
        for x, (axis, whole) in zip(draw.tolist(), axes, strict=False):
            change[axis.key] = round(axis.value(x)) if whole else float(f"{axis.value(x):.3g}")
        if gauges:
            low, most = round(ends.low), change.get("chain.count", scene.chain.count)
            free = [*range(low, max(low, min(round(ends.high), most)) + 1)]
            beads = sorted((free.pop(int(x * len(free))) for x in draw[len(axes) :] if free), reverse=True)
            change[SENSORS] = [{"from_wall": bead} | mass for bead, mass in zip(beads, masses, strict=False)]
        yield change


def _row(
    fits: Mapping[str, Fit], pin: str, keys: Sequence[str], settings: Sequence[str], change: Mapping[str, Any]
) -> dict[str, Any]:
    """Row of a candidate."""
    row = {key: change.get(key, nan) for key in keys}
    row |= {"gauges": "", "duration_s": nan, "expected": nan, "problem": ""}
    texts = (*settings, *setting_texts(change)) if change else None  # as measured
    try:
        made = {law: _made_up(fit, texts) for law, fit in fits.items()}
    except (InputError, ArithmeticError) as error:
        return row | {"problem": str(error)}
    numbers, (first, *_) = dict[str, float](), made.values()
    scene = checked(first.source, first.settings).scene if texts is None else first.scene
    row |= {key: look_up(scene, key) for key in keys}
    row |= {"gauges": " ".join(channel.gauge for channel in first.channels), "duration_s": scene.run.duration}
    for law, data in made.items() if pin else ():
        problem, place = _problem_of(fits[law], data)
        labels = [free.label for free in problem.free]
        if pin not in labels:
            return row | {"problem": f"{pin} does not take part"}
        numbers[f"error_{law}"] = float(Fit(problem, place).errors[labels.index(pin)])
    for law, other in () if pin else combinations(fits, 2):  # made up by the other one, data differ by as much
        problem, place = _problem_of(fits[other], replace(made[law], tables=made[other].tables))
        end = minimise(problem, problem.with_triggers(place), converged=CLOSE_CHANGE)
        numbers[f"{law}_or_{other}"] = problem.chi_square(end)
    return row | {"expected": max(numbers.values()) if pin else min(numbers.values())} | numbers


def _problem_of(fit: Fit, data: DataSet) -> tuple[Problem, Array]:
    """Problem of the parameters of a fit for data of a candidate, and the coordinates at which they were made up.

    Geometry and strikes have the value of the candidate, with the relative error that they had.
    """
    free, place = list[Free](), list[float]()
    gauges = {f"{channel.trace.key}.{GAIN}" for channel in data.channels}
    gauges |= {f"{channel.file_key}.{TRIGGER}" for channel in data.channels}
    readings = {CUT, *(number.divisor for number in data.numbers)}
    for each, x in zip(fit.problem.free, fit.place, strict=True):
        if each.belongs_to(data.name) and (each.of_motion or each.key in gauges | readings):
            carried, moved = each.key.startswith(CARRIED), each
            if each.of_motion and not carried:
                value = look_up(data.scene, each.key)
                ratio = value / each.start if each.start else 1.0
                low, high = sorted((ratio * each.low, ratio * each.high))
                moved = replace(each, start=value, low=low, high=high, prior=abs(ratio) * each.prior)
            free.append(moved)
            place.append(float(x) if carried else moved.coordinate(moved.start))
    return Problem((data,), tuple(free)), np.array(place)


def _made_up(fit: Fit, settings: Sequence[str] | None) -> DataSet:
    """Data of a candidate by a law, without noise; its run is prolonged until the wave has passed all gauges.

    Args:
        fit: Fit of the law.
        settings: Settings of the candidate; None for the scene of the fit, with records as long as they were.

    Raises:
        InputError: The scene is impossible, or the wave does not reach a gauge.
        ArithmeticError: The motion cannot be computed.
    """
    base = fit.problem.sets[0]
    found, _ = fit.problem.own_values(base, fit.place)
    if settings is None:
        data = replace(base, tables=json.dumps(changed(base.tables, found)))
        motion, channels = exact(build_case(data.scene), TOLERANCE), list[Channel]()
        for each in base.channels:
            reading = each.computed(motion.curves[each.gauge], each.trigger_s) / each.trace.gain
            channels.append(replace(each, reading=reading + (each.trace.baseline or 0.0)))
        return _data_of(data, motion, channels)
    tables = changed(base.tables, [pair for pair in found if pair[0].startswith(CARRIED)])
    if any(free.is_trigger and free.own == base.name for free in fit.problem.free):
        tables["run"]["duration"] = f"{base.scene.run.duration / LONGER!r} s"
    apply_settings(tables, settings)
    for _ in range(MAX_LONGER + 1):
        data = replace(base, tables=json.dumps(tables))
        motion = exact(build_case(data.scene), TOLERANCE)
        if all(isfinite(motion.first.get(f"{gauge}_arrival_s", nan)) for gauge in motion.signals):
            return _data_of(data, motion, _channels(data, motion))
        tables["run"]["duration"] = f"{2 * motion.case.scene.run.duration!r} s"
    raise InputError("design", "run.duration", f"no pulse at a gauge in {tables['run']['duration']}", "a longer run")


def _data_of(base: DataSet, motion: Simulation, channels: Sequence[Channel]) -> DataSet:
    """Data of a fit as a motion would give them, without noise, with these channels.

    Raises:
        InputError: The motion has none of the gauges or numbers of the data.
    """
    numbers = list[Datum]()
    for number in base.numbers:
        with suppress(InputError):
            value = read(motion, number.name, base.fixed.get(CUT, DEFAULT_CUT))
            if isfinite(value):
                numbers.append(replace(number, value=value, error=abs(value * number.error / number.value)))
    if not (channels or numbers):
        raise InputError("design", "", "none of the measured gauges and numbers in the scene", "--set chain.sensors")
    return replace(base, numbers=tuple(numbers), channels=tuple(channels))


def _channels(base: DataSet, motion: Simulation) -> list[Channel]:
    """Channels of the gauges of a motion, which have gain, noise and interval of those of the fit, in turn."""
    channels, interval_s = list[Channel](), base.scene.run.sample_interval
    for gauge, curve in motion.curves.items():
        alike = [each for each in base.channels if each.gauge.partition("_")[0] == gauge.partition("_")[0]]
        if not alike:
            continue
        place = min(sum(each.gauge.partition("_")[0] == gauge.partition("_")[0] for each in channels), len(alike) - 1)
        first = next((each for each in alike if each.gauge == gauge), alike[place])
        trace, noise = first.trace, float(np.sqrt(np.mean([each.noise**2 for each in alike])))
        trigger_s, step_s = first.trigger_s, float(np.median(np.diff(trace.time_s)))
        time_s = np.arange(float(trace.time_s[0]), trigger_s + float(motion.trace.time_s[-1]), step_s)
        reading = change_at(curve, time_s - trigger_s) / trace.gain + (trace.baseline or 0.0)
        coarse = averaged(replace(trace, time_s=time_s, reading={gauge: reading}), interval_s)
        made_up = replace(first, gauge=gauge, noise=noise, time_s=coarse.time_s, reading=coarse.reading[gauge])
        channels.append(replace(made_up, counts=np.ones(len(coarse.time_s), dtype=bool)))
    return channels


def draw(found: Design) -> Any:
    """Expected number of each candidate against each varied value, and against the beads of the gauges."""
    beads = "bead with a gauge, from the wall"
    table = found.table.assign(**{beads: found.table["gauges"].str.findall(r"\d+")}).explode(beads)
    size = (COLUMN_IN, HEAD_IN + PANEL_IN * (len(found.keys) + 1))
    figure, axes = pyplot().subplots(len(found.keys) + 1, 1, figsize=size, squeeze=False, layout="constrained")
    for axis, key in zip(axes[:, 0], (*found.keys, beads), strict=True):
        for rows, colour, size_pt in ((table, GREY, 3), (table.loc[[found.best]], "k", 7)):
            axis.semilogy(rows[key].astype(float), rows["expected"], "o", color=colour, ms=size_pt)
        axis.set_xlabel(key if key == beads else f"{key} ({unit_of(key) or 'number'})")
    figure.supylabel(fill(found.goal, 40), fontsize=8)
    return figure


def lines(found: Design) -> list[str]:
    """The best candidates, and last the experiment as it was."""
    table, pinned = found.table.dropna(subset="expected"), found.goal != LEAST_DIFFERENCE
    rows = [["experiment", *found.keys, "gauges", found.goal]]
    best = table.drop(index=0, errors="ignore").sort_values("expected", ascending=pinned).head(SHOWN)
    for index, row in pd.concat([best, table[table.index == 0]]).iterrows():
        values = [rounded(row[key], unit_of(key)) for key in found.keys]
        scatter = "" if pinned else f" ± {2 * sqrt(row['expected']):.2g}"
        rows.append([f"{index}" if index else "as measured", *values, row["gauges"], f"{row['expected']:.3g}{scatter}"])
    left = found.table[found.table["expected"].isna()]
    said = [f"{len(left)} left out: {problem}" for problem in left["problem"].head(1)]
    if found.goal == LEAST_DIFFERENCE and not (table["expected"] >= DECISIVE).any():
        said.append(f"no experiment is expected to decide, for which {DECISIVE:g} are needed")
    return [*text_table(rows), *said]
