"""Figures of studies: labels, legends for any set of engines, no panel without values."""

from collections.abc import Iterator
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
from postproc.draw.style import COLUMN_IN, PAGE_IN, pyplot
from postproc.read.labels import Label, key_label, observable_label
from postproc.read.observables import OBSERVABLES, PLACEHOLDERS
from validation.tests.helpers.drawn import not_in_table, out_of_bounds

KEYS = {
    "striker.speed": "striker.speed",
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
