"""What the tables of elements say, in sentences, and where the rule does not hold."""

from pathlib import Path

import numpy as np
import pandas as pd

from drivers.base.tolerances import tolerance
from postproc.paper.quoted import Quoted
from validation.elements.oscilloscope import STEPS

TABLES = {
    "effects": "elements.csv",
    "nothing": "elements-nothing.csv",
    "accuracies": "elements-accuracies.csv",
    "between": "elements-between.csv",
    "steps": "oscilloscope.csv",
    "ranges": "oscilloscope-ranges.csv",
}
WITHOUT_FRICTION = "without friction"
ROUNDING = 1e-6  # of a mean: where a spread is none
ORDINARY = next(iter(STEPS))


def read_tables(results: Path) -> dict[str, pd.DataFrame]:
    """All tables that are there."""
    return {name: pd.read_csv(results / file) for name, file in TABLES.items() if (results / file).exists()}


def quoted_of(quoted: Quoted, scene: str) -> dict[str, tuple[float, str]]:
    """What the paper quotes from its experiment on a scene, by the number it is drawn beside."""
    if scene == "fig4":
        return {
            "sensor peak": (quoted.fig4.leading_force_N, "experiment: about 2 N"),
            "speed": (quoted.fig4.speed_m_s, f"experiment: {quoted.fig4.speed_m_s:g} m/s"),
        }
    if scene == "fig5":
        value = quoted.fig5.measured_envelope_per_us
        return {"wall envelope": (value, f"experiment: {value:g} per µs")}
    return {}


def sentences(tables: dict[str, pd.DataFrame]) -> list[str]:
    """What was found, each with its numbers; the effects themselves are a table."""
    return [
        *_rule(tables["nothing"], tables["accuracies"]),
        *_between(tables["between"]),
        *_gaps(tables["steps"], tables["ranges"]),
    ]


def _rule(nothing: pd.DataFrame, accuracies: pd.DataFrame) -> list[str]:
    equal = int((nothing["change"] == 0).sum())
    kept = accuracies[accuracies["error"] <= accuracies["asked"]]
    most = accuracies["left_out"].fillna("").map(lambda names: len(names.split(", ")) if names else 0).max()
    return [
        "What is always left out of straight chains changes nothing: beads free to move, turn and rub change forces by"
        f" {nothing['change'].max():.1e} of the largest at most; of {len(nothing)} runs {equal} are equal bit for bit.",
        f"What an accuracy lets out (up to {most} elements) stays within it: {len(kept)} of {len(accuracies)} runs.",
    ]


def effects_of(effects: pd.DataFrame) -> list[str]:
    """Each element's change of the wall's peak on the first scene, and its cost, code by code."""
    found = []
    first = effects["scene"].iloc[0]
    for engine, own in effects[effects["scene"] == first].groupby("engine", sort=False):
        found.append(f"{first} on {engine}: wall peak, nanoseconds per body and step, and their ratio")
        for element, rows in own.groupby("element", sort=False):
            wall = rows[rows["observable"] == "wall peak"].iloc[0]
            spread = f" ± {100 * wall['spread']:.1g}" if wall["spread"] > ROUNDING else ""
            change = f"{100 * wall['change']:+.3g}{spread} %"
            found.append(f"  {element:<22} {change:>16} {wall['cost_ns']:8.3g} ns {wall['cost_ratio']:6.2f}")
    return found


def _between(between: pd.DataFrame) -> list[str]:
    found = []
    for (scene, friction), rows in between.groupby(["scene", "friction"], sort=False):
        row = rows.iloc[0]
        parted = "they never differ by a per cent"
        if pd.notna(row["earliest_parted_s"]):
            median = f"{row['median_parted_s'] * 1e6:.0f} µs" if pd.notna(row["median_parted_s"]) else "never"
            parted = f"they part by a per cent from {row['earliest_parted_s'] * 1e6:.0f} µs on (median {median})"
        wall = rows[rows["observable"] == "wall peak"].iloc[0]
        first, second = (_pm(wall[f"{each}_mean"], wall[f"{each}_spread"]) for each in ("first", "second"))
        alike = f"equal distributions: p = {wall['same']:.2g}"
        if max(wall["first_spread"], wall["second_spread"]) < ROUNDING * wall["first_mean"]:  # seeds change nothing
            alike = f"the same for every seed, {wall['second_mean'] / wall['first_mean'] - 1:+.1e} apart"
        found.append(
            f"{scene} {friction}, {row['codes']}, {row['seeds']} seeds: until the wave reaches the wall they differ by"
            f" at most {row['before_wall']:.1e}; {parted}. Wall peak {first} and {second} N ({alike})."
        )
    return found


def _pm(mean: float, spread: float) -> str:
    return f"{mean:.4g} ± {spread:.1g}" if spread > ROUNDING * abs(mean) else f"{mean:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "not seen"


def _gaps(steps: pd.DataFrame, ranges: pd.DataFrame) -> list[str]:
    """How much of the gap between the elastic line and the experiment each step explains."""
    from postproc.paper.quoted import quoted

    found, told = [], quoted()
    wanted = {
        "fig4": {"bead_9_peak_N": (1.0, "leading force", "N"), "speed_9_to_5_m_s": (1.0, "speed", "m/s")},
        "fig5": {"wall_envelope_per_s": (1e-6, "wall envelope", "per µs")},
    }
    targets = {
        "bead_9_peak_N": told.fig4.leading_force_N,
        "speed_9_to_5_m_s": told.fig4.speed_m_s,
        "wall_envelope_per_s": told.fig5.measured_envelope_per_us,
    }
    for scene, names in wanted.items():
        for name, (scale, words, unit) in names.items():
            own = steps[(steps["scene"] == scene) & (steps["observable"] == name)].set_index("step")
            if ORDINARY not in own.index:
                continue
            means, spreads = (own[column].astype(float).to_dict() for column in ("mean", "spread"))
            elastic, target = scale * float(means[ORDINARY]), targets[name]
            parts = []
            for step in list(STEPS)[1:]:
                mean, spread = scale * float(means[step]), scale * float(spreads[step])
                share = (mean - elastic) / (target - elastic)
                parts.append(f"{step} {_pm(mean, spread)} ({_percent(share)})")
            found.append(
                f"{scene}, {words}: elastic line {elastic:.4g} {unit}, experiment {target:g}; of the gap, step by step"
                f" and all before it included: {', '.join(parts)}."
            )
            found += _ranges(ranges, scene, name, scale, words, elastic, target)
    return found


def _ranges(
    ranges: pd.DataFrame, scene: str, name: str, scale: float, words: str, elastic: float, target: float
) -> list[str]:
    found = []
    own = ranges[(ranges["scene"] == scene) & (ranges["observable"] == name)]
    for step, rows in own.groupby("step", sort=False):
        shares = (scale * rows["mean"] - elastic) / (target - elastic)
        values = ", ".join(f"{value:g}: {_percent(share)}" for value, share in zip(rows["value"], shares, strict=True))
        found.append(f"{scene}, {words}: share of the gap for a {step} of {values}.")
    return found


def missed(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Where the rule does not hold, or the codes differ where they must not."""
    limit, codes = tolerance("elements", "nothing").limit, tolerance("elements", "codes").limit
    nothing, accuracies = tables["nothing"], tables["accuracies"]
    between = tables["between"]
    apart = (
        pd.DataFrame()
        if between.empty
        else between[(between["friction"] == WITHOUT_FRICTION) & ~(between["before_wall"] <= codes)].drop_duplicates(
            "scene"
        )
    )
    return [
        *(f"{row['scene']} on {row['engine']}: what is always left out changes forces by {row['change']:.2g}, allowed"
          f" {limit:g}" for _, row in nothing[~(nothing["change"] <= limit)].iterrows()),
        *(f"accuracy {row['accuracy']} on {row['engine']}: {row['quantity']} is off by {row['error']:.2g}, asked were"
          f" {row['asked']:g}" for _, row in accuracies[~(accuracies["error"] <= accuracies["asked"])].iterrows()),
        *(f"{row['scene']} in its tube without friction: the codes differ by {row['before_wall']:.2g} before the wave"
          f" reaches the wall, allowed {codes:g}" for _, row in apart.iterrows()),
    ]  # fmt: skip
