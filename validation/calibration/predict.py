"""``beads predict``: forces and observables of another scene by a fit, with errors and the spread over laws.

Materials, contact law and electronics are those of the fit, all else is of the scene. For each law that holds, the
motion is computed at the parameters found, and at one standard error on either side along each principal axis of their
covariance: half of that difference is the error by this axis. Laws are weighed by Akaike's criterion (``weights_of``);
an interval of 95 % is that of the mixture of their normal distributions.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.units import SI
from drivers.chain.chain import Array
from drivers.laws import LAWS
from drivers.scene.model import Scene
from drivers.scene.read_scene import apply_settings, make_scene
from drivers.scene.settings import look_up, setting_texts
from postproc.draw.plot import COLUMN_IN, MICRO, pyplot
from postproc.draw.stack import GAUGE_IN, gauge_title
from postproc.read.motion import Simulation
from postproc.read.observables import describe
from validation.calibration.command import Fitted, problem_of, read_fits
from validation.calibration.fit import DECISIVE, LOOKS, Fit, digits, fit, rows_of, weights_of, with_error
from validation.calibration.parameters import ELASTIC, OF_LAWS
from validation.calibration.problem import DataSet, Problem, checked
from validation.report.parts import Chapter, Shown

MATERIALS = "materials"
CARRIED = (MATERIALS, "contact", "sensor")  # tables with parameters that a prediction takes from a fit
SPAN, HALVINGS = 8.0, 50  # of the search for a quantile: standard errors on either side, and halvings
ENDS = (0.025, 0.975)
HEAD_IN = 1.0


@dataclass(frozen=True)
class Prediction:
    """Predicted observables and forces; the law of a column is ``scene`` if it is that of the fitted scene.

    Attributes:
        fit: Folder of the fit.
        scene: The scene, as its file states it.
        simulation: Motion of the first law at the parameters found.
        weights: Weights of the laws that hold.
        explained: True if a fitted law explains the data of the fit.
        others: Excess of Akaike's criterion over the best fitted law, of the laws that were not fitted.
        observables: A row for each ``observable``: ``value``, the mean of the laws by weight; ``error`` by the
            parameters; ``between_laws``, the largest minus the smallest value; ``low_95pct``, ``high_95pct``; value
            and error of each law.
        forces: ``time_s``, and for each gauge the same numbers in N.
    """

    fit: Path
    scene: Scene
    simulation: Simulation
    weights: Mapping[str, float]
    explained: bool
    others: Mapping[str, float]
    observables: pd.DataFrame
    forces: pd.DataFrame

    @property
    def holds(self) -> bool:
        """True if a fitted law explains the data, and no other law does so far better."""
        return self.explained and min(self.others.values(), default=0.0) >= -DECISIVE

    @property
    def said(self) -> list[str]:
        """Sentences on the laws."""
        shares = (f"{law or 'that of the scene'} {share:.2g}" for law, share in self.weights.items())
        said = [f"laws by weight: {', '.join(shares)}"]
        if not self.holds:
            reason = "no fitted law explains the data"
            if self.explained:
                law, above = next(iter(self.others.items()))
                reason = f"{law}, which was not fitted, has an AIC that is {-above:.3g} lower"
            said.insert(0, f"the prediction does not hold: {reason}")
        if equal := ", ".join(law for law, above in self.others.items() if above < DECISIVE):
            said.append(f"not excluded by the data, but not fitted (beads fit {paths.shown(self.fit)} --law): {equal}")
        return said


def predict(
    fit: Fitted | str | Path, scene: str | Path = "", settings: Mapping[str, Any] | Sequence[str] = ()
) -> Prediction:
    """Prediction of a scene by a fit or its folder.

    Args:
        fit: What ``fit`` returned, or its folder.
        scene: Name or file of a scene; by default that of the fit, with all of its parameters.
        settings: As those of ``fit``, applied to the scene.

    Raises:
        InputError: The folder is not that of a fit, the scene has errors, or no fitted parameter occurs in it.
        RunError: The exact motion cannot be computed at the parameters found.

    Examples:
        >>> import validation
        >>> found = validation.fit("example-measured", free=["contact.restitution"], quick=True, results=folder)
        >>> predict(found, "fig4", {"striker.speed": "1 m/s"}).said[0]
        'the prediction does not hold: no fitted law explains the data'
    """
    fitted = fit if isinstance(fit, Fitted) else read_fits(Path(fit))
    texts = setting_texts(settings)
    data = checked(str(scene or fitted.sources[0]), texts if scene else (*fitted.request.settings, *texts))
    return replace(by_fits(fitted, replace(data, settings=texts), own=not scene), others=others_of(fitted))


def others_of(fitted: Fitted) -> dict[str, float]:
    """Excess of Akaike's criterion of laws that were not fitted over the best one; they start at the values of that."""
    best = min(fitted.fits.values(), key=lambda fit: fit.aic)
    known = {*fitted.fits, best.problem.sets[0].scene.contact.law.name}
    excess = dict[str, float]()
    for law in {ELASTIC, *LAWS} - known:
        with suppress(InputError, RunError):  # such as a law without a start
            found = fit(problem_of(fitted.request, law, best.problem.sets), [best.values], search=False)
            excess[law] = found.aic - best.aic
    return dict(sorted(excess.items(), key=lambda item: item[1]))


def by_fits(fitted: Fitted, data: DataSet, *, own: bool = False) -> Prediction:
    """Prediction of a scene by the laws that hold; with ``own`` by all parameters of the fit.

    Args:
        fitted: The fits.
        data: Data set of the scene without data.
        own: True if the scene is that of the fit.

    Raises:
        InputError: No fitted parameter occurs in the scene.
        RunError: The exact motion cannot be computed at the parameters found.
    """
    weights, parts, motions = weights_of(fitted.fits), dict[str, tuple[Problem, list[int]]](), list[Simulation]()
    for law in weights:
        fit = fitted.fits[law]
        problem, places = parts[law] = _part_of(fit, data, own=own)
        motion = problem.motion(problem.sets[0], fit.place[places])
        if motion is None:
            raise RunError(f"{data.where}: the exact motion cannot be computed at the parameters found")
        motions.append(motion)
    names, time_s = [*dict.fromkeys(name for motion in motions for name in motion.values)], motions[0].trace.time_s
    found = [propagated(fitted.fits[law], *part, names) for law, part in parts.items()]
    table, forces = _table(weights, *map(np.array, zip(*found, strict=True))), {"time_s": time_s}
    for number, gauge in enumerate(motions[0].signals):
        rows = table.iloc[len(names) + number * len(time_s) :][: len(time_s)]
        forces |= {f"{gauge}_{column}_N": rows[column].to_numpy() for column in table}
    observables = table.iloc[: len(names)]
    observables.insert(0, "observable", names)
    observables.insert(1, "unit", [describe(name).unit for name in names])
    explained = any(fitted.fits[law].explained for law in weights)
    return Prediction(fitted.folder, data.scene, motions[0], weights, explained, {}, observables, pd.DataFrame(forces))


def _part_of(fit: Fit, data: DataSet, *, own: bool) -> tuple[Problem, list[int]]:
    """Problem of a scene with what it takes from a fit, and the places of its parameters in the fit.

    Settings of the data set are applied last, so that they stay.
    """
    tables, source = json.loads(data.tables), json.loads(fit.problem.sets[0].tables)
    contact = {key: value for key, value in tables["contact"].items() if f"contact.{key}" not in OF_LAWS}
    law = {key: value for key, value in source["contact"].items() if f"contact.{key}" in OF_LAWS}
    free, first = fit.problem.free, fit.problem.sets[0].name
    moving = [place for place, each in enumerate(free) if each.of_motion and each.belongs_to(first)]
    asked = [text.partition("=")[0].strip() for text in data.settings]
    if "contact.dissipation" in asked:  # another law, with all that the scene states of it
        contact, law, asked = tables["contact"], {}, [*asked, *OF_LAWS]
    if not own:
        tables |= {"sensor": source["sensor"]} if "sensor" in source else {}
        tables[MATERIALS] |= source[MATERIALS]
        offered = [place for place in moving if not free[place].own and free[place].key.startswith(CARRIED)]
        here = [place for place in offered if look_up(data.scene, free[place].key) is not None]
        moving = [place for place in offered if place in here or not free[place].key.startswith(MATERIALS)]
        materials = [any(free[place].key.startswith(MATERIALS) for place in places) for places in (offered, moving)]
        if not moving or materials == [True, False]:
            allowed = " or ".join(free[place].key for place in offered) or "a fit of a material or a law"
            raise InputError(data.where, "", "other materials than those of the fit", allowed)
    moving = [place for place in moving if not f"{free[place].key}.".startswith(tuple(f"{key}." for key in asked))]
    tables["contact"] = contact | law
    apply_settings(tables, [text for text in data.settings if text.strip().startswith(CARRIED)])
    begun = replace(data, name=first, tables=json.dumps(tables))
    make_scene(tables, data.where, data.where, context=SI)  # an InputError names what is set in vain
    return Problem((begun,), tuple(free[place] for place in moving)), moving


def _numbers_at(problem: Problem, place: Array, names: Sequence[str]) -> Array:
    """Observables by name, then the forces of all gauges; NaN for those that the motion lacks, or without a motion."""
    motion = problem.motion(problem.sets[0], place)
    if motion is None:
        return np.array(np.nan)
    return np.concatenate([[motion.values.get(name, np.nan) for name in names], *motion.signals.values()])


def propagated(fit: Fit, problem: Problem, places: Sequence[int], names: Sequence[str]) -> tuple[Array, Array]:
    """Observables and forces at the parameters found, and their standard errors by the parameters at these places.

    Ends beyond a bound move to the bound, and the difference is scaled.
    """
    place = fit.place[places]
    variances, axes = np.linalg.eigh(fit.covariance[np.ix_(places, places)])
    here = _numbers_at(problem, place, names)
    squares = np.zeros(len(here))
    for axis in (axes * np.sqrt(np.maximum(variances, 0.0))).T:
        ends, length = list[Array](), 0.0
        for step in (axis, -axis):
            room = np.where(step > 0, 1 - place, place)
            share = float(np.min(room[step != 0] / np.abs(step[step != 0]), initial=1.0))
            ends.append(_numbers_at(problem, place + share * step, names))
            length += share
        squares += ((ends[0] - ends[1]) / length) ** 2 if length else 0.0
    return here, np.sqrt(squares) * fit.enlargement


def _table(weights: Mapping[str, float], values: Array, errors: Array) -> pd.DataFrame:
    """Mean, error, spread and interval of each number, from those of each law; both of shape (laws, numbers)."""
    shares = np.array([*weights.values()])[:, None]
    table = {
        "value": (shares * values).sum(axis=0),
        "error": np.sqrt((shares * errors**2).sum(axis=0)),
        "between_laws": np.ptp(values, axis=0),
        "low_95pct": quantile(shares, values, errors, ENDS[0]),
        "high_95pct": quantile(shares, values, errors, ENDS[1]),
    }
    for law, value, error in zip(weights, values, errors, strict=True):
        table |= {f"value_{law or 'scene'}": value, f"error_{law or 'scene'}": error}
    return pd.DataFrame(table)


def quantile(shares: Array, values: Array, errors: Array, probability: float) -> Array:
    """Quantile of mixtures of normal distributions, by bisection.

    Args:
        shares: Weights. Shape (laws, 1).
        values: Means. Shape (laws, numbers).
        errors: Standard deviations. Shape (laws, numbers).
        probability: That of a smaller number.
    """
    errors = np.maximum(errors, np.finfo(float).eps * np.abs(values) + np.finfo(float).tiny)
    low, high = (values - SPAN * errors).min(axis=0), (values + SPAN * errors).max(axis=0)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = (shares * ndtr((middle - values) / errors)).sum(axis=0) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray((low + high) / 2)


def rows_of_text(found: Prediction) -> list[list[str]]:
    """Rows of the printed table, the heading first: observables of waves that the motion shows."""
    rows = [["predicted", "value", "between laws", "95 % interval"]]
    for row in rows_of(found.observables.dropna(subset="value")):
        if describe(row.observable).of_wave:
            numbers = row.between_laws, row.low_95pct, row.high_95pct
            (spread, low, high), unit = digits(numbers, row.value, row.error, row.unit)
            value = with_error(row.value, row.error, row.unit)
            rows.append([row.observable, value, f"{spread} {unit}".rstrip(), f"{low} .. {high} {unit}".rstrip()])
    return rows


def chapter_of(found: Prediction, name: str) -> Chapter:
    """Tables, figure and sentences of a prediction, for its files and the page."""
    rows = rows_of_text(found)
    return Chapter(
        {name: found.observables, f"{name}-forces": found.forces},
        [f"By {paths.shown(found.fit)}: {'; '.join(found.said)}."],
        {name: ("Predicted forces with their 95 % intervals", draw(found))} if found.simulation.signals else {},
        [Shown("Predicted observables", "", pd.DataFrame(rows[1:], columns=rows[0]))],
    )


def draw(found: Prediction) -> Any:
    """A panel for each gauge: the interval of 95 %, and the force by each law."""
    forces, layout = found.forces, found.simulation.case.layout
    gauges, time_us = [*found.simulation.signals], forces["time_s"] * MICRO
    size = (COLUMN_IN, HEAD_IN + GAUGE_IN * len(gauges))
    figure, axes = pyplot().subplots(len(gauges), 1, sharex=True, figsize=size, squeeze=False, layout="constrained")
    for axis, gauge in zip(axes[:, 0], gauges, strict=True):
        low, high = (forces[f"{gauge}_{end}_95pct_N"] for end in ("low", "high"))
        axis.fill_between(time_us, low, high, color="0.75", lw=0, label="95 % interval")
        for (colour, _), law in zip(LOOKS * len(found.weights), found.weights, strict=False):
            label = law or "law of the fitted scene"
            axis.plot(time_us, forces[f"{gauge}_value_{law or 'scene'}_N"], color=colour, lw=0.9, label=label)
        axis.set_title(gauge_title(layout, gauge), loc="left")
        axis.set_ylabel("force (N)")
    axes[-1, 0].set(xlabel="time since impact (µs)", xlim=(0, time_us.iloc[-1]))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    if not found.holds:
        figure.suptitle(fill(found.said[0], 70), color="#b00020", fontsize=8)
    return figure
