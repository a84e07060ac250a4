"""``beads fit``: fit parameters of scenes to measured data, compare laws, and check the fitted scene with codes."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.terminal import counted, text_table
from drivers.chain.case import build_case
from drivers.engines import codes
from drivers.limits import inability
from drivers.scene.read_scene import read_scene
from drivers.scene.settings import setting_texts
from validation.calibration.fit import (
    DATA,
    DECISIVE,
    EXACT,
    LAWS,
    LEANING,
    PARAMETERS,
    RISES,
    Fit,
    Tables,
    digits,
    rounded,
    rows_of,
    solve,
    suited,
    taken_as_exact,
    value_text,
    with_error,
)
from validation.calibration.folder import FitRequest, Fitted, folder_of, problems_of, request_of, write_folder
from validation.calibration.predict import named, of_own_scene, predicted, rows_to_print
from validation.compare.comparison import EngineSelection, compare_scenes

PREDICTIONS = "predictions"
MAX_EXACT = 8  # printed numbers that are taken as exact
LEAST_CHANGE = 0.1  # standard errors by 1 % of such a number: smaller ones are in the table alone


def fit(
    *scenes: str | Path, settings: Mapping[str, Any] | None = None, results: str | Path | None = None, **options: Any
) -> Fitted:
    """Fit as ``beads fit`` does, without a check by codes.

    Args:
        scenes: Names or files of scenes with measured data, or the folder of a fit.
        settings: Values that replace those of the scenes, by key, as for ``drivers.run_scene``.
        results: Folder of the fit's folder; by default ``results/`` of the checkout.
        options: ``free``, ``own``, ``laws``, ``uncertain``, ``predict``, ``quoted``: sequences of texts, as after the
            options of the command; ``measured``: a Path; ``quick``: True to omit profiles and left-out data.

    Raises:
        InputError: The request has errors.
        RunError: The exact motion cannot be computed.

    Examples:
        >>> found = fit("example-measured", free=["contact.restitution"], quick=True, results=folder)
        >>> found.tables["parameters"].loc[0, "parameter"]
        'contact.restitution'
    """
    asked = {key: tuple(value) if isinstance(value, (list, tuple)) else value for key, value in options.items()}
    request = request_of(scenes, settings=setting_texts(settings or {}), **asked)
    return fit_request(request, Path(results or paths.RESULTS))


def fit_request(request: FitRequest, results: Path) -> Fitted:
    """Fit each law and write the folder of the fit.

    Raises:
        InputError: The request has errors.
        RunError: The exact motion cannot be computed.
    """
    problems, fits, of_laws = problems_of(request), dict[str, Fit](), list[Tables]()
    problem, folder = next(iter(problems.values())), folder_of(request, results)
    with counted(f"fit of {len(problem.free)} parameter{'s' * (len(problem.free) > 1)} to {problem.rows} readings"):
        for law, each in problems.items():  # each fit also starts from the earlier ones: a larger model is never worse
            seeds, names = [found.values for found in fits.values()], ", ".join(data.name for data in each.sets)
            fits[law], tables = solve(each, law, names, quick=request.quick, seeds=seeds)
            of_laws.append(tables | {EXACT: taken_as_exact(fits[law]).assign(law=law)})
    whole = {name: pd.concat([each[name] for each in of_laws], ignore_index=True) for name in of_laws[0]}
    fitted = Fitted(folder, request, fits, whole)
    whole[PREDICTIONS] = pd.concat([_of_data_set(fitted, place) for place in range(len(problem.sets))])
    write_folder(fitted)
    return fitted


def _of_data_set(fitted: Fitted, place: int) -> pd.DataFrame:
    """Observables of waves, and those asked for, of the scene of a data set."""
    asked, data = fitted.request.predict, next(iter(fitted.fits.values())).problem.sets[place]
    found = predicted(fitted, lambda fit: of_own_scene(fit, fit.problem.sets[place], asked))
    found.observables.insert(0, "data_set", data.name)
    return named(found.observables, asked, data.where)


def run_fit(request: FitRequest, runs: Path, results: Path) -> int:
    """Fit, print and write the results, and compare the fitted scenes on the codes; 1 if the comparison fails.

    Raises:
        InputError: The request has errors.
    """
    fitted = fit_request(request, results)
    best = min(fitted.fits, key=lambda law: fitted.fits[law].aic)
    try:
        return 0 if request.quick or not fitted.scenes(best) else _confirm(fitted.scenes(best), runs)
    finally:  # last, so that it stays on screen, also after a failed run
        for law, found in fitted.fits.items():
            own = {name: table[table["law"] == law] for name, table in fitted.tables.items() if "law" in table}
            print(*([f"--- {law} ---"] * bool(law)), *lines(found, own), "", *exact_lines(own[EXACT]), "", sep="\n")
        predictions = text_table(rows_to_print(fitted.tables[PREDICTIONS])) if request.predict else ()
        print(*comparison(fitted), *predictions, paths.shown(fitted.folder), sep="\n", flush=True)


def _confirm(fitted: Sequence[Path], runs: Path) -> int:
    """Compares fitted scenes on all engines, or on the in-repo engines if no code has their contact law."""
    cases = [build_case(read_scene(path)) for path in fitted]
    modelled = any(inability(case, code) is None for case in cases for code in codes())
    if not modelled:
        print("no code has this contact law: only in-repo engines check the fitted scene")
    return compare_scenes(
        [str(path) for path in fitted], (), runs, EngineSelection(allow_missing=not modelled), unsafe=False, brief=True
    )


def lines(fit: Fit, tables: Tables) -> Iterator[str]:
    """Lines of text with parameters, data and remarks."""
    rows = []
    for row in rows_of(tables[PARAMETERS]):
        ends, unit = digits(
            (row.low_68pct, row.high_68pct, row.low_95pct, row.high_95pct), row.value, row.error, row.unit
        )
        intervals = [
            f"{low} .. {high} {unit}".rstrip() if isfinite(row.error) else "" for low, high in (ends[:2], ends[2:])
        ]
        start = with_error(row.start, row.prior, row.unit) if row.prior else rounded(row.start, row.unit)
        rows.append([row.parameter, value_text(row, fit.enlargement), *intervals, start])
    yield from text_table([["parameter", "value", *(f"{rise} interval" for rise in RISES), "start"], *rows])
    if fit.enlargement != 1:
        times = f"enlarged {fit.enlargement:.2g} times"
        yield f"errors (not intervals) are {times}, since the data scatter more than noise explains"
    yield ""
    rows = [["datum", "measured", "fitted", "deviation in standard errors"]]
    for row in rows_of(tables[DATA]):
        number = [f"{row.measured:.4g} ± {row.error:.2g}", f"{row.fitted:.5g}"] if isfinite(row.measured) else ["", ""]
        rows.append([": ".join(filter(None, (row.data_set, row.datum))), *number, f"{row.off:.2f}"])
    yield from text_table(rows)
    yield ""
    (goodness,) = rows_of(tables[LAWS])
    chance = f", probability {goodness.probability:.2g}" if goodness.freedom > 0 else ""
    yield f"chi-square {goodness.chi_square:.4g} with {goodness.freedom} degrees of freedom{chance}"
    if not fit.explained:
        yield f"{goodness.law or 'the model'} does not explain the data"
    yield from goodness.remarks.split(". ") if goodness.remarks else ()


def exact_lines(exact: pd.DataFrame) -> list[str]:
    """Table of the numbers that are taken as exact, those of the largest effect on a parameter first."""
    exact = exact.assign(size=(exact["change_by_1pct"] / exact["error"]).abs())
    sizes = exact.groupby("key")["size"].max().sort_values(ascending=False)
    rows = [["taken as exact: 1 % would add", *exact["parameter"].unique()]]
    for key in sizes.index[sizes > LEAST_CHANGE][:MAX_EXACT]:
        scaled = [(row, *suited(row.change_by_1pct, row.unit)) for row in rows_of(exact[exact["key"] == key])]
        rows.append([key, *(f"{row.change_by_1pct * scale:+.2g} {unit}".rstrip() for row, scale, unit in scaled)])
    return text_table(rows) if len(rows) > 1 else []


def comparison(fitted: Fitted) -> Iterator[str]:
    """Lines on several laws: goodness of each, the best one, or those that remain with what would decide.

    Where no law explains the data, differences of AIC are divided by the best law's chi-square per degree of freedom.
    """
    if len(fitted.fits) < 2:
        return
    laws = fitted.tables[LAWS].sort_values("aic", kind="stable")
    laws["above"] = laws["aic"] - laws["aic"].min()
    columns = ["law", "chi_square", "freedom", "probability", "aic", "bic", "above"]
    yield from laws[columns].to_string(index=False, float_format="{:.5g}".format).splitlines()
    best, second = laws["law"].iloc[:2]
    excess = (laws["above"] / fitted.fits[best].enlargement ** 2).set_axis(laws["law"])
    near, equal = [*excess.index[excess < DECISIVE]], [*excess.index[excess < LEANING]]
    if len(near) == 1:
        yield f"{best} is the best law: the AIC of {second} is {excess[second]:.3g} higher"
    elif len(equal) > 1:
        yield f"undecided: the data do not distinguish {', '.join(near)} (AIC within {excess[near].max():.2g})"
    else:
        yield f"undecided, leaning to {best}: the AIC of {second} is {excess[second]:.2g} higher; {DECISIVE:g} decides"
    if len(near) > 1:
        decide = f"beads design {paths.shown(fitted.folder)} --vary striker.speed=LOW..HIGH"
        yield f"the experiment that decides: {decide}"
    yield ""
