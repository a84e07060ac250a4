"""The paper's figures and its table, made by all engines."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.engines import codes
from postproc.draw.plot import COLUMN_IN, PAGE_IN, Product
from postproc.draw.stack import STRIP
from postproc.figures import captions, make_figure
from postproc.figures.table1 import equals_printed
from postproc.paper import calibrated, quoted
from postproc.paper.strikes import COLUMNS, contact_peak, fitting_force, sensor_amplitude, strike_for, table1_numbers
from postproc.read.signals import incident_pulse
from validation.reference.travelling_wave import solve_at_amplitude
from validation.tests.helpers.commands import beads
from validation.tests.helpers.drawn import lettered_axes, not_in_table, out_of_bounds
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import StandIn

CODES = codes()
ENGINES = (*CODES, "reference")
READERS = {"QUOTED": quoted, "CALIBRATED": calibrated}
KEY = "fig5_incident_rise_us"  # read where it is used
Made = dict[str, Product]


@pytest.fixture(scope="module")
def made(shared_runs: Path) -> Made:
    """All products, made once."""
    for code in CODES:
        need(code)
    return {name: make_figure(name, shared_runs) for name in captions()}


def _numbers(product: Product, panel: str, engine: str = "reference") -> dict[str, float]:
    rows = product.table.query("panel == @panel and engine == @engine and value.notna()")
    return dict(zip(rows["quantity"], rows["value"], strict=True))


def _absent(name: str, *numbers: str) -> list[str]:
    """Numbers that are missing in a caption."""
    text = f"{captions()[name].shows} {captions()[name].text}"
    return [number for number in numbers if not re.search(rf"(?<![\d.-]){re.escape(number)}(?!\.?\d)", text)]


@pytest.mark.long
@pytest.mark.parametrize("name", captions())
def test_drawn_numbers_are_in_the_table_and_nothing_is_cut(made: Made, name: str) -> None:
    product = made[name]
    assert not_in_table(product.figure, product.table) == []
    assert out_of_bounds(product.figure, (COLUMN_IN, PAGE_IN)) == []
    letters = {letter for letter, _ in lettered_axes(product.figure) if letter}
    assert set(re.findall(r"(?:^|[ .;])\(([a-d])\)", captions()[name].text)) == letters


@pytest.mark.long
def test_codes_solve_table_1_as_the_reference_and_its_caption_counts_the_printed_numbers(made: Made) -> None:
    table = made["table1"].table
    for code in CODES:
        for column in ("striker_m_s", "speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters"):
            off = (table[f"{code}_{column}"] / table[f"reference_{column}"] - 1).abs()
            assert off.max() < 1e-5
            assert column == "striker_m_s" or (off <= table["codes_largest_deviation_share"]).all()
    short, long = (
        sum(sum(equals_printed(row, of)) for row in table.to_dict("records")) for of in ("reference", "exact_21")
    )
    assert _absent("table1", f"20 beads and the striker: {short} of 15", f"{long} do") == []
    free = [0, 0]
    for place, setting in enumerate(("chain.count=20", "chain.count=21")):
        for row in table.to_dict("records"):
            motion = strike_for(fitting_force(row["force_N"], setting), sensor_amplitude, setting)
            row |= {f"free_{name}": number for name, number in zip(COLUMNS, table1_numbers(motion), strict=True)}
            free[place] += sum(equals_printed(row, "free"))
    assert _absent("table1", f"{free[0]} and {free[1]} do") == []


@pytest.mark.long
def test_runs_of_fig_2_lie_on_the_curve_of_beta_and_the_caption_has_its_limit(made: Made) -> None:
    table = made["fig2"].table
    limit = table[table["engine"] == "travelling wave without static force"]["beta"].iloc[0]
    assert _absent("fig2", f"{limit:.3f} times") == []
    waves = table.query("panel == 'c' and engine == 'travelling wave'")
    points = table[(table["panel"] == "c") & ~table["engine"].str.startswith("travelling wave")]
    assert set(points["engine"]) == set(ENGINES)
    solitary = points[points["solitary"].astype(bool)]
    assert len(solitary) == 4 * len(ENGINES)  # the pulse of the weakest strike is no solitary wave
    on_curve = np.interp(np.log(solitary["force_over_static"]), np.log(waves["force_over_static"]), waves["beta"])
    assert np.abs(solitary["beta"] / on_curve - 1).max() < 2e-3  # linear between points of the curve


@pytest.mark.long
def test_fig_3_draws_the_experiment_at_the_contact_force_of_eq_6(made: Made) -> None:
    dots = made["fig3"].table.query("source == 'experiment'")
    betas = (dots["force_N"] - dots["static_N"]) / dots["sensor_amplitude_N"]
    for force_N, beta, static_N in zip(dots["force_N"], betas, dots["static_N"], strict=True):
        assert solve_at_amplitude(2.0, 3.0, static_N, force_N / static_N - 1).beta == pytest.approx(beta, rel=1e-4)


@pytest.mark.long
def test_codes_have_the_speeds_of_fig_3_and_its_caption_the_deviation_of_the_theory(made: Made) -> None:
    table = made["fig3"].table
    exact = table[table["engine"] == "reference"]
    for code in CODES:
        both = table[table["engine"] == code].merge(exact, on="striker_m_s")
        assert len(both) == 5 * 4
        off = both["speed_m_s_x"] / both["speed_m_s_y"] - 1
        assert off.abs().max() < 1e-5
        assert np.array_equal(off, both["speed_off_reference_share_x"])
    rounded = table.assign(force_N=table["force_N"].map(lambda force: float(f"{force:.6g}")))
    chain, theory = rounded[rounded["engine"] == "reference"], rounded[rounded["source"].str.startswith("Eq.")]
    both = chain.merge(theory, on=["modulus_MPa", "gravity", "force_N"])
    assert len(both) == 3 * 13 + 2 * 4
    score = table[table["source"] == "score"]
    groups = [score["force_N"] < 2, score["modulus_MPa"]]
    rms = np.sqrt((score["deviation_pct"] ** 2).groupby(groups).mean()).round().astype(int).unstack()
    (*large, last), (*small, least) = rms.to_numpy()
    written = [f"{', '.join(map(str, first))} and {end} %" for first, end in ((large, last), (small, least))]
    assert _absent("fig3", *written) == []
    assert _absent("fig3", f"within {100 * (both['speed_m_s_y'] / both['speed_m_s_x'] - 1).abs().max():.1f} %") == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["fig4", "fig5", "fig6"])
def test_traces_hold_every_engine_and_stay_near_the_reference(made: Made, name: str) -> None:
    table = made[name].table
    for panel, rows in table[table["time_s"].notna() & (table["engine"] != "paper")].groupby("panel"):
        if (name, panel) == ("fig5", "c"):  # curves of the reference alone
            continue
        assert set(rows["engine"]) == set(ENGINES)
        residual = rows[rows["engine"] != "reference"]["residual_to_reference_share"]
        assert 0 < residual.max() < (2e-3 if str(panel) in "ac" else 3e-4)  # with damping codes are of first order
        assert rows["wall_N"].max() > 0.9
        strip = rows[rows["quantity"] == STRIP]
        assert strip["residual_to_reference_share"].max() == residual.max()
        assert set(strip["engine"]) == set(CODES)


@pytest.mark.long
def test_fig_4_draws_the_quoted_speed_and_its_caption_has_the_numbers(made: Made) -> None:
    marks = made["fig4"].table.query("time_s.notna() and engine == 'paper' and quantity == 'speed_m_s'")
    times = [marks[marks[gauge].notna()]["time_s"].iloc[0] for gauge in ("bead_9_N", "bead_5_N", "wall_N")]
    assert np.diff(times) == pytest.approx(np.array([4, 4.5]) * 4.76e-3 / 152, rel=2e-3)
    modulus, restitution = (parameter.value for parameter in calibrated().parameter)
    assert _absent("fig4", f"{modulus * 1e-9:.3f} GPa", f"{restitution:.3f}") == []
    for panel in "ab":
        force, speed, duration, ratio = _numbers(made["fig4"], panel).values()
        assert _absent("fig4", f"{force:.3g} N", f"{speed:.3g} m/s", f"{duration:.0f} µs", f"{ratio:.2f}") == []
    force, speed, duration = _numbers(made["fig4"], "a", "paper").values()
    assert _absent("fig4", f"{force:g} N", f"{speed:g} m/s", f"{duration:g} µs") == []


@pytest.mark.long
def test_fig_5_draws_the_envelope_and_its_caption_has_the_rates_and_the_incident_pulse(made: Made) -> None:
    for panel in "ab":
        rate, quoted_rate = (
            _numbers(made["fig5"], panel, engine)[name]
            for engine, name in (("reference", "envelope_3_maxima_per_us"), ("paper", "envelope_per_us"))
        )
        assert _absent("fig5", f"{rate:.4f}", f"{quoted_rate:.4f}") == []
        drawn = made["fig5"].table.query("panel == @panel and quantity == 'envelope_3_maxima'")
        slope = np.polyfit(drawn["time_s"], np.log(drawn["wall_N"]), 1)[0]
        assert slope == pytest.approx(1e6 * rate, rel=1e-6)
    numbers = _numbers(made["fig5"], "b")
    rise, decay, duration = (numbers[f"top_bead_{name}"] for name in ("rise_us", "decay_per_us", "duration_us"))
    four = numbers["envelope_4_maxima_per_us"]
    assert _absent("fig5", f"{four:.4f}", f"{rise:.0f}, {decay:.4f}, {duration:.0f}") == []
    rise, decay, duration = _numbers(made["fig5"], "c", "paper").values()
    assert _absent("fig5", f"{rise:g} µs", f"{decay:g} per µs", f"{duration:g} µs") == []


@pytest.mark.long
def test_fig_6_draws_the_elastic_maximum_and_its_caption_has_the_valleys_and_ratios(made: Made) -> None:
    for panel, other in ("ab", "cd"):
        damped, elastic = _numbers(made["fig6"], panel), _numbers(made["fig6"], other)
        assert elastic["valley_over_second_maximum"] == 0
        assert damped["maximum_1_us"] > elastic["maximum_1_us"]
        level = made["fig6"].table.query("panel == @panel and quantity == 'elastic_maximum_1_N'")["wall_N"]
        assert [*level] == [elastic["maximum_1_N"]] * 2
        ratio = f"by {elastic['maximum_1_N'] / damped['maximum_1_N']:.1f} in ({panel})"
        assert _absent("fig6", f"{damped['valley_over_second_maximum']:.2f}", ratio) == []


def test_the_shape_of_a_pulse_made_of_known_pieces() -> None:
    """A quarter sine up, an exponential down to 0.4, a faster one from there, and a reflected wave."""
    time, rise, slow, fast = np.arange(0, 2e-3, 1e-6), 1e-4, 2e-4, 1e-4
    turn = rise + slow * np.log(1 / 0.4)
    falling = np.where(time < turn, np.exp(-(time - rise) / slow), 0.4 * np.exp(-(time - turn) / fast))
    pulse = np.where(time < rise, np.sin(np.pi / 2 * time / rise), falling)
    assert not incident_pulse(time, pulse)
    shape = incident_pulse(time, pulse + 2 * np.exp(-(((time - 1.6e-3) / 5e-5) ** 2)))
    onset = rise * 2 / np.pi * np.arcsin(0.02)
    assert shape["rise_s"] == pytest.approx(rise - onset, rel=0.02)
    assert shape["decay_per_s"] == pytest.approx(-1 / slow, rel=0.01)
    assert shape["duration_s"] == pytest.approx(turn + fast * np.log(0.4 / 0.02) - onset, rel=0.01)


def test_figures_without_engines_say_so(no_codes: None, tmp_path: Path) -> None:
    done = beads("figures", "fig5", "table1", "--runs", tmp_path / "runs", "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert f"left out, since not installed: {', '.join(codes())}" in done.stderr
    names = ("fig5", "fig5-spacetime", "table1")
    files = {path.name for path in (tmp_path / "out").glob("*.*")}
    assert files == {f"{name}.{ending}" for name in names for ending in ("csv", "png", "svg")}
    engines = set(pd.read_csv(tmp_path / "out" / "fig5.csv")["engine"])
    assert engines == {"reference", "paper"}


def test_a_figure_with_a_failed_run_leaves_no_files(stand_in: StandIn, tmp_path: Path) -> None:
    for code in CODES:
        stand_in(code, "echo ERROR: no licence today\nexit 1\n")
    done = beads("figures", "fig6", "--runs", tmp_path / "runs", "--results", tmp_path / "out")
    assert done.returncode == 1
    assert "fig6" in done.stderr
    assert "failed: exit code 1" in done.stderr
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(
    ("reader", "old", "new", "message"),
    [
        ("QUOTED", "fig5_incident_rise_us = 50", 'fig5_incident_rise_us = "x"', "fig5_incident_rise_us"),
        ("QUOTED", KEY, "fig5_incident_rize_us", "fig5_incident_rise_us: missing key"),
        ("QUOTED", "force_N = [5, 2, 0.6, 0.1, 0.06]", "force_N = [5, 2]", "table1.force_N"),
        ("QUOTED", "force_N = [5, 2,", "force_N = [nan, 2,", "table1.force_N"),
        ("QUOTED", "[table1]", "[[", "TOML"),
        ("CALIBRATED", "value = ", "value = -", "greater than 0"),
        ("CALIBRATED", 'law = "viscoelastic"', "", "law"),
    ],
)
def test_broken_numbers_of_the_paper_are_refused_in_one_line(
    reader: str, old: str, new: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file: Path = getattr(paths, reader)
    path, text = tmp_path / file.name, file.read_text()
    path.write_text(text.replace(old, new))
    assert path.read_text() != text
    monkeypatch.setattr(paths, reader, path)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        getattr(READERS[reader].__wrapped__(), KEY)  # past the cache
    assert path.name in str(caught.value)


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        (None, 2, "own.py: cannot be read ([Errno 2] No such file or directory"),
        ("def make(runs):\n", 2, "own.py: cannot be read (expected an indented block"),
        ("def make(runs): ...", 2, "own.py: docstring: found 0 paragraphs"),
        ('"""Title."""\nmake = 1', 2, "own.py: make: found no such function; allowed: make(runs)"),
        ('"""Title."""\ndef make(runs): ...', 2, "own.py: make: found NoneType returned; allowed: a Product"),
        ('"""Title."""\ndef make(runs):\n    return {}["no"]', 1, "own.py, line 3: KeyError: 'no'"),
        ('"""Title."""\nimport nowhere', 1, "own.py, line 2: ModuleNotFoundError: No module named 'nowhere'"),
    ],
)
def test_errors_of_a_figure_of_one_s_own_name_file_and_line(
    tmp_path: Path, text: str | None, code: int, message: str
) -> None:
    file = tmp_path / "own.py"
    if text:
        file.write_text(text)
    done = beads("figures", file, "--results", tmp_path / "out")
    assert (done.returncode, done.stdout) == (code, "")
    assert message in done.stderr
    assert not list(tmp_path.glob("out/*"))


@pytest.mark.parametrize("force_N", [0.05, 2.0])
def test_a_strike_has_the_amplitude_asked_for(force_N: float) -> None:
    assert sensor_amplitude(strike_for(force_N, sensor_amplitude)) == pytest.approx(force_N, rel=1e-8)


def test_a_force_that_no_strike_gives_is_an_error() -> None:
    with pytest.raises(RunError, match=r"no striker speed gives a wave of 0\.001 N"):
        strike_for(1e-3, contact_peak)  # below the static force between the sensors


def test_scenes_without_sensors_and_dissipation_without_a_train_are_refused(
    no_codes: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    restitution = calibrated().parameter[1].model_copy(update={"value": 0.4})
    strong = calibrated().model_copy(update={"parameter": (restitution,)})
    for name, message in (("fig5", "fewer than 3 maxima at the wall"), ("fig6", "1 maxima at the wall")):
        monkeypatch.setattr(f"postproc.figures.{name}.calibrated", lambda: strong)
        with pytest.raises(InputError, match=message):
            make_figure(name, tmp_path / "runs")
    for scene in ("fig4", "table1"):
        text = (paths.SCENES / f"{scene}.toml").read_text()
        (tmp_path / f"{scene}.toml").write_text("\n".join(line for line in text.splitlines() if "sensors" not in line))
    monkeypatch.setattr(paths, "SCENES", tmp_path)
    for name in ("fig4", "table1"):
        with pytest.raises(InputError, match=r"chain\.sensors"):
            make_figure(name, tmp_path / "runs")
