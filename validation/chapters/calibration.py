"""Calibration on the paper's experiments: each law fitted in all readings of what the paper leaves open."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from drivers.base import paths
from drivers.base.terminal import following
from drivers.base.tolerances import tolerance
from drivers.laws import VISCOELASTIC
from drivers.run.execute import Place, execute
from postproc.draw.plot import GREY, pyplot
from postproc.paper import calibrated
from validation.calibration.fit import DATA, LAWS, LOOKS, MAX_DEVIATION, PARAMETERS, Tables, rows_of, solve, value_text
from validation.calibration.parameters import CUT, DEFAULT, ELASTIC, calibration_file, keys_of, law_of
from validation.calibration.problem import paper_data, pose
from validation.chapters import Options
from validation.checks import FAIL, Check, judged, without_run
from validation.report.parts import Chapter, Shown

NAMES = {LAWS: "calibration", PARAMETERS: "calibration-parameters", DATA: "calibration-data"}  # of the files
MIN_PROBABILITY = 0.05  # of chi-square; below it a law does not fit
MODULUS, RESTITUTION = "materials.ptfe.youngs_modulus", "contact.restitution"
GAUGES, SPEEDS = "sensor.time_constant", "reading.speed_scale"
ELECTRONICS, ONE_MS = "electronics: RC about 1 ms", "electronics: RC 1 ms"
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
# words for numbers of the paper, by parts of their names
KINDS = {"amplitude": "force", "force": "force", "speed": "speed", "width": "full width", "decay": "decay at the wall"}
NUMBER_IN, WIDTH_IN = 0.36, 6.8
SPREAD = 0.7  # of the fits of a number, as a share of the distance of two numbers
CUTS = ("4 %", "5 %", "8 %", "12 %", "15 %")  # fixed, of the dissipative law without electronics


def measure(options: Options) -> Chapter:
    """Fits of all readings; the short study fits some, from the parameters found before, and shows stored findings."""
    tables = study(quick=options.quick)
    findings, cuts, checks = calibrated().findings, calibrated().cuts, [*judge(tables)]
    if not options.quick:
        stored, findings, cuts = (findings, cuts), tuple(conclusions(tables)), tuple(cut_rows(tables))
        if not alike(str(stored), str((findings, cuts))):
            place = f"findings and cuts: the fits give {findings} and {cuts}"
            checks.append(without_run(paths.shown(paths.CALIBRATED), "", place, FAIL))
    return Chapter(
        tables={name: tables[key] for key, name in NAMES.items()},
        findings=[*findings],
        figures={NAMES[LAWS]: ("Deviations of fitted from measured numbers", draw_deviations(tables[DATA]))},
        shown=shown(tables, cuts),
        checks=checks,
        short=options.quick,
    )


def alike(stored: str, found: str) -> bool:
    """True for two texts of equal words whose numbers agree to a fifth: a fit may just hold on one machine only."""
    if NUMBER.split(stored) != NUMBER.split(found):
        return False
    numbers = [np.array(NUMBER.findall(text), float) for text in (stored, found)]
    return np.allclose(numbers[0], numbers[1], rtol=0.2, atol=0)


def study(*, quick: bool = False) -> Tables:
    """Tables of all fits: each law in the default reading, then from there in all others."""
    known, readings = calibration_file().found, [*calibration_file().readings(quick=quick)]
    done = list[Tables]()
    if not quick:
        found = {law: fit_law(law, DEFAULT) for law in following(known, "laws", len(known), "law")}
        known = {name: values for name, (values, _) in found.items()}
        done, readings = [tables for _, tables in found.values()], readings[1:]
    work = execute(partial(_fit_laws, known), readings, Place(processes=True))
    results = dict(following(work, "readings", len(readings), "reading"))
    done += [tables for reading in readings for tables in results[reading]]
    return {name: pd.concat([tables[name] for tables in done], ignore_index=True) for name in NAMES}


def _fit_laws(known: Mapping[str, Mapping[str, float]], reading: str) -> list[Tables]:
    """Tables of all laws for one reading, from known parameters and from each other: a larger law is never worse."""
    seeds, tables = list[Mapping[str, float]](), list[Tables]()
    for law in known:
        values, of_law = fit_law(law, reading, [known[law], *seeds])
        seeds.append(values)
        tables.append(of_law)
    return tables


def fit_law(law: str, reading: str, seeds: Sequence[Mapping[str, float]] = ()) -> tuple[dict[str, float], Tables]:
    """Parameters and tables of a law fitted to all quoted data for one reading, from seeds alone if there are some."""
    asked = calibration_file()
    answers = asked.readings()[reading]
    free = (*asked.free, *keys_of(law)[:1], *(text for answer in answers for text in answer.free))
    problem = pose(paper_data(asked.data, law_of(law), answers), free)
    fit, tables = solve(problem, quick=bool(seeds), seeds=seeds, search=not seeds)
    return fit.values, {name: table.assign(law=law, data=reading) for name, table in tables.items()}


def parameters_of(tables: Tables, law: str, reading: str) -> dict[str, Any]:
    """Parameters of a fit that all data share, by key."""
    of_fit = tables[PARAMETERS].query("law == @law and data == @reading")
    return {row.parameter: row for row in rows_of(of_fit) if ":" not in row.parameter}


def goodness_of(tables: Tables, law: str, reading: str) -> Any:
    """Goodness of a fit."""
    return rows_of(tables[LAWS].query("law == @law and data == @reading"))[0]


def held(tables: Tables, name: str) -> pd.DataFrame:
    """Rows of a table that belong to the fits that hold."""
    fits = tables[LAWS]
    return tables[name].merge(fits.loc[fits["probability"] >= MIN_PROBABILITY, ["law", "data"]])


def bounds(tables: Tables, key: str) -> tuple[float, float]:
    """Lowest and highest value of a parameter, with its error, in the fits that hold."""
    rows = held(tables, PARAMETERS)
    rows = rows[rows["parameter"] == key]
    error = rows["error"].where(np.isfinite(rows["error"]), 0.0)
    low, high = (rows["value"] - error).clip(lower=rows["least"]), (rows["value"] + error).clip(upper=rows["most"])
    return float(low.min()), float(high.max())


def conclusions(tables: Tables) -> Iterator[str]:
    """Laws that fit in some reading, what elastic beads need to fit, the range of moduli, and numbers mostly missed."""
    fits, holding = tables[LAWS], held(tables, LAWS)
    counts = ", ".join(f"{law} in {(holding['law'] == law).sum()}" for law in fits["law"].unique())
    least = f"(probability above {MIN_PROBABILITY:g})"
    yield f"Of {fits['data'].nunique()} readings of the paper, the laws fit {least}: {counts}."
    if holding.empty:
        return
    fits = held(tables, PARAMETERS).query("law == @ELASTIC")
    if len(fits) and fits["data"].str.contains("electronics").all():
        rows = {key: fits[fits["parameter"] == key] for key in (GAUGES, MODULUS, SPEEDS, CUT)}
        values, exact = {key: of_key["value"] for key, of_key in rows.items()}, goodness_of(tables, ELASTIC, ONE_MS)
        below = (rows[SPEEDS]["start"] - values[SPEEDS]) / rows[SPEEDS]["prior"]
        lowest = ", the lowest cut" * bool((rows[CUT]["at"] == "lower bound").all())
        yield (
            f"Elastic beads fit only with the electronics of the gauges, and then need a time constant of "
            f"{_span(values[GAUGES] * 1e3)} ms, a modulus of {_span(values[MODULUS] * 1e-9)} GPa, a scale of speeds "
            f"{_span(below, 1)} standard errors below 1, and durations read at {_span(100 * values[CUT], 1)} % of the "
            f"peak{lowest}; with the paper's time constant of 1 ms, chi-square is {exact.chi_square:.1f} with "
            f"{exact.freedom} degrees of freedom (probability {exact.probability:.0e})."
        )
    low, high = bounds(tables, MODULUS)
    yield f"Young's modulus of the fits that hold, with their errors: {low * 1e-9:.2f} to {high * 1e-9:.2f} GPa."
    data = numbers(held(tables, DATA))
    missed = (data["off"].abs() > 1).groupby(data["number"], sort=False).sum()
    often = "; ".join(str(name) for name in missed.index[missed > len(holding) / 2]) or "none"
    yield f"Missed by more than one standard error in most of the fits that hold: {often}."


def _span(values: "pd.Series[float]", digits: int = 2) -> str:
    """Smallest and largest value."""
    return " to ".join(dict.fromkeys(f"{value:.{digits}f}" for value in (values.min(), values.max())))


def cut_rows(tables: Tables) -> Iterator[tuple[str, ...]]:
    """Rows of the table of cuts: cut, chi-square, degrees of freedom, probability, restitution."""
    for cut, reading in [*((f"fixed at {cut}", f"cut: {cut}") for cut in CUTS), ("free", DEFAULT)]:
        row, found = goodness_of(tables, VISCOELASTIC, reading), parameters_of(tables, VISCOELASTIC, reading)
        named = f"{cut}: {value_text(found[CUT])}" if CUT in found else cut
        goodness = f"{row.chi_square:.1f}", f"{row.freedom}", f"{row.probability:.2g}"
        yield named, *goodness, value_text(found[RESTITUTION])


def name_of(data_set: str, datum: str) -> str:
    """Name of a datum: kind and, of a row, its force."""
    kind = next((word for part, word in KINDS.items() if part in datum), datum)
    words = {"table1": "Table 1,", "fig4": "Fig. 4", "fig5": "Fig. 5"}
    named = " ".join(words.get(part, part) for part in data_set.removesuffix(" width").split(" "))
    return f"{named}: {kind}"


def numbers(data: pd.DataFrame) -> pd.DataFrame:
    """Rows of measured numbers, with their names in a column ``number``."""
    data = data.dropna(subset="measured")
    return data.assign(number=[name_of(*pair) for pair in zip(data["data_set"], data["datum"], strict=True)])


def draw_deviations(data: pd.DataFrame) -> Any:
    """Fitted minus measured numbers in standard errors of the measurement, with the errors of the fits.

    Fits of the default reading have filled markers, those with electronics open ones.
    """
    data = numbers(data[data["data"].isin([DEFAULT, ELECTRONICS])])
    names, laws, fits = [*data["number"].unique()], [*data["law"].unique()], data.groupby(["data", "law"], sort=False)
    figure, axis = pyplot().subplots(figsize=(WIDTH_IN, 1.0 + NUMBER_IN * len(names)), layout="constrained")
    axis.axvspan(-1, 1, color=GREY, alpha=0.15, lw=0)
    axis.axvline(0, color="k", lw=0.8)
    for place, ((reading, law), own) in enumerate(fits):
        rows = own["number"].map(names.index) + SPREAD * ((place + 0.5) / len(fits) - 0.5)
        colour, marker = LOOKS[laws.index(law) % len(LOOKS)]
        axis.errorbar(
            own["off"], rows, xerr=own["fitted_error"] / own["error"], ls="none", marker=marker, ms=4, elinewidth=0.8,
            color=colour, mfc=colour if reading == DEFAULT else "white",
            label=f"{law}{', with electronics' * (reading == ELECTRONICS)}",
        )  # fmt: skip
    axis.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
    axis.set_xlabel("fitted minus measured, in standard errors of the measurement (grey: one)")
    figure.legend(loc="outside upper center", ncols=3, fontsize=7)
    return figure


def judge(tables: Tables) -> Iterator[Check]:
    """Are the parameters of the figures' dissipative chains those of the fits?"""
    file, where = calibrated(), paths.shown(paths.CALIBRATED)
    fitted = parameters_of(tables, file.law, file.reading)
    whole = tables[LAWS]["data"].nunique() == len(calibration_file().readings())
    for kept in file.parameter:
        row = fitted.get(kept.key)
        if row is None:
            yield without_run(where, file.law, f"{kept.key}: no fit", FAIL)
            continue
        changes = [row.value - kept.value, row.error - kept.error]
        if whole:
            changes += [new - old for new, old in zip(bounds(tables, kept.key), (kept.low, kept.high), strict=True)]
        given, stored = (f"{shown.value:.5g} ± {shown.error:.3g} {kept.unit}".rstrip() for shown in (row, kept))
        place = f"{stored}; the fit gives {given}"
        drift = max(map(abs, changes)) / kept.error
        yield judged(where, file.law, kept.key, drift, tolerance("calibration", "stored"), place)


INTRODUCTION = (
    "Each contact law is fitted to the numbers that the paper quotes, by least squares over the exact motion: Young's "
    "modulus, the dissipation, the strikes of Table 1 and, common to all numbers, the scales of force and speed and "
    f"the cut at which durations are read. A fit holds if its probability is at least {MIN_PROBABILITY:g}."
)
CUT_TEXT = (
    "The paper does not state the share of the peak at which durations are read. Fits of the "
    f"{VISCOELASTIC} law without electronics, with standard errors of the restitution; with cuts above 10 % the wall "
    "of Fig. 5 shows no third maximum:"
)
NUMBERS_TEXT = (
    "Fitted value, its deviation in standard errors, and in brackets chi-square without this number, by the "
    "sensitivities at the minimum. "
)


def shown(tables: Tables, cuts: Sequence[Sequence[str]]) -> list[Shown]:
    """Tables of the page: fits of the default reading, cuts, fits of all readings with the choices, all numbers."""
    fits = tables[LAWS]
    choices = " ".join(
        f"{question}: {'; '.join(f'{answer.name} ({answer.because})' for answer in answers)}."
        for question, answers in calibration_file().choice.items()
    )
    default, others = fits[fits["data"] == DEFAULT], fits[fits["data"] != DEFAULT]
    remarks = " ".join(f"{row.law}: {row.remarks}." for row in rows_of(default) if row.remarks)
    headings = ["cut", "chi-square", "degrees of freedom", "probability", "restitution"]
    every = (
        "Where the paper can be read in several ways, each is fitted, from the parameters of the default reading and "
        "of the laws before. The residuals of fits that do not hold have kinks, and many minima: chi-square of such a "
        f"fit may be too high by a quarter. The first answers are the default. {choices}"
    )
    return [
        Shown("", INTRODUCTION, _fits_table(tables, default).drop(columns="reading")),
        Shown("The cut at which durations are read", CUT_TEXT, pd.DataFrame(cuts, columns=headings)),
        Shown("All readings of the paper", every, _fits_table(tables, others)),
        Shown("All numbers, and limits of the fits", NUMBERS_TEXT + remarks, _numbers_table(tables)),
    ]


def _fits_table(tables: Tables, fits: pd.DataFrame) -> pd.DataFrame:
    """Law, reading, parameters, goodness and missed numbers of some fits, as texts."""
    rows = []
    for row in rows_of(fits):
        found = parameters_of(tables, row.law, row.data).values()
        names = [one.parameter.rpartition(".")[2].replace("_", " ").replace("youngs", "Young's") for one in found]
        texts = "; ".join(f"{name} {value_text(one)}" for name, one in zip(names, found, strict=True))
        verdict = "reproduced fits" if row.probability >= MIN_PROBABILITY else "differs does not fit"
        goodness = f"{verdict}\n{row.chi_square:.1f} of {row.freedom}, probability {row.probability:.2g}"
        missed = "; ".join(name_of(*label.split(": ")) for label in row.missed.split("; ") if label)
        rows.append((row.law, row.data, texts, goodness, missed or "–"))
    far = f"missed by more than {MAX_DEVIATION:g} standard errors"
    return pd.DataFrame(rows, columns=["law", "reading", "parameters", "chi-square", far])


def _numbers_table(tables: Tables) -> pd.DataFrame:
    """Measured numbers, and those of each law in the default reading with their deviations, as texts."""
    data = numbers(tables[DATA].query("data == @DEFAULT"))
    data["measured"] = [f"{row.measured:.4g} ± {row.error:.2g} {row.unit}" for row in rows_of(data)]
    left_out = [f" ({each:.1f})" if np.isfinite(each) else "" for each in data["chi_square_without"]]
    texts = [f"{row.fitted:.4g}\n{row.off:+.1f}{without}" for row, without in zip(rows_of(data), left_out, strict=True)]
    table = data.assign(text=texts).set_index(["number", "measured", "law"])["text"].unstack("law", sort=False)
    return table.reset_index().rename_axis(columns=None)
