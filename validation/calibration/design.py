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
from itertools import combinations
from math import isfinite, nan
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
import tomlkit
from scipy.stats import qmc

from drivers.base.errors import InputError, RunError
from drivers.base.terminal import following, text_table
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.run.execute import Place, execute
from drivers.scene.read_scene import apply_setting, make_scene, set_value
from drivers.scene.settings import look_up, unit_of
from postproc.draw.style import COLUMN_IN, GREY, pyplot
from postproc.read.alignment import change_at, channels_of
from postproc.read.measured import MEASURED, MeasuredTrace
from postproc.read.motion import Simulation, exact, read
from postproc.read.signals import gauges_of
from validation.calibration.data import DataSet
from validation.calibration.fit import LOOKS, ROUGH_CHANGE, Fit, chi_square_at, minimise, rounded, weights_of
from validation.calibration.folder import Fitted, option_of, read_fits
from validation.calibration.parameters import CUT, READING, stated
from validation.calibration.predict import CARRIED
from validation.calibration.problem import DEFAULT_CUT, TOLERANCE, Problem, pose

CANDIDATES = 100
MAX_LONGER = 4  # doublings of a run until the wave has passed all gauges
PANEL_IN, HEAD_IN = 1.5, 0.7
SHOWN = 10  # printed experiments


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


def design(
    fit: Fitted | str | Path,
    vary: Sequence[str] = (),
    gauges: str = "",
    pin: str = "",
    candidates: int = CANDIDATES,
    settings: Sequence[str] = (),
) -> Design:
    """Compare experiments as ``beads design`` does.

    Args:
        fit: What ``fit`` returned, or its folder.
        vary: Varied keys, as ``striker.speed=0.05..2``.
        gauges: Beads between which the sensor beads are placed, as ``2..15``.
        pin: Parameter whose error is to be small; without it laws are to be told apart.
        candidates: Number of experiments.
        settings: Settings applied to all of them.

    Raises:
        InputError: The folder is not that of a fit, a key has no range, or there is nothing to decide.
    """
    fitted = fit if isinstance(fit, Fitted) else read_fits(Path(fit))
    fits = {law: fitted.fits[law] for law in weights_of(fitted.fits)}
    if not pin and len(fits) < 2:
        raise InputError("design", "", f"one law that holds: {next(iter(fits))}", "--pin KEY, or a fit of further laws")
    for one in fits.values():
        if pin and pin not in one.values:
            raise InputError("design", "--pin", pin, ", ".join(one.values))
    base = next(iter(fits.values())).problem.sets[0]
    changes = [*_candidates(base, vary, gauges, candidates)]
    changes.insert(0, {key: look_up(base.scene, key) for key in changes[0] if key != "gauges"})  # as measured
    work = execute(partial(_row, fits, pin, settings), changes, Place(processes=True))
    rows = {id(change): row for change, row in following(work, "experiments", len(changes), "experiment")}
    table = pd.DataFrame([rows[id(change)] for change in changes])
    if table["expected"].isna().all():
        raise RunError(f"design: no experiment can be computed: {table['problem'].iloc[0]}")
    best = int(np.nanargmin(table["expected"]) if pin else np.nanargmax(table["expected"]))
    goal = f"standard error of {pin}" if pin else "smallest expected difference in chi-square of two laws"
    text = _scene_text(fitted.scenes(next(iter(fits)))[0], changes[best], settings, base, table.iloc[best])
    return Design(table, best, text, goal)


def _candidates(base: DataSet, vary: Sequence[str], gauges: str, count: int) -> Iterator[dict[str, Any]]:
    """Changes of the scene: values by key, and the beads of ``gauges`` from the top."""
    if not (vary or gauges):
        raise InputError("design", "", "nothing to vary", "--vary KEY=LOW..HIGH or --gauges LOW..HIGH")
    scene, axes = base.scene, list[tuple[Any, bool]]()
    for text in vary:
        key = text.partition("=")[0].strip()
        value = look_up(scene, key)
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise InputError("design", "--vary", key, f"a number of {base.where}")
        axes.append((stated(text, unit_of(key), "design", None, None, option="--vary"), isinstance(value, int)))
    places = len(scene.chain.sensor_at) if gauges else 0
    ends = stated(f"beads={gauges or '1..2'}", "", "design", None, None, option="--gauges")
    for draw in qmc.Halton(len(axes) + places, scramble=False).random(count + 1)[1:]:  # the first one is a corner
        values = [axis.value(float(x)) for (axis, _), x in zip(axes, draw, strict=False)]
        change = {axis.key: round(value) if whole else value for value, (axis, whole) in zip(values, axes, strict=True)}
        if gauges:
            low, high = round(ends.low), min(round(ends.high), change.get("chain.count", scene.chain.count))
            free = [*range(low, high + 1)]
            beads = [free.pop(int(x * len(free))) for x in draw[len(axes) :] if free]
            change["gauges"] = sorted(beads, reverse=True)
        yield change


def _row(fits: Mapping[str, Fit], pin: str, settings: Sequence[str], change: Mapping[str, Any]) -> dict[str, Any]:
    """Row of a candidate."""
    row = {**change, "gauges": "", "duration_s": nan, "expected": nan, "problem": ""}
    try:
        scenes = {law: _scene_of(fit, change, settings) for law, fit in fits.items()}
        motions = {law: _motion_of(scenes[law]) for law in fits}
        longest = max(float(motion.trace.time_s[-1]) for motion in motions.values())
    except (InputError, ArithmeticError) as error:
        return row | {"problem": str(error)}
    first = next(iter(motions.values()))
    row |= {"gauges": " ".join(gauges_of(first.case.layout)), "duration_s": longest}
    numbers = dict[str, float]()
    for law, motion in motions.items() if pin else ():
        problem = _problem_of(fits[law], scenes[law], _data_of(fits[law].problem.sets[0], motion))
        numbers[f"error_{law}"] = _error_of(Fit(problem, problem.start), pin)
    for law, other in () if pin else combinations(fits, 2):  # made up by the other one, data differ by as much
        data = _data_of(fits[law].problem.sets[0], motions[law])
        problem = _problem_of(fits[other], scenes[other], data)
        place = minimise(problem, problem.with_triggers(problem.start), converged=ROUGH_CHANGE)
        numbers[f"{law}_or_{other}"] = chi_square_at(problem, place)
    return row | {"expected": max(numbers.values()) if pin else min(numbers.values())} | numbers


def _error_of(fit: Fit, key: str) -> float:
    """Standard error of a parameter."""
    return float(fit.errors[[free.key for free in fit.problem.free].index(key)])


def _scene_of(fit: Fit, change: Mapping[str, Any], settings: Sequence[str]) -> dict[str, Any]:
    """Tables of a candidate at the fitted parameters of materials, contacts and electronics."""
    base = fit.problem.sets[0]
    tables: dict[str, Any] = json.loads(base.tables)
    tables["run"]["duration"] = base.duration or tables["run"]["duration"]
    for setting in settings:
        apply_setting(tables, setting)
    found = {free.key: free.value(float(x)) for free, x in zip(fit.problem.free, fit.place, strict=True)}
    values = {key: value for key, value in found.items() if key.partition(".")[0] in CARRIED} | {**change}
    beads = values.pop("gauges", ())
    for key, value in values.items():
        set_value(tables, key, f"{value!r} {unit_of(key)}" if unit_of(key) else value, "--vary")
    if beads:
        tables["chain"]["sensors"] = [*_sensors(base, beads)]
    return tables


def _sensors(base: DataSet, beads: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Sensor beads of a scene at other places, from the top."""
    masses = [sensor.mass for _, sensor in sorted(base.scene.chain.sensor_at.items(), reverse=True)]
    for bead, mass in zip(beads, masses, strict=False):
        yield {"from_wall": bead} | ({} if mass is None else {"mass": f"{mass!r} kg"})


def _motion_of(tables: dict[str, Any]) -> Simulation:
    """Motion of a candidate, whose run is prolonged until the wave has passed all gauges.

    Raises:
        InputError: The scene is impossible, or the wave does not reach a gauge.
        ArithmeticError: The motion cannot be computed.
    """
    for _ in range(MAX_LONGER + 1):
        scene = make_scene(json.loads(json.dumps(tables)), "design", "design")
        motion = exact(build_case(scene), TOLERANCE)
        if all(isfinite(motion.first.get(f"{gauge}_arrival_s", nan)) for gauge in motion.signals):
            return motion
        tables["run"]["duration"] = f"{2 * scene.run.duration!r} s"
    raise InputError("design", "run.duration", f"no pulse at a gauge within {scene.run.duration:g} s", "a longer run")


def _data_of(base: DataSet, motion: Simulation) -> DataSet:
    """Data of a fit as a motion would give them, without noise; gauges of beads have the noise of those of the fit.

    Raises:
        InputError: The motion has none of the gauges or numbers of the data.
    """
    traces, noises, triggers = dict[str, MeasuredTrace](), dict[str, float](), dict[str, float]()
    for gauge in motion.signals:
        alike = [each for each in base.channels if each.gauge.partition("_")[0] == gauge.partition("_")[0]]
        if not alike:
            continue
        key, file_key, trace = alike[0].key, alike[0].file_key, alike[0].trace
        trigger_s, step_s = base.triggers[file_key], float(np.median(np.diff(trace.time_s)))
        time_s = np.arange(float(trace.time_s[0]), trigger_s + float(motion.trace.time_s[-1]), step_s)
        reading = change_at(motion.curves[gauge], time_s - trigger_s) / trace.gain + (trace.baseline or 0.0)
        former = traces[key].reading if key in traces else {}
        traces[key] = replace(trace, time_s=time_s, reading={**former, gauge: reading}, noise=1.0)
        noises[gauge], triggers[file_key] = float(np.sqrt(np.mean([each.noise**2 for each in alike]))), trigger_s
    files = channels_of(traces, float(motion.trace.time_s[-1]), base.step_s)
    channels = tuple(replace(each, noise=noises[each.gauge]) for file in files for each in file)
    numbers = []
    for number in base.numbers:
        with suppress(InputError):
            value = read(motion, number.name, base.fixed.get(CUT, DEFAULT_CUT))
            if isfinite(value):
                numbers.append(replace(number, value=value, error=abs(value * number.error / number.value)))
    if not (channels or numbers):
        raise InputError("design", "", "none of the measured gauges and numbers in the scene", "--set chain.sensors")
    return replace(base, name="design", numbers=tuple(numbers), channels=channels, triggers=triggers, duration="")


def _problem_of(fit: Fit, tables: Mapping[str, Any], data: DataSet) -> Problem:
    """Problem of the parameters of a fit for data of a candidate, which starts at the values found.

    Prior knowledge of geometry, strikes and gains has the same relative error as in the fit.
    """
    texts: dict[bool, list[str]] = {False: [], True: []}  # of all, and of one data set
    entries, first = {channel.key for channel in data.channels}, fit.problem.sets[0].name
    for free in fit.problem.free:
        gauge = free.key.startswith(MEASURED)
        if free.own not in ("", first) or free.key.startswith(READING):
            continue  # of another experiment, or added by the numbers
        if not gauge or free.key.rpartition(".")[0] in entries:
            known = option_of(free) if free.key.startswith(CARRIED) else free.key
            share = f"=±{100 * free.prior / abs(free.start)!r}%" if free.prior and known == free.key else ""
            texts[bool(free.own) and not gauge].append(known + share)
    return pose([replace(data, tables=json.dumps(tables), own=())], texts[False], texts[True])


def _scene_text(source: Path, change: Mapping[str, Any], settings: Sequence[str], base: DataSet, row: Any) -> str:
    """Scene file of a candidate: the fitted scene with its changes, without data."""
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    document.pop(MEASURED, None)
    for setting in (*settings, f"run.duration={row['duration_s']:.9g} s"):
        apply_setting(document, setting)
    for key, value in change.items():
        if key == "gauges":
            document["chain"]["sensors"] = [*_sensors(base, value)]
        else:
            set_value(document, key, quantity(value, unit_of(key)) if unit_of(key) else value, "--vary")
    return tomlkit.dumps(document)


def draw(found: Design) -> Any:
    """Expected number of each candidate against each varied value, and against the beads of the gauges."""
    table, at = found.table, found.table.iloc[found.best]
    keys = [*table.columns[: table.columns.get_loc("gauges")]]
    keys += ["gauges"] * (table["gauges"].nunique() > 1)
    figure, axes = pyplot().subplots(
        len(keys), 1, figsize=(COLUMN_IN, HEAD_IN + PANEL_IN * len(keys)), squeeze=False, layout="constrained"
    )
    for axis, key in zip(axes[:, 0], keys, strict=True):
        for row, look in ((table, {"color": GREY, "ms": 3}), (at.to_frame().T, {"color": LOOKS[1][0], "ms": 7})):
            beads = row["gauges"].str.findall(r"\d+") if key == "gauges" else row[key].map(lambda value: [value])
            points = row.assign(place=beads).explode("place")
            axis.plot(points["place"].astype(float), points["expected"].astype(float), "o", **look)
        axis.set(
            xlabel="beads with a gauge, from the wall" if key == "gauges" else f"{key} ({unit_of(key) or 'number'})"
        )
        axis.set_yscale("log")
    figure.supylabel(fill(found.goal, 50), fontsize=8)
    return figure


def lines(found: Design) -> list[str]:
    """The best candidates, and last the experiment as it was."""
    table = found.table.dropna(subset="expected").sort_values("expected", ascending="error" in found.goal)
    shown = pd.concat([table.drop(index=0, errors="ignore").head(SHOWN), table.loc[table.index == 0]])
    keys = [*table.columns[: table.columns.get_loc("gauges")]]
    rows = [["experiment", *keys, "gauges", found.goal]]
    for index, row in shown.iterrows():
        values = [rounded(row[key], unit_of(key)) for key in keys]
        rows.append([f"{index}" if index else "as measured", *values, row["gauges"], f"{row['expected']:.3g}"])
    failed = found.table["expected"].isna()
    reason = found.table.loc[failed, "problem"].min()
    return [*text_table(rows), *([f"{failed.sum()} experiments left out: {reason}"] if failed.any() else [])]
