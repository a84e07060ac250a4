"""A column of a study against another: axes, power laws, wrong input."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.batch.study import DERIVED
from postproc.draw.product import Product
from postproc.draw.study_figure import draw_study
from postproc.draw.style import COLUMN_IN, PAGE_IN, pyplot
from postproc.read.labels import key_label
from validation.tests.helpers.commands import beads
from validation.tests.helpers.drawn import out_of_bounds
from validation.tests.helpers.scenes import SPEEDS, StudyWriter

X, Y, SPEED = "bead_5_amplitude_N", "speed_9_to_5_m_s", "striker.speed_m_s"
MASS = "striker.mass_kg"


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    pyplot().close("all")


def _table(count: int = 12, engines: tuple[str, ...] = ("reference", "yade")) -> pd.DataFrame:
    """Table of a study with ``y = 3 x^(1/6)`` on the first engine and a little more on the others."""
    speeds = np.geomspace(0.1, 10, count)
    tables = []
    for place, engine in enumerate(engines):
        numbers: dict[str, Any] = {"case": range(1, count + 1), SPEED: speeds, "engine": engine, "status": "done"}
        numbers |= {"reason": "", "force_error_share": 0.0, X: 2 * speeds**1.2}
        tables.append(pd.DataFrame(numbers | {Y: (3 + place) * (2 * speeds**1.2) ** (1 / 6)}))
    return pd.concat(tables, ignore_index=True)


def _draw(table: pd.DataFrame, x: str = X, y: str = Y, **how: bool) -> Product:
    labels = {SPEED: key_label("striker.speed", "striker.speed"), MASS: key_label("striker.mass", "striker.mass")}
    product = draw_study(table, "Speed against force", (y,), f"--x {x} --y {y}", labels, x, **how)
    assert out_of_bounds(product.figure, (COLUMN_IN, PAGE_IN)) == []
    return product


def test_each_engine_has_points_at_its_rows() -> None:
    table = _table()
    product = _draw(table)
    (axis,) = product.figure.axes
    assert (axis.get_xlabel(), axis.get_xscale()) == ("force amplitude at bead 5 (N)", "log")
    assert axis.get_ylabel().replace("\n", " ") == "wave speed from bead 9 to 5 (m/s)"
    lines = {line.get_label(): line for line in axis.lines}
    for engine, rows in table.groupby("engine"):
        assert lines[engine].get_xydata() == pytest.approx(rows[[X, Y]].to_numpy(), rel=1e-12)
        assert lines[engine].get_marker() not in ("None", None)
    assert [lines[engine].get_linestyle() for engine in ("reference", "yade")] == ["-", "None"]
    assert list(product.table.columns) == ["case", SPEED, "engine", X, Y]


def test_logarithmic_axes_leave_out_rows_that_are_not_above_zero() -> None:
    table = _table()
    table.loc[[0, 3], Y] = 0.0
    table.loc[5, X] = np.nan
    product = _draw(table, log=True)
    (axis,) = product.figure.axes
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
    assert list(product.notes) == ["2 rows are not above zero, so not on logarithmic axes"]
    assert product.table[Y].notna().sum() == 24 - 3
    assert axis.get_title(loc="right") == "not seen in 1 of 24 runs"
    assert not any("10" in text.get_text() and "^" in text.get_text() for text in axis.get_yticklabels())


def test_power_laws_by_engine_with_the_rows_that_are_left_out() -> None:
    table = _table()
    table.loc[0, Y] = np.nan
    table.loc[1, Y] = -1.0
    table.loc[13, "status"] = "failed"
    product = _draw(table, fitted=True)
    first, second = product.notes
    assert first.startswith(f"reference: {Y} = 3 x^0.1667, exponent 0.1667 ± ")
    assert first.endswith(" (10 rows; 2 left out, not seen or not above zero)")
    assert second.startswith(f"yade: {Y} = 4 x^0.1667, exponent 0.1667 ± ")
    assert second.endswith(" (11 rows)")
    law = next(line for line in product.figure.axes[0].lines if line.get_label() == "yade: x^0.1667")
    assert law.get_ydata() == pytest.approx(4 * law.get_xdata() ** (1 / 6), rel=1e-9)


def test_each_curve_has_a_power_law_unless_there_are_many_or_one_has_too_few_points() -> None:
    table = pd.concat([_table().assign(seen=1.0), _table().assign(seen=2.0)], ignore_index=True)
    table.insert(1, MASS, table.pop("seen") * 1e-3)
    table.loc[table[MASS] == 2e-3, Y] *= 2
    starts = [line.partition(" x^")[0] for line in _draw(table, fitted=True).notes]
    names = [
        "reference, striker mass 1 g",
        "reference, striker mass 2 g",
        "yade, striker mass 1 g",
        "yade, striker mass 2 g",
    ]
    assert sorted(starts) == [f"{name}: {Y} = {law}" for name, law in zip(names, (3, 6, 4, 8), strict=True)]
    table.loc[table.index[26:36], Y] = np.nan
    assert [line.partition(":")[0] for line in _draw(table, fitted=True).notes] == ["reference", "yade"]
    table.loc[table[MASS] == 2e-3, Y] = np.nan
    assert [line.partition(":")[0] for line in _draw(table, fitted=True).notes] == ["reference", "yade"]
    many = pd.concat([table.assign(**{MASS: mass}) for mass in np.arange(1.0, 10.0)], ignore_index=True)
    assert [line.partition(":")[0] for line in _draw(many, fitted=True).notes] == ["reference", "yade"]


def test_the_standard_error_of_the_exponent_is_that_of_least_squares() -> None:
    table = _table(engines=("reference",))
    noise = np.random.default_rng(1).normal(0, 0.05, len(table))
    table[Y] *= np.exp(noise)
    x, y = np.log(table[X]), np.log(table[Y])
    slope, start = np.polyfit(x, y, 1)
    error = np.sqrt(((y - start - slope * x) ** 2).sum() / (len(x) - 2) / ((x - x.mean()) ** 2).sum())
    (line,) = _draw(table, fitted=True).notes
    assert f"exponent {slope:.4g} ± {error:.2g} (12 rows)" in line


def test_draws_text_values_and_changes_one_by_one_are_points() -> None:
    (axis,) = _draw(_table(), joined=False).figure.axes
    assert {line.get_linestyle() for line in axis.lines} == {"None"}
    materials = _table().rename(columns={SPEED: "wall.material"}).astype({"wall.material": str})
    assert {line.get_linestyle() for line in _draw(materials).figure.axes[0].lines} == {"None"}
    table = _table().rename(columns={SPEED: "seed"})
    assert {line.get_linestyle() for line in _draw(table).figure.axes[0].lines} == {"None"}


@pytest.mark.parametrize(
    ("table", "how", "words"),
    [
        (_table(2), {"fitted": True}, "--power-law: found reference has 2 rows"),
        (_table().assign(**{X: 1.0}), {"fitted": True}, "different bead_5_amplitude_N"),
        (_table().assign(**{X: np.nan}), {}, "no finished row has both"),
        (_table().assign(**{X: -1.0}), {"log": True}, "no finished row has both, above zero"),
    ],
)
def test_too_few_rows_are_refused(table: pd.DataFrame, how: Any, words: str) -> None:
    with pytest.raises(InputError) as error:
        _draw(table, **how)
    assert words in str(error.value)


WRONG = [
    (["--x", "striker.speed"], "--x: needs --y"),
    (["--y", "wall_peak"], "--y: needs --x"),
    (["--log"], "--log: needs --x and --y"),
    (["--power-law", "--y", "wall_peak"], "--y: needs --x"),
    (
        ["--x", "striker.sped", "--y", "wall_peak"],
        '--x: found "striker.sped"; allowed: columns: case, striker.speed_m_s',
    ),
    (["--x", "wall.material", "--y", "wall_peak", "--log"], '--x: found "wall.material"; allowed: numbers: case, '),
    (["--x", "wall_peak", "--y", "wall.material"], '--y: found "wall.material"; allowed: numbers: case, '),
    (["--x", "engine", "--y", "wall_peak"], '--x: found "engine"; allowed: columns: case, '),
    (["--x", "striker.speed", "--y", "wall_peak", "--power-law"], "--power-law: found reference has 2 rows"),
]


def test_the_command_draws_a_relation_under_a_name_of_its_own(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = SPEEDS.format(2) + '[[axis]]\nkey = "wall.material"\nvalues = ["brass"]'
    path, results = study_file(axes, "reference", top='figure = ["wall_peak_N"]'), tmp_path / "results"
    assert beads("batch", path, "--runs", tmp_path / "runs", "--results", results).returncode == 0
    assert beads("study", path, "--results", results).returncode == 0
    before = {file: file.read_bytes() for file in results.iterdir() if file.is_file()}
    done = beads("study", path, "--results", results, "--x", "striker.speed", "--y", "wall_peak_N", "--log")
    assert (done.returncode, done.stderr) == (0, "")
    new = {file for file in results.iterdir() if file.is_file()} - set(before)
    assert {file.name for file in new} == {f"study-wall_peak_N-{SPEED}-xy.{end}" for end in ("csv", "png", "svg")}
    assert all(file.stem.endswith(DERIVED) for file in new)
    assert all(file.read_bytes() == content for file, content in before.items())
    done = beads("study", path, "--results", results, "--x", "wall.material", "--y", "striker.speed")
    assert done.returncode == 0
    for words, message in WRONG:
        done = beads("study", path, "--results", results, *words)
        assert (done.returncode, done.stdout) == (2, "")
        assert message in done.stderr, words
        assert done.stderr.count("\n") == 1
