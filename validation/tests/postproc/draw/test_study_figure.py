"""Figures of studies: curves of observables, a column against another with power laws, histograms, tornado charts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.batch.study import column_name, read_study
from drivers.scene.settings import unit_of
from postproc.draw.plot import COLUMN_IN, PAGE_IN, Product, pyplot
from postproc.draw.study_figure import Label, draw_study, draw_tornado, key_label, observable_label
from postproc.read.observables import OBSERVABLES
from validation.tests.helpers.commands import beads
from validation.tests.helpers.drawn import not_in_table, out_of_bounds
from validation.tests.helpers.scenes import SPEEDS, StudyWriter

KEYS = {
    "striker.speed": "striker.speed",
    "wall.material": "wall.material",
    "ptfe_modulus": "materials.ptfe.youngs_modulus",
    "seed": "seed",
}
PEAK, SPEED, MISSING = "wall_peak_N", "speed_9_to_5_m_s", "bead_5_reflected_arrival_s"
X, Y = "bead_5_amplitude_N", SPEED
STRIKER, MODULUS = "striker.speed_m_s", "ptfe_modulus_Pa"
THREE_SPEEDS = {STRIKER: [0.05, 0.5, 5.0]}


def _table(*engines: str, **axes: list[Any]) -> pd.DataFrame:
    """Table of a finished study over a grid of axes, with a power law for each observable; without engines exact."""
    grid = pd.MultiIndex.from_product([*axes.values()], names=list(axes)).to_frame(index=False)
    tables = []
    for place, engine in enumerate(engines or ("reference",)):
        size = (1 + 1e-3 * place) * grid.select_dtypes("number").prod(axis=1) ** 0.2
        numbers: dict[str, Any] = {"status": "done", "reason": "", "force_error_share": 0.0}
        numbers |= {PEAK: size, SPEED: 100 * size, MISSING: np.nan}
        tables.append(grid.assign(engine=engine, **numbers).rename_axis("case").reset_index())
    table: pd.DataFrame = pd.concat(tables).sort_values("case", kind="stable", ignore_index=True)
    table["case"] += 1
    return table


def _related() -> pd.DataFrame:
    """Table of 12 speeds with ``y = 3 x^(1/6)`` on the reference and ``y = 4 x^(1/6)`` on YADE."""
    table = _table("reference", "yade", **{STRIKER: [*np.geomspace(0.1, 10, 12)]})
    table[X] = 2 * table[STRIKER] ** 1.2
    return table.assign(**{Y: table["engine"].map({"reference": 3, "yade": 4}) * table[X] ** (1 / 6)})


def _draw(table: pd.DataFrame, *observables: str, draw: Any = draw_study, **how: Any) -> Product:
    labels = {column_name(name, key): key_label(name, key) for name, key in KEYS.items()}
    product: Product = draw(table, "A study", observables, "study.toml", labels, **how)
    assert product.figure.get_suptitle() == "A study"
    assert out_of_bounds(product.figure, (COLUMN_IN, PAGE_IN)) == []
    return product


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    pyplot().close("all")


def _legend(product: Product) -> list[str]:
    (legend,) = product.figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_panels_are_the_observables_with_values_and_the_legend_has_any_set_of_engines() -> None:
    for engines in (("reference", "liggghts", "yade"), ("yade",)):
        product = _draw(_table(*engines, **THREE_SPEEDS, ptfe_modulus_Pa=[6e8, 1.46e9]), PEAK, SPEED, MISSING)
        assert _legend(product) == ["0.6 GPa", "1.46 GPa", *engines]
        assert product.figure.legends[0].get_title().get_text() == "Young's modulus of ptfe"
        assert not_in_table(product.figure, product.table) == []
        axes = product.figure.axes
        assert [axis.get_ylabel()[-5:] for axis in axes] == ["l (N)", "(m/s)"]
        assert {axis.get_xlabel() for axis in axes} == {"striker speed (m/s)"}
        assert list(product.notes) == [f"{MISSING}: no panel, since no run shows it"]
    for observables, message in [
        ([MISSING], "a finished case"), (["wall_pea"], "wall_pea"), ([], "no observables"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            _draw(_table(**THREE_SPEEDS), *observables)


def test_draws_with_an_axis_are_points_around_their_mean() -> None:
    product = _draw(_table("liggghts", "yade", **THREE_SPEEDS, seed=[1, 2, 3, 4]), PEAK)
    (axis,) = product.figure.axes
    assert _legend(product)[0] == "mean of draws, liggghts"
    line = axis.lines[0]
    rows = product.table[product.table["engine"] == "liggghts"]
    means = np.sort(rows.groupby(STRIKER)[PEAK].mean())
    assert np.unique(line.get_ydata()) == pytest.approx(means, rel=1e-12)
    assert not_in_table(product.figure, product.table) == []


def test_draws_alone_are_counted_and_those_without_the_observable_too() -> None:
    table = _table("reference", "yade", seed=[*range(1, 31)])
    table.loc[table["seed"] <= 4, PEAK] = np.nan
    (axis,) = _draw(table, PEAK).figure.axes
    edges = np.histogram_bin_edges(table[PEAK].dropna(), 15)
    for patch, engine in zip(axis.patches, ("reference", "yade"), strict=True):
        counts, _ = np.histogram(table[PEAK][table["engine"] == engine].dropna(), edges)
        assert patch.get_xy()[1:-1:2, 1] == pytest.approx(counts)
    assert axis.get_title(loc="right").endswith("\nnot seen in 8 of 60 runs")


def test_a_tornado_chart_has_the_elasticities_and_counts_runs_without_the_observable() -> None:
    table = _table(**{STRIKER: [1.0, 1.01], MODULUS: [1e9, 1.01e9]}).iloc[:3]
    product = _draw(table, PEAK, draw=draw_tornado)
    (axis,) = product.figure.axes
    assert product.table["elasticity"].to_numpy() == pytest.approx(0.2, rel=5e-3)
    assert sorted(bar.get_width() for bar in axis.patches) == pytest.approx([100 * (1.01**0.2 - 1)] * 2)
    assert _legend(product) == ["input +1 %"]
    table.loc[table["case"] == 3, PEAK] = np.nan
    product = _draw(table, PEAK, MISSING, draw=draw_tornado)
    assert product.figure.axes[0].get_title(loc="right") == "not seen in 1 of 3 runs"
    assert list(product.notes) == [f"{MISSING}: no panel, since no run shows its change"]


def test_labels_have_the_units_of_observables_and_keys_and_axes_handy_ones() -> None:
    samples = {"gauge": "bead_9", "level": "0.2pct", "number": "2", "pair": "9_to_5"}
    for observable in OBSERVABLES:
        label = observable_label(observable.pattern.format(**samples) + observable.ending)
        assert label.unit == observable.unit
        assert not set("_{}") & set(label.words)
    for path in paths.STUDIES.glob("*.toml"):
        for name, key in read_study(path).columns.items():
            assert key_label(name, key).unit == unit_of(key), (path, name)
    for unit, largest, words, factor in [
        ("s", 4.5e-4, "x (µs)", 1e6), ("Pa", 1.46e9, "x (GPa)", 1e-9), ("N", 0.5, "x (mN)", 1e3),
        ("kg", 2.0, "x (g)", 1e3), ("m/s", 200.0, "x (m/s)", 1),
    ]:  # fmt: skip
        shown, by = Label("x", unit).axis(pd.Series([largest, -largest / 2]))
        assert (shown, round(by / factor, 12)) == (words, 1)


@pytest.mark.parametrize("count", [3, 6, 40])
def test_curves_differ_in_colour_and_line_and_the_legend_leaves_them_alone(count: int) -> None:
    axes = {STRIKER: [*np.linspace(1.0, 50.0, 50)], MODULUS: [*np.geomspace(1e8, 4e10, count)]}
    product = _draw(_table("reference", "yade", **axes), PEAK)
    (axis,), (legend,) = product.figure.axes, product.figure.legends
    curves = [line for line in axis.lines if len(line.get_xydata()) and line.get_linestyle() != "None"]
    assert len({line.get_color()[:3].tobytes() for line in curves}) == count
    assert len({(line.get_linestyle(), line.get_marker()) for line in curves[:6]}) == (count if count < 8 else 1)
    assert len(_legend(product)) <= 8 + 2
    assert not legend.get_window_extent().overlaps(axis.get_tightbbox())
    assert ("one in 5" in legend.get_title().get_text()) == (count == 40)
    assert not_in_table(product.figure, product.table) == []


def test_lines_have_gaps_and_points() -> None:
    table = _table(**{STRIKER: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})
    table.loc[table[STRIKER].isin([2.0, 4.0]), PEAK] = np.nan
    product = _draw(table.assign(**{MISSING: 1e-6 * table[STRIKER]}), PEAK, MISSING)
    gaps, whole = (axis.lines[0] for axis in product.figure.axes)
    assert whole.get_ydata() == pytest.approx(table[STRIKER].to_numpy())  # in microseconds
    assert list(np.isnan(gaps.get_ydata())) == [False, True, False, True, False, False]
    assert (gaps.get_marker(), gaps.get_linestyle()) == ("o", "-")
    assert [axis.get_title(loc="right") for axis in product.figure.axes] == ["not seen in 2 of 6 runs", ""]


def test_each_engine_has_points_at_its_rows_that_are_above_zero_on_logarithmic_axes() -> None:
    table = _related()
    lines = _draw(table, Y, x=X).figure.axes[0].lines
    for line, (_, rows) in zip(lines, table.groupby("engine"), strict=False):
        assert line.get_xydata() == pytest.approx(rows[[X, Y]].to_numpy(), rel=1e-12)
    table.loc[[0, 3], Y] = 0.0
    table.loc[[5, 7], X] = [np.nan, -1.0]
    product = _draw(table, Y, x=X, log=True)
    assert list(product.notes) == ["3 rows are not above zero, so not on logarithmic axes"]
    assert list(product.table.columns) == ["case", STRIKER, "engine", X, Y]
    assert len(product.table) == 24 - 4
    assert product.figure.axes[0].get_title(loc="right") == "not seen in 1 of 24 runs"


def test_power_laws_are_those_of_least_squares_and_say_what_is_left_out() -> None:
    table = _related()
    reference, yade = table["engine"] == "reference", table["engine"] == "yade"
    table.loc[reference, Y] *= np.exp(np.random.default_rng(1).normal(0, 0.05, 12))
    table.loc[table.index[reference][:2], Y] = [np.nan, -1.0]
    table.loc[table.index[yade][1], "status"] = "failed"
    product = _draw(table, Y, x=X, fitted=True)
    x, y = np.log(table.loc[reference, [X, Y]].iloc[2:].to_numpy()).T
    slope, start = np.polyfit(x, y, 1)
    first, second = product.notes
    assert first.startswith(f"reference: {Y} = {np.exp(start):.4g} x^{slope:.4g}, ")
    assert first.endswith(" (10 rows; 2 left out, not seen or not above zero)")
    assert second.startswith(f"yade: {Y} = 4 x^0.1667, exponent 0.1667 ± ")
    assert "; holds from" in second
    assert _legend(product) == [f"reference: x^{slope:.4g}", "yade"]
    law = product.figure.axes[0].lines[3]
    assert law.get_ydata() == pytest.approx(4 * law.get_xdata() ** (1 / 6), rel=1e-9)
    bent = table.assign(**{Y: np.exp(0.2 * np.log(table[X]) - 0.01 * np.log(table[X]) ** 2)})
    note = _draw(bent, Y, x=X, fitted=True).notes[0]
    low, high = (0.2 - 0.02 * np.log(table.loc[reference, X].iloc[[0, -1]])).map("{:.4g}".format)
    assert ", curvature -0.01 ± " in note
    assert f"; bends: exponent from {low} at 0.126 to {high} at 31.7, within its error from " in note
    for changed, message in [(_related().iloc[:4], "found reference has 2 values"), (table.assign(**{X: 1.0}), X)]:
        with pytest.raises(InputError, match=message):
            _draw(changed, Y, x=X, fitted=True)


WRONG = {
    "--x striker.speed": "--x: needs --y",
    "--power-law --y wall_peak": "--y: needs --x",
    "--log": "--log: needs --x",
    "--x striker.sped --y wall_peak": '--x: found "striker.sped"; allowed: columns: case, striker.speed_m_s',
    "--x wall.material --y wall_peak --log": '--x: found "wall.material"; allowed: columns: case, ',
}


def test_the_command_draws_a_relation_under_a_name_of_its_own(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = SPEEDS.format(2) + '[[axis]]\nkey = "wall.material"\nvalues = ["brass"]'
    path, results = study_file(axes, "reference", top='figure = ["wall_peak_N"]'), tmp_path / "results"
    folders = ("--runs", tmp_path / "runs", "--results", results)
    assert beads("batch", path, *folders).returncode == 0
    before = {*results.iterdir()}
    done = beads(
        "study",
        path,
        "--runs",
        tmp_path / "runs",
        "--results",
        results,
        "--x",
        "striker.speed",
        "--y",
        "wall_peak_N",
        "--log",
    )
    assert (done.returncode, done.stderr) == (0, "")
    new = {file.name for file in {*results.iterdir()} - before}
    assert new == {f"study-wall_peak_N-{STRIKER}-xy.{end}" for end in ("csv", "png", "svg")}
    for options, message in WRONG.items():
        done = beads("study", path, *folders, *options.split())
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), options
        assert message in done.stderr, options
