"""Errors against cost: runs at time steps from the stability limit down to 1e-4 of it, and what softened beads gain."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from math import ceil, inf, nan
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import EngFormatter

from drivers.base.errors import RunError
from drivers.base.terminal import following
from drivers.chain.case import Case
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, codes, in_order, installed_codes
from drivers.limits import step_limit
from drivers.run.compute import compute
from drivers.run.execute import execute
from drivers.run.scheme import COMPARED
from postproc.draw.plot import PAGE_IN, line_of, marker_of, pyplot
from postproc.read.motion import case_of
from postproc.read.observables import of_kind
from validation.accuracy.costs import cost_on
from validation.accuracy.motions import ExactMotion, errors_of, exact_motion_of, quantities
from validation.chapters import Options
from validation.checks import NOT_RUN, short
from validation.reference.adaptive import MIN_TOLERANCE
from validation.report.parts import Chapter, Shown

SCENES = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain", "long-chain")
SHORT_SCENES = SCENES[:-1]  # without the thousand beads, which take half of the time
SHARES = tuple(10 ** (-k / 3) for k in range(13))  # of the predicted stability limit
TOLERANCES = (*(10.0**-k for k in range(2, 12)), MIN_TOLERANCE)
BUDGET_S, SHORT_BUDGET_S = 300.0, 30.0  # of engine time for the whole ladder
MAX_RUN_SHARE = 0.04  # of the budget, for a single run
REPEATS, SHORT_RUN_S = 3, 0.03  # shorter runs are timed as the best of several
CODE_STRIDE = 3  # codes take every third step of the short ladder
ADVISED_S = 1.05e-7  # steps up to 0.1 us are advised
FACTORS = (10, 100, 1000)  # by which the modulus of softened beads is divided
TARGETS = tuple(10.0**-k for k in range(2, 9))
SHOWN_TARGETS = TARGETS[::2]
STRAIGHT = 0.9e-3, 0.11  # shares of the stability limit between rounding and large errors, which show the order
QUANTITIES = {
    "force": "force trace",
    "sensor_peak": "sensor peak",
    "wall_peak": "wall peak",
    "arrival": "arrival times",
    "speed": "speed V_s",
    "width": "width",
    "energy": "energy",
    "momentum": "momentum",
}
DONE = "done"
Rung = dict[str, Any]  # one run of the ladder


def rungs_of(scene: str, code_shares: Sequence[float]) -> Iterator[Rung]:
    """Runs of a scene: in-repo schemes at all steps, codes at some, ``reference`` at all tolerances.

    Each is the beginning of its row, with its ``case``, the expected time of its loop, ``expected_s``, and ``samples``:
    runs with the same have the same exact motion.
    """

    def rung(method: str, case: Case, share: float) -> Rung:
        step_s = nan if method == REFERENCE else case.scene.time_step_s
        row = {"scene": scene, "method": method, "time_step_s": step_s, "share_of_limit": share}
        samples = scene, case.scene.run.sample_interval, case.scene.samples
        return row | {"case": case, "expected_s": cost_on(method).loop_s(case), "samples": samples}

    base = case_of(scene)
    stable_s, *_ = step_limit(base)
    for share in SHARES:
        case = at_step(base, share, stable_s)
        for method in (*(installed_codes() if share in code_shares else ()), VERLET):
            yield rung(method, case, share)
    for tolerance in TOLERANCES:
        yield rung(REFERENCE, replace(base, reference_tolerance=tolerance), tolerance)


def at_step(case: Case, share: float, stable_s: float) -> Case:
    """Case at about this share of the stability limit; with fewer samples if the step exceeds the interval."""
    step, interval = share * stable_s, case.scene.run.sample_interval
    return case.at(ceil(interval / step * (1 - 1e-12))) if step <= interval else case.sampled_at_every(step)


def affordable(rungs: list[Rung], budget_s: float) -> tuple[list[Rung], list[Rung]]:
    """Rungs within the budget, cheapest first, and the rest."""
    ordered = sorted(rungs, key=lambda rung: rung["expected_s"])
    expected_s = np.array([rung["expected_s"] for rung in ordered])
    kept = int(((expected_s <= MAX_RUN_SHARE * budget_s) & (np.cumsum(expected_s) <= budget_s)).sum())
    return ordered[:kept], ordered[kept:]


def run_ladder(budget_s: float, scenes: Sequence[str], *, short: bool = False) -> pd.DataFrame:
    """Run the ladder within a budget of engine time; in the short study the codes run at every third step.

    Runs are parallel: one engine runs while the errors of another run are measured.

    Returns:
        A row for each run. ``time_step_s`` is NaN for ``reference``; ``share_of_limit`` is the time step divided by the
        predicted stability limit, for ``reference`` its tolerance; ``loop_s`` is the CPU time of the time loop on one
        core, ``start_s`` the time of a process of the engine outside its loop; ``status`` is ``done``, ``failed``, or
        ``not run`` with the ``reason``. Errors by quantity, as in ``accuracy.motions``, are NaN if the scene does not
        show it.
    """
    shares = SHARES[::CODE_STRIDE] if short else SHARES
    kept, left = affordable([rung for scene in scenes for rung in rungs_of(scene, shares)], budget_s)
    start_s = dict(execute(partial(start_up, case_of(scenes[0])), {rung["method"]: None for rung in kept}))
    sampled = {rung["samples"]: rung["case"] for rung in kept}
    exact = dict(execute(lambda samples: exact_motion_of(sampled[samples]), sampled))
    longest_first = execute(partial(row_of, start_s=start_s, exact=exact), reversed(kept))
    rows = [row for _, row in following(longest_first, "runs at all steps", len(kept))]
    methods = [*installed_codes(), VERLET, REFERENCE]
    rows.sort(key=lambda row: (row["expected_s"], -row["share_of_limit"]))
    rows.sort(key=lambda row: (scenes.index(row["scene"]), methods.index(row["method"])))
    rows += [rung | {"status": NOT_RUN, "reason": f"its loop would take {rung['expected_s']:.0f} s"} for rung in left]
    measured = ("time_step_s", "share_of_limit", "loop_s", "start_s", *QUANTITIES)
    return pd.DataFrame(rows, columns=["scene", "method", *measured, "status", "reason"])


def row_of(rung: Rung, start_s: Mapping[str, float], exact: Mapping[Any, ExactMotion]) -> dict[str, Any]:
    """Row of a run, the shortest of several if it is short; of a failed one with the reason."""
    try:
        repeats = REPEATS if rung["expected_s"] < SHORT_RUN_S else 1
        runs = [compute(rung["case"], rung["method"]) for _ in range(repeats)]
        errors = errors_by_group(rung["case"], [run.done for run in runs][-1], exact[rung["samples"]])
        times = {"loop_s": min(run.loop_s or 0.0 for run in runs), "start_s": start_s[rung["method"]]}
        return rung | times | errors | {"status": DONE, "reason": ""}
    except RunError as error:
        return rung | {"status": error.status, "reason": str(error)}


def errors_by_group(case: Case, trace: Trace, exact_motion: ExactMotion) -> dict[str, float]:
    """Errors of a row; of several gauges the largest."""
    groups = {
        "sensor_peak": [name for name in of_kind(exact_motion.true, "peak") if name != "wall_peak"],
        "wall_peak": [name for name in exact_motion.true if name == "wall_peak"],
        "arrival": of_kind(exact_motion.true, "arrival"),
        "speed": of_kind(exact_motion.true, "speed"),
        "width": [name for name in of_kind(exact_motion.true, "width") if name.endswith("_4pct")],
    }
    measured = errors_of(case, trace, exact_motion, (*COMPARED, *chain(*groups.values())))
    errors = {name: measured[name] for name in COMPARED}
    return errors | {group: max((measured[name] for name in names), default=nan) for group, names in groups.items()}


def start_up(case: Case, name: str) -> float:
    """Time of a process outside its loop, in s: the shorter of two, as the first may compile or load."""
    runs = [compute(case, name, own_process=True) for _ in range(2)]
    return min(run.wall_s - (run.loop_s or 0.0) for run in runs)


def soften() -> pd.DataFrame:
    """Errors of V_s and F_m with softened beads, scaled back by E^(2/5), and what softening gains.

    Without gravity, with a rigid wall and one material, the chain is similar: at a given striker speed times are
    proportional to E^(-2/5), forces to E^(2/5).

    Returns:
        A row for each factor and quantity, with and without gravity. ``error`` is that of the scaled quantity,
        ``limit`` the stable time step and ``steps`` the number of stable steps until the wave reaches the wall, both
        divided by those of the hard beads.
    """
    rows = []
    for gravity, words in (("", "without gravity"), ("9.81 m/s^2", "with gravity")):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard, hard_limit_s = _softened(1, base)
        for factor in FACTORS:
            soft, limit_s = _softened(factor, base)
            gain = limit_s / hard_limit_s
            steps = soft["wall_arrival"] / hard["wall_arrival"] / gain
            for name in ("speed_9_to_5", "bead_5_amplitude", "wall_amplitude"):
                error = abs(soft[name] * factor**0.4 / hard[name] - 1)
                rows.append((f"E/{factor}, {words}", name, error, gain, steps))
    return pd.DataFrame(rows, columns=["setting", "quantity", "error", "limit", "steps"])


def _softened(factor: float, base: Sequence[str]) -> tuple[dict[str, float], float]:
    """Exact quantities of Fig. 4 with a modulus divided by a factor, and its stability limit in s."""
    longer = factor**0.4
    timing = (f"run.duration={0.8 * longer} ms", f"run.sample_interval={longer} us", f"run.time_step={longer / 10} us")
    case = case_of("fig4", *base, f"materials.ptfe.youngs_modulus={1.46e9 / factor} Pa", *timing)
    return quantities(case, exact_of(case, 1e-11)), step_limit(case)[0]


def done(rows: pd.DataFrame) -> pd.DataFrame:
    """Finished runs, from the smallest to the largest step."""
    return rows[rows["status"] == DONE].sort_values("share_of_limit")


def orders(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Smallest and largest order of convergence of the force over the scenes, by method at a fixed step."""
    fixed = done(rows).dropna(subset=["time_step_s"])
    straight = fixed[fixed["share_of_limit"].between(*STRAIGHT)]
    by_method: dict[str, list[float]] = defaultdict(list)
    for (method, _), part in straight.groupby(["method", "scene"], sort=False):
        if len(part) > 1:
            by_method[str(method)].append(float(np.polyfit(np.log(part["time_step_s"]), np.log(part["force"]), 1)[0]))
    return {method: (min(slopes), max(slopes)) for method, slopes in by_method.items()}


def advice(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest step by scene, method and quantity that keeps an error, as all smaller measured steps do.

    Returns:
        A row for each run, with the ``error`` of the quantity and that of the force; no row if no step keeps it.
    """
    advised = []
    for (scene, method), ladder in done(rows).groupby(["scene", "method"], sort=False):
        for quantity in QUANTITIES:
            largest = ladder[quantity].fillna(inf).cummax().to_numpy()  # so that no error is small by chance
            runs = ladder[["time_step_s", "loop_s", quantity, "force"]].to_numpy()
            for target, good in zip(TARGETS, np.searchsorted(largest, TARGETS, side="right"), strict=True):
                if good:
                    advised.append((scene, quantity, target, method, *runs[good - 1]))
    columns = ["scene", "quantity", "error_at_most", "method", "time_step_s", "loop_s", "error", "error_of_force"]
    return pd.DataFrame(advised, columns=columns)


def measure(options: Options) -> Chapter:
    """Run the ladder and soften beads; derive advice."""
    budget_s, scenes = (SHORT_BUDGET_S, SHORT_SCENES) if options.quick else (BUDGET_S, SCENES)
    rows = run_ladder(options.budget_s or budget_s, scenes, short=options.quick)
    advised, softened = advice(rows), soften()
    caption = "Largest error of the force against the time of the loop, by scene"
    return Chapter(
        {"trade": rows, "trade-advice": advised, "trade-softening": softened},
        findings(rows),
        {"trade": (caption, draw_trade(rows))},
        [show_advice(rows, advised), show_softening(softened)],
        short=not set(SCENES) <= set(rows["scene"]),
    )


def findings(rows: pd.DataFrame) -> list[str]:
    """Advice for these sizes, and orders of convergence of the force."""
    finished = done(rows)
    fine = finished[finished["time_step_s"] <= ADVISED_S].groupby(["scene", "method"], sort=False).tail(1)
    starts_s = finished["start_s"]
    ranges = ", ".join(f"{low:.2f} to {high:.2f} by {name}" for name, (low, high) in orders(rows).items())
    return [
        f"At these sizes take a time step of 0.1 µs: accuracy is free, with an error of the force of"
        f" {short(fine['force'].max())} or less; a time loop takes {_time(fine['loop_s'].min())} to"
        f" {_time(fine['loop_s'].max())}, the start of a process {_time(starts_s.min())} to {_time(starts_s.max())}.",
        f"Orders of convergence of the force: {ranges}.",
    ]


def draw_trade(rows: pd.DataFrame) -> Any:
    """Draws the error of the force against the time of the loop: the first scene large, the others small."""
    first, *others = rows["scene"].unique()
    columns = [others[place : place + 2] for place in range(0, len(others), 2)]
    places = [[first, first, *(column[row % len(column)] for column in columns)] for row in range(2)]
    figure = pyplot().figure(figsize=(PAGE_IN, 3.9), layout="constrained")
    axes = figure.subplot_mosaic(places)
    shown = done(rows[rows["force"] > 0])
    for scene, axis in axes.items():
        of_scene = shown[shown["scene"] == scene]
        for method in in_order(of_scene["method"]):
            points = of_scene[of_scene["method"] == method]
            look = line_of(method) | {"marker": marker_of(method)["marker"]}
            axis.plot(points["loop_s"], points["force"], label=method, **look | {"ms": 3.5})
        axis.set(xscale="log", yscale="log")
        axis.set_title(scene, loc="left")
    axes[first].set_ylabel("largest error of the force / largest change of a force")
    axes[first].legend(fontsize=7, loc="lower left")
    figure.supxlabel("time of the loop, s", fontsize=8)
    return figure


def show_advice(rows: pd.DataFrame, advised: pd.DataFrame) -> Shown:
    """Steps of ``verlet``, the scheme of the codes: all quantities of the first scene, the force of the others."""
    first, *others = rows["scene"].unique()
    by_verlet, by_codes = advised[advised["method"] == VERLET], advised[advised["method"].isin(codes())]
    if not by_codes.empty:  # their rounding may be larger than a small error
        by_verlet = by_verlet.merge(by_codes[["scene", "quantity", "error_at_most"]].drop_duplicates())
    texts = [
        _time(row["time_step_s"]) + f"\nforce {100 * row['error_of_force']:.2g} %" * (row["quantity"] != "force")
        for row in by_verlet.to_dict("records")
    ]
    cells = by_verlet.assign(text=texts).pivot(index=["scene", "quantity"], columns="error_at_most", values="text")
    chosen = [*((first, quantity) for quantity in QUANTITIES), *((scene, "force") for scene in others)]
    table = cells.reindex(pd.MultiIndex.from_tuples(chosen), columns=SHOWN_TARGETS).fillna("–")
    table.columns = pd.Index([f"1e{round(np.log10(target))}" for target in SHOWN_TARGETS])
    table.insert(0, "scene, quantity", [f"{scene}, {QUANTITIES[quantity]}" for scene, quantity in chosen])
    return Shown(
        "Time step for an allowed error",
        "Largest step at which velocity Verlet, the scheme of the codes, keeps the error; all smaller measured steps"
        " keep it as well. Beside the step of another quantity stands the error of the force. A dash: no code keeps the"
        " error at any step.",
        table,
    )


def show_softening(softened: pd.DataFrame) -> Shown:
    """Largest error of the scaled quantities, and what softening gains, by setting."""
    worst = softened.groupby("setting", sort=False)[["error", "limit", "steps"]].max()
    cells = [
        (setting, short(error), f"{limit:.1f}", f"{steps:.2f}") for setting, error, limit, steps in worst.itertuples()
    ]
    return Shown(
        "Softened beads: larger time steps, as many of them",
        "Largest error of speed and amplitudes on Fig. 4, scaled back to the hard beads; stable time step, and number"
        " of such steps until the wave reaches the wall, divided by those of the hard beads. The wave slows down as the"
        " step grows, so softening gains nothing on a wave; it gains on what has a clock of its own, such as a fall"
        " under gravity, where the error stands.",
        pd.DataFrame(cells, columns=["modulus", "error", "time step", "steps"]),
    )


def _time(seconds: float) -> str:
    """A time with two digits and a suitable unit."""
    return str(EngFormatter("s")(float(f"{seconds:.2g}")))
