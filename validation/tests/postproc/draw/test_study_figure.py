"""Figures of studies: labels, legends for any set of engines, many curves, gaps, no panel without values."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.batch.study import column_name, read_study
from drivers.scene.settings import unit_of
from postproc.draw.product import Product
from postproc.draw.study_figure import draw_study, draw_tornado
from postproc.draw.style import COLUMN_IN, PAGE_IN, pyplot, value_colours
from postproc.read.labels import Label, key_label, observable_label
from postproc.read.observables import OBSERVABLES, PLACEHOLDERS
from validation.tests.helpers.drawn import not_in_table, out_of_bounds

KEYS = {
    "striker.speed": "striker.speed",
    "striker.mass": "striker.mass",
    "wall.material": "wall.material",
    "ptfe_modulus": "materials.ptfe.youngs_modulus",
    "seed": "seed",
}
PEAK, SPEED, MISSING = "wall_peak_N", "speed_9_to_5_m_s", "bead_5_reflected_arrival_s"


def _table(engines: tuple[str, ...], **axes: list[float]) -> pd.DataFrame:
    """Table of a finished study over a grid of axes, with a power law for each observable."""
    grid = pd.MultiIndex.from_product([*axes.values()], names=list(axes)).to_frame(index=False)
    tables = []
    for place, engine in enumerate(engines):
        size = (1 + 1e-3 * place) * grid.prod(axis=1) ** 0.2
        numbers: dict[str, Any] = {
            "status": "done",
            "reason": "",
            "force_error_share": 0.0,
            PEAK: size,
            SPEED: 100 * size,
            MISSING: np.nan,
        }
        tables.append(grid.assign(engine=engine, **numbers).rename_axis("case").reset_index())
    table: pd.DataFrame = pd.concat(tables).sort_values("case", kind="stable")
    table["case"] += 1
    return table


def _draw(table: pd.DataFrame, *observables: str, draw: Any = draw_study) -> Product:
    labels = {column_name(name, key): key_label(name, key) for name, key in KEYS.items()}
    product: Product = draw(table, "The study's own title", observables, "study.toml", labels)
    assert product.figure.get_suptitle() == "The study's own title"
    assert out_of_bounds(product.figure, (COLUMN_IN, PAGE_IN)) == []
    return product


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    pyplot().close("all")


def _legend(product: Product) -> list[str]:
    (legend,) = product.figure.legends
    return [text.get_text() for text in legend.get_texts()]


SPEEDS = {"striker.speed_m_s": [0.05, 0.5, 5.0]}
MODULI = {"ptfe_modulus_Pa": [6e8, 1.46e9]}


@pytest.mark.parametrize(
    "engines", [("reference", "liggghts", "yade"), ("liggghts", "yade"), ("yade",), ("reference",)]
)
def test_a_study_has_a_legend_for_any_set_of_engines(engines: tuple[str, ...]) -> None:
    product = _draw(_table(engines, **SPEEDS, **MODULI), PEAK, SPEED)
    moduli = ["Young's modulus of ptfe 0.6 GPa", "Young's modulus of ptfe 1.46 GPa"]
    assert _legend(product) == [*moduli, *(engine for engine in engines if engine != "reference")]
    assert _legend(_draw(_table(engines, **SPEEDS), PEAK)) == [*engines]
    assert not_in_table(product.figure, product.table) == []


def test_axes_have_labels_with_units() -> None:
    product = _draw(_table(("reference", "yade"), **SPEEDS, **MODULI), PEAK, SPEED)
    assert [axis.get_xlabel() for axis in product.figure.axes] == ["striker speed (m/s)"] * 2
    found = [axis.get_ylabel().replace("\n", " ") for axis in product.figure.axes]
    assert found == ["peak force at the wall (N)", "wave speed from bead 9 to 5 (m/s)"]
    assert all(axis.get_xscale() == "log" for axis in product.figure.axes)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_there_is_a_panel_for_each_observable_with_values_and_no_other(count: int) -> None:
    product = _draw(_table(("reference",), **SPEEDS), *(PEAK, SPEED, MISSING)[:count])
    assert len(product.figure.axes) == min(count, 2)
    assert list(product.notes) == [f"{MISSING}: no panel, since no run shows it"] * (count == 3)
    assert all(axis.get_visible() and axis.lines for axis in product.figure.axes)
    with pytest.raises(InputError, match="a finished case"):
        _draw(_table(("reference",), **SPEEDS), MISSING)


def test_draws_with_an_axis_are_points_around_their_mean() -> None:
    product = _draw(_table(("liggghts", "yade"), **SPEEDS, seed=[1, 2, 3, 4]), PEAK)
    (axis,) = product.figure.axes
    line = next(line for line in axis.lines if line.get_label() == "mean of draws, liggghts")
    own = product.table[product.table["engine"] == "liggghts"]
    assert np.unique(line.get_ydata()) == pytest.approx(
        np.sort(own.groupby("striker.speed_m_s")[PEAK].mean()), rel=1e-12
    )
    assert not_in_table(product.figure, product.table) == []


def test_draws_alone_are_counted() -> None:
    product = _draw(_table(("reference", "yade"), seed=[*range(1, 31)]), PEAK)
    (axis,) = product.figure.axes
    (stairs,) = axis.patches
    assert stairs.get_data().values.sum() == 30
    assert axis.lines[0].get_ydata().sum() == 30
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("peak force at the wall (N)", "draws")
    assert _legend(product) == ["reference", "yade"]


def test_a_tornado_chart_labels_its_inputs() -> None:
    table = _table(("reference",), **{"striker.speed_m_s": [1.0, 1.01], "ptfe_modulus_Pa": [1e9, 1.01e9]}).iloc[:3]
    product = _draw(table, PEAK, draw=draw_tornado)
    (axis,) = product.figure.axes
    assert {text.get_text() for text in axis.get_yticklabels()} == {"striker speed", "Young's modulus of ptfe"}
    assert axis.get_xlabel().replace("\n", " ") == "change of the peak force at the wall (%)"
    assert _legend(product) == ["input +1 %"]


def test_every_observable_and_every_key_of_a_shipped_study_has_a_label() -> None:
    samples = {"gauge": "bead_9", "level": "0.2pct", "number": "2", "pair": "9_to_5"}
    assert set(samples) == set(PLACEHOLDERS)
    for observable in OBSERVABLES:
        label = observable_label(observable.pattern.format(**samples) + observable.ending)
        assert label.unit == observable.unit
        assert " " in label.words
        assert not set("_{}") & set(label.words)
    for path in paths.STUDIES.glob("*.toml"):
        study = read_study(path)
        for name, key in study.columns.items():
            label = key_label(name, key)
            assert not set("._") & set(label.words), (path, name)
            assert label.unit == unit_of(key)


@pytest.mark.parametrize(
    ("unit", "largest", "expected", "factor"),
    [("s", 4.5e-4, "x (µs)", 1e6), ("Pa", 1.46e9, "x (GPa)", 1e-9), ("N", 0.5, "x (N)", 1), ("kg", 1e-4, "x (g)", 1e3),
     ("m/s", 1e-3, "x (m/s)", 1), ("m/s^2", 9.81, "x (m/s²)", 1), ("", 5, "x", 1), ("m", 0.0, "x (m)", 1)],
)  # fmt: skip
def test_an_axis_has_a_handy_unit(unit: str, largest: float, expected: str, factor: float) -> None:
    words, found = Label("x", unit).axis(largest)
    assert words == expected
    assert found == pytest.approx(factor, rel=1e-15)


def test_a_value_is_short_and_has_its_unit() -> None:
    assert Label("", "s").value(1.23456e-5) == "12.35 µs"
    assert Label("", "").value(0.05) == "0.05"
    assert Label("", "").value("rigid") == "rigid"
    assert key_label("material", "chain.material") == Label("material", "")
    assert key_label("chain.material", "chain.material") == Label("bead material", "")


@pytest.mark.parametrize("draw", [draw_study, draw_tornado])
@pytest.mark.parametrize(("observables", "words"), [(["wall_pea"], "wall_pea"), ([PEAK, PEAK], "an observable twice")])
def test_observables_are_known_and_given_once(observables: list[str], words: str, draw: Any) -> None:
    with pytest.raises(InputError, match=words):
        _draw(_table(("reference",), **SPEEDS), *observables, draw=draw)


def test_text_values_can_be_varied() -> None:
    table = _table(("reference", "yade"), **SPEEDS).rename(columns={"striker.speed_m_s": "wall.material"})
    table["wall.material"] = table["wall.material"].map({0.05: "ptfe", 0.5: "brass", 5.0: "rigid"})
    product = _draw(table, PEAK)
    (axis,) = product.figure.axes
    assert [text.get_text() for text in axis.get_xticklabels()] == ["ptfe", "brass", "rigid"]
    assert axis.get_xlabel() == "wall material"


SPEED_RANGE = {"striker.speed_m_s": [float(speed) for speed in range(1, 42)]}


def _curves(axis: Any) -> list[Any]:
    return [line for line in axis.lines if line.get_linestyle() != "None" and len(line.get_xdata())]


@pytest.mark.parametrize(("last", "scale"), [(20.0, "linear"), (400.0, "log")])
def test_many_curves_are_coloured_by_value_with_a_bar(last: float, scale: str) -> None:
    moduli = [float(value) for value in np.geomspace(1e8, last * 1e8, 40)]
    product = _draw(_table(("reference", "yade"), **SPEED_RANGE, ptfe_modulus_Pa=moduli), PEAK, SPEED)
    first, second, bar = product.figure.axes
    assert bar.get_ylabel() == "Young's modulus of ptfe (GPa)"
    assert bar.get_yscale() == scale
    assert bar.get_ylim() == pytest.approx((0.1, 0.1 * last), rel=1e-12)
    assert _legend(product) == ["reference", "yade"]
    for axis in (first, second):
        shares = np.log(moduli) if scale == "log" else np.array(moduli)
        expected = value_colours()((shares - shares[0]) / np.ptp(shares))
        assert [line.get_color() for line in _curves(axis)] == pytest.approx(expected, abs=0.02)
    assert not_in_table(product.figure, product.table) == []


def test_colours_of_values_are_dark_enough_on_white_and_get_brighter() -> None:
    parts = value_colours()(np.linspace(0, 1, 50))[:, :3]
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()
    assert 1.05 / (luminance.max() + 0.05) > 3


@pytest.mark.parametrize("columns", [1, 3])
def test_many_text_values_have_a_legend_of_short_entries(columns: int) -> None:
    table = _table(("reference", "yade"), **SPEED_RANGE, **{"wall.material": [1 + place / 100 for place in range(40)]})
    names = {value: f"polymer {place}" for place, value in enumerate(dict.fromkeys(table["wall.material"]))}
    table["wall.material"] = table["wall.material"].map(names)
    product = _draw(table, *(PEAK, SPEED)[:columns])
    (legend,) = product.figure.legends
    assert legend.get_title().get_text() == "wall material"
    assert _legend(product) == [*names.values(), "yade"]
    looks = [(*line.get_color(), str(line.get_linestyle())) for line in _curves(product.figure.axes[0])]
    assert len(set(looks)) == 40
    assert legend.get_window_extent().width <= product.figure.bbox.width


def test_many_curves_of_two_other_columns_are_all_listed() -> None:
    moduli, masses = [1e9 + place * 1e8 for place in range(10)], [1e-4, 2e-4, 4e-4, 8e-4]
    table = _table(("reference",), **SPEED_RANGE, ptfe_modulus_Pa=moduli, **{"striker.mass_kg": masses})
    product = _draw(table, PEAK)
    (axis,) = product.figure.axes
    assert _legend(product)[:5] == ["1 GPa, 0.1 g", "1 GPa, 0.2 g", "1 GPa, 0.4 g", "1 GPa, 0.8 g", "1.1 GPa, 0.1 g"]
    assert len(set(_legend(product))) == 40
    assert product.figure.legends[0].get_title().get_text() == "Young's modulus of ptfe, striker mass"
    assert len({(*line.get_color(), str(line._dash_pattern)) for line in _curves(axis)}) == 40


def test_lines_have_gaps_and_points_between_gaps_are_marked() -> None:
    table = _table(("reference",), **{"striker.speed_m_s": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})
    table.loc[table["striker.speed_m_s"].isin([2.0, 4.0]), PEAK] = np.nan
    product = _draw(table, PEAK, SPEED)
    gaps, whole = (_curves(axis)[0] for axis in product.figure.axes)
    assert list(np.isnan(gaps.get_ydata())) == [False, True, False, True, False, False]
    assert (gaps.get_marker(), gaps.get_markevery()) == ("o", [0, 2])
    assert whole.get_marker() == "None"
    assert [axis.get_title(loc="right") for axis in product.figure.axes] == ["not seen in 2 of 6 runs", ""]
    assert product.figure.axes[0].get_xlim() == product.figure.axes[1].get_xlim()


def test_histograms_and_tornado_charts_count_the_runs_that_do_not_show_an_observable() -> None:
    table = _table(("reference",), seed=[*range(1, 31)])
    table.loc[table["seed"] <= 4, PEAK] = np.nan
    (axis,) = _draw(table, PEAK).figure.axes
    assert axis.get_title(loc="right").endswith("\nnot seen in 4 of 30 runs")
    table = _table(("reference",), **{"striker.speed_m_s": [1.0, 1.01, 1.02]})
    table.loc[table["case"] == 3, PEAK] = np.nan
    product = _draw(table, PEAK, MISSING, draw=draw_tornado)
    assert product.figure.axes[0].get_title(loc="right") == "not seen in 1 of 3 runs"
    assert list(product.notes) == [f"{MISSING}: no panel, since no run shows its change"]


@pytest.mark.parametrize("count", [5, 40, 100])
def test_ticks_of_texts_do_not_overlap(count: int) -> None:
    table = _table(("reference",), **{"wall.material": [float(place) for place in range(1, count + 1)]})
    names = [f"{'a long name of a ' * (place == 1)}polymer {place}" for place in range(count)]
    table["wall.material"] = names
    product = _draw(table, PEAK, SPEED)
    for axis in product.figure.axes:
        boxes = [text.get_window_extent() for text in axis.get_xticklabels() if text.get_text()]
        assert len(boxes) > 4
        assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))


def test_a_removed_key_is_a_curve_of_its_own() -> None:
    table = _table(("reference",), **SPEED_RANGE, ptfe_modulus_Pa=[1e9, 2e9])
    table.loc[table["ptfe_modulus_Pa"] == 1e9, "ptfe_modulus_Pa"] = np.nan
    assert _legend(_draw(table, PEAK)) == ["Young's modulus of ptfe none", "Young's modulus of ptfe 2 GPa"]
