"""Sentences of the study of elements, and where its rule does not hold, computed from its tables."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from drivers.base.tolerances import tolerance
from postproc.paper.quoted import quoted
from validation.elements.between import WITHOUT_FRICTION
from validation.elements.oscilloscope import STEPS
from validation.studies import Tables

ROUNDING = 1e-6  # of a mean: where a spread is none
ELASTIC, *ADDED = STEPS


@dataclass(frozen=True)
class Quote:
    """A number that the paper quotes from its experiment on a scene.

    Attributes:
        value: in ``unit``, which is ``scale`` times that of the observable.
        about: what its label in figures says before it.
    """

    scene: str
    observable: str
    words: str
    unit: str
    scale: float
    value: float
    about: str = ""

    @property
    def label(self) -> str:
        """What stands beside it in a figure."""
        return f"experiment: {self.about}{self.value:g} {self.unit}"


def quotes() -> list[Quote]:
    """What the paper quotes of the scenes that are watched."""
    told = quoted()
    envelope = told.fig5.measured_envelope_per_us
    return [
        Quote("fig4", "bead_9_peak_N", "leading force", "N", 1.0, told.fig4.leading_force_N, "about "),
        Quote("fig4", "speed_9_to_5_m_s", "speed", "m/s", 1.0, told.fig4.speed_m_s),
        Quote("fig5", "wall_envelope_per_s", "wall envelope", "per µs", 1e-6, envelope),
    ]


def sentences(tables: Tables) -> list[str]:
    """What was found, each with its numbers; the effects themselves are a table."""
    rule = _on_rule(tables["elements-nothing"], tables["elements-accuracies"])
    gaps = [
        line for quote in quotes() for line in _on_gap(quote, tables["oscilloscope"], tables["oscilloscope-ranges"])
    ]
    return [*rule, *_on_codes(tables["elements-between"]), *gaps]


def missed(tables: Tables) -> list[str]:
    """Where the rule does not hold, or the codes differ where they must not."""
    limit, codes = tolerance("elements", "nothing").limit, tolerance("elements", "codes").limit
    nothing, accuracies, between = tables["elements-nothing"], tables["elements-accuracies"], tables["elements-between"]
    without_friction = between[between["friction"] == WITHOUT_FRICTION].drop_duplicates(["scene", "codes"])
    return [
        *(f"{row['scene']} on {row['engine']}: what is always left out changes forces by {row['change']:.2g}, allowed"
          f" {limit:g}" for _, row in nothing[~(nothing["change"] <= limit)].iterrows()),
        *(f"accuracy {row['accuracy']} on {row['engine']}: {row['quantity']} is off by {row['error']:.2g}, asked were"
          f" {row['asked']:g}" for _, row in accuracies[~(accuracies["error"] <= accuracies["asked"])].iterrows()),
        *(f"{row['scene']} in its tube without friction: {row['codes'].replace(' ', ' and ')} differ by"
          f" {row['before_wall']:.2g} before the wave reaches the wall, allowed {codes:g}"
          for _, row in without_friction[~(without_friction["before_wall"] <= codes)].iterrows()),
    ]  # fmt: skip


def _on_rule(nothing: pd.DataFrame, accuracies: pd.DataFrame) -> list[str]:
    equal = int((nothing["change"] == 0).sum())
    kept = accuracies[accuracies["error"] <= accuracies["asked"]]
    most = accuracies["left_out"].map(lambda names: len(names.split(", ")) if names else 0).max()
    return [
        "What is always left out of straight chains changes nothing: beads free to move, turn and rub change forces by"
        f" {nothing['change'].max():.1e} of the largest at most; of {len(nothing)} runs {equal} are equal bit for bit.",
        f"What an accuracy lets out (up to {most} elements) stays within it: {len(kept)} of {len(accuracies)} runs.",
    ]


def _on_codes(between: pd.DataFrame) -> Iterator[str]:
    for (scene, friction, codes), rows in between.groupby(["scene", "friction", "codes"], sort=False):
        row = rows.iloc[0]
        if not row["seeds"]:
            yield f"Codes in the tube against each other: {row['observable']}."
            continue
        parted = "they never differ by a per cent"
        if pd.notna(row["earliest_parted_s"]):
            median = f"{row['median_parted_s'] * 1e6:.0f} µs" if pd.notna(row["median_parted_s"]) else "never"
            parted = f"they part by a per cent from {row['earliest_parted_s'] * 1e6:.0f} µs on (median {median})"
        wall = rows[rows["observable"] == "wall peak"].iloc[0]
        first, second = (_pm(wall[f"{each}_mean"], wall[f"{each}_spread"]) for each in ("first", "second"))
        alike = f"equal distributions: p = {wall['same']:.2g}"
        if max(wall["first_spread"], wall["second_spread"]) < ROUNDING * wall["first_mean"]:  # seeds change nothing
            alike = f"the same for every seed, {wall['second_mean'] / wall['first_mean'] - 1:+.1e} apart"
        yield (
            f"{scene} {friction}, {codes}, {row['seeds']} seeds: until the wave reaches the wall they differ by"
            f" at most {row['before_wall']:.1e}; {parted}. Wall peak {first} and {second} N ({alike})."
        )


def _on_gap(quote: Quote, numbers: pd.DataFrame, ranges: pd.DataFrame) -> Iterator[str]:
    """How much of the gap between the elastic line and the experiment each step explains."""
    own, varied = (
        table[(table["scene"] == quote.scene) & (table["observable"] == quote.observable)]
        for table in (numbers, ranges)
    )
    steps = own.set_index("step")
    if ELASTIC not in steps.index:
        return
    mean, spread = quote.scale * steps["mean"], quote.scale * steps["spread"]
    elastic = mean[ELASTIC]
    shares = (mean - elastic) / (quote.value - elastic)
    parts = [f"{step} {_pm(mean[step], spread[step])} ({_percent(shares[step])})" for step in ADDED]
    yield (
        f"{quote.scene}, {quote.words}: elastic line {elastic:.4g} {quote.unit}, experiment {quote.value:g}; of the"
        f" gap, step by step and all before it included: {', '.join(parts)}."
    )
    for name, rows in varied.groupby("step", sort=False):
        shares = (quote.scale * rows["mean"] - elastic) / (quote.value - elastic)
        values = ", ".join(f"{value}: {_percent(share)}" for value, share in zip(rows["value"], shares, strict=True))
        yield f"{quote.scene}, {quote.words}: share of the gap for a {name} of {values}."


def _pm(mean: float, spread: float) -> str:
    return f"{mean:.4g} ± {spread:.1g}" if spread > ROUNDING * abs(mean) else f"{mean:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "not seen"
