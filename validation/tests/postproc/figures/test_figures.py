"""The paper's figures and its table, made by all engines."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.engines import codes, installed_codes, missing_codes
from postproc.draw.product import Product, write_product
from postproc.draw.style import COLUMN_IN, PAGE_IN
from postproc.figures import captions, make_figure
from postproc.figures.table1 import equals_printed
from postproc.paper.calibrated import calibrated
from postproc.paper.quoted import quoted
from postproc.paper.strikes import contact_peak, sensor_amplitude, strike_for
from postproc.read.signals import Peak, envelope, incident_pulse
from validation.reference.travelling_wave import solve_at_amplitude
from validation.tests.helpers.commands import beads, beads_process
from validation.tests.helpers.drawn import lettered_axes, not_in_table, out_of_bounds
from validation.tests.helpers.runs import need

CODES = codes()
ENGINES = (*CODES, "reference")
CHAINS = ("fig3", "fig4", "fig5", "fig6")  # figures with a spacetime diagram


READERS = {"QUOTED": quoted, "CALIBRATED": calibrated}


@pytest.fixture(scope="module")
def made(shared_runs: Path) -> dict[str, Product]:
    """All products, made once."""
    for code in CODES:
        need(code)
    return {name: make_figure(name, shared_runs) for name in captions()}


def test_a_figure_is_known_by_its_file() -> None:
    """``make help`` and the command line take its first line."""
    assert list(captions()) == sorted(file.stem for file in (paths.ROOT / "postproc" / "figures").glob("[a-z]*.py"))
    said = beads("figures", "--help").stdout.split()
    listed = subprocess.run(["make", "help"], cwd=paths.ROOT, capture_output=True, text=True, check=True).stdout
    for name, caption in captions().items():
        assert name in said
        assert caption.title.split()[0] in ("Fig.", "Table")
        assert re.search(f"make {name} +{re.escape(caption.title)}\n", listed)


@pytest.mark.long
@pytest.mark.timeout(400)
def test_all_are_made_and_written_whole(made: dict[str, Product], tmp_path: Path) -> None:
    for name, product in made.items():
        written = write_product(product, name, tmp_path)
        names = [name, *([f"{name}-spacetime"] if name in CHAINS else [])]
        assert {path.name for path in written} == {f"{each}.{kind}" for each in names for kind in ("svg", "png", "csv")}
        assert all(path.stat().st_size > 200 for path in written)
        assert "<svg" in (tmp_path / f"{name}.svg").read_text()
    assert not list(tmp_path.glob(".[!s]*"))


@pytest.mark.long
@pytest.mark.parametrize("name", captions())
def test_all_drawn_numbers_are_in_the_table(made: dict[str, Product], name: str) -> None:
    assert not_in_table(made[name].figure, made[name].table) == []


@pytest.mark.long
def test_columns_of_the_tables_are_in_the_readme(made: dict[str, Product]) -> None:
    readme = (paths.ROOT / "postproc" / "README.md").read_text()
    for name, product in made.items():
        (row,) = re.findall(rf"^\| `{name}\.csv` \| (.*) \|$", readme, re.MULTILINE)
        columns = {re.sub(rf"^({'|'.join(ENGINES)})_", "{engine}_", column) for column in product.table.columns}
        assert set(re.findall(r"`([^`]+)`", row)) == columns, name


@pytest.mark.long
@pytest.mark.parametrize("name", captions())
def test_a_figure_is_as_wide_as_print_and_nothing_is_cut(made: dict[str, Product], name: str) -> None:
    assert out_of_bounds(made[name].figure, (COLUMN_IN, PAGE_IN)) == []


@pytest.mark.long
def test_captions_describe_each_panel_and_no_other(made: dict[str, Product]) -> None:
    for name, product in made.items():
        letters = {letter for letter, _ in lettered_axes(product.figure) if letter}
        assert set(re.findall(r"(?:^|[ .;])\(([a-d])\)", captions()[name].text)) == letters, name
        if letters:  # schemes need no numbers
            measured = {letter for letter, axis in lettered_axes(product.figure) if axis.axison}
            assert measured <= set(product.table["panel"].str[0]) <= letters, name


@pytest.mark.long
def test_table_1_is_reproduced_by_every_engine(made: dict[str, Product]) -> None:
    table = made["table1"].table
    wide_foot = np.where(table["force_N"] <= 0.1, 0.2, 0.1)
    for engine in ENGINES:
        assert (table[f"{engine}_speed_m_s"] / table["computed_speed_m_s"] - 1).abs().max() < 0.01
        for name, allowed in (("width_0.2pct_diameters", wide_foot), ("width_4pct_diameters", 0.1)):
            assert ((table[f"{engine}_{name}"] - table[f"computed_{name}"]).abs() < allowed).all()
    for code in CODES:
        for column in ("striker_m_s", "speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters"):
            off = (table[f"{code}_{column}"] / table[f"reference_{column}"] - 1).abs()
            assert off.max() < 1e-5
            assert column == "striker_m_s" or (off <= table["codes_largest_deviation_share"]).all()


@pytest.mark.long
def test_table_1_has_the_printed_numbers(made: dict[str, Product]) -> None:
    expected = {5: (190.1, 5.41, 3.98), 2: (164.4, 5.67, 4.09), 0.6: (137.1, 6.24, 4.35), 0.1: (109.0, 7.92, 5.29),
                0.06: (103.65, 8.62, 5.74)}  # fmt: skip
    for _, row in made["table1"].table.iterrows():
        found = [row[f"reference_{name}"] for name in ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")]
        assert found == pytest.approx(expected[row["force_N"]], rel=1e-3)


@pytest.mark.long
def test_the_caption_of_table_1_counts_the_numbers_that_equal_the_printed_ones(made: dict[str, Product]) -> None:
    rows = made["table1"].table.to_dict("records")
    short, long = (sum(sum(equals_printed(row, of)) for row in rows) for of in ("reference", "exact_21"))
    shows = captions()["table1"].shows
    assert (f"20 beads and the striker: {short} of 15" in shows, f"{long} do" in shows) == (True, True)


@pytest.mark.long
def test_numbers_are_rounded_before_they_are_compared() -> None:
    row = dict.fromkeys(("computed_speed_m_s", "exact_speed_m_s"), 103) | {
        "computed_width_0.2pct_diameters": 4.3, "exact_width_0.2pct_diameters": 4.3538,
        "computed_width_4pct_diameters": 4.0, "exact_width_4pct_diameters": 3.951,
    }  # fmt: skip
    assert equals_printed(row, "exact") == [True, False, True]


@pytest.mark.long
def test_fig_3_draws_the_experiment_at_the_contact_force_of_eq_6(made: dict[str, Product]) -> None:
    dots = made["fig3"].table.query("source == 'experiment'")
    assert [*dots["sensor_amplitude_N"]] == [*quoted().table1.force_N]
    beta = (dots["force_N"] - dots["static_N"]) / dots["sensor_amplitude_N"]
    for force_N, own, static_N in zip(dots["force_N"], beta, dots["static_N"], strict=True):
        assert solve_at_amplitude(2.0, 3.0, static_N, force_N / static_N - 1).beta == pytest.approx(own, rel=1e-4)
    strike = strike_for(5.0, sensor_amplitude)
    assert contact_peak(strike) == pytest.approx(float(dots["force_N"].iloc[0]), rel=2e-3)


@pytest.mark.long
def test_the_caption_of_fig_3_has_the_largest_deviation_of_theory(made: dict[str, Product]) -> None:
    table, same = made["fig3"].table, ["modulus_MPa", "gravity", "force_N"]
    table = table.assign(force_N=table["force_N"].map(lambda force: float(f"{force:.6g}")))
    chain, theory = table[table["engine"] == "reference"], table[table["source"].str.startswith("Eq.")]
    both = chain.merge(theory, on=same)
    assert len(both) == 3 * 13 + 2 * 4
    largest = 100 * (both["speed_m_s_y"] / both["speed_m_s_x"] - 1).abs().max()
    assert f"within {largest:.1f} %" in captions()["fig3"].shows


@pytest.mark.long
def test_the_caption_of_fig_2_has_the_limit_of_beta(made: dict[str, Product]) -> None:
    table = made["fig2"].table
    limit = table[table["engine"] == "travelling wave without static force"]["beta"].iloc[0]
    assert f"{limit:.3f} times" in captions()["fig2"].shows


@pytest.mark.long
def test_runs_lie_on_the_curve_of_beta(made: dict[str, Product]) -> None:
    table = made["fig2"].table.query("panel == 'c'")
    waves = table[table["engine"] == "travelling wave"]
    assert waves["force_over_static"].min() <= 1.11
    assert waves["force_over_static"].max() >= 1e4
    points = table[~table["engine"].str.startswith("travelling wave")]
    assert set(points["engine"]) == set(ENGINES)
    solitary = points[points["solitary"].astype(bool)]
    assert len(solitary) == 4 * len(ENGINES)  # the pulse of the weakest strike is no solitary wave
    on_curve = np.interp(np.log(solitary["force_over_static"]), np.log(waves["force_over_static"]), waves["beta"])
    assert np.abs(solitary["beta"] / on_curve - 1).max() < 2e-3  # linear between points of the curve


@pytest.mark.long
def test_speeds_follow_the_theory_without_gravity_and_exceed_it_with(made: dict[str, Product]) -> None:
    table = made["fig3"].table
    assert set(table["source"]) == {"simulated", "Eq. (3)", "Eq. (4)", "experiment", "score"}
    assert set(table["curve"].dropna()) == set(range(1, 9))
    exact = table[table["engine"] == "reference"]
    assert exact["force_N"].min() == pytest.approx(0.03, rel=1e-9)
    assert exact["force_N"].max() == pytest.approx(20, rel=1e-9)
    bare = exact[~exact["gravity"].astype(bool)]
    for _, some in bare.groupby("modulus_MPa"):
        slope = np.polyfit(np.log(some["force_N"]), np.log(some["speed_m_s"]), 1)[0]
        assert slope == pytest.approx(1 / 6, abs=1e-5)
    for code in CODES:
        own = table[table["engine"] == code].merge(exact, on="striker_m_s")
        assert len(own) == 5 * 4
        assert (own["speed_m_s_x"] / own["speed_m_s_y"] - 1).abs().max() < 1e-5
        assert np.array_equal(own["speed_m_s_x"] / own["speed_m_s_y"] - 1, own["speed_off_reference_share_x"])
    heavy = exact[exact["gravity"].astype(bool)].merge(bare, on=["modulus_MPa", "force_N"])
    assert (heavy["speed_m_s_x"] > heavy["speed_m_s_y"]).all()


@pytest.mark.long
def test_one_modulus_is_closest_to_large_and_small_waves(made: dict[str, Product]) -> None:
    table = made["fig3"].table
    score = table[table["source"] == "score"]
    for large in (True, False):
        some = score[(score["force_N"] >= 2) == large]
        rms = (some["deviation_standard_errors"] ** 2).groupby(some["modulus_MPa"]).mean()
        assert rms.idxmin() == 1000


def test_an_envelope_goes_through_its_exponential() -> None:
    peaks = [Peak(t, 3 * np.exp(-200 * t), 0) for t in (0.001, 0.004, 0.009)]
    found = envelope(peaks)
    assert (found.amplitude_N, found.rate_per_s) == pytest.approx((3, -200))


def test_the_shape_of_a_pulse_made_of_known_pieces() -> None:
    """A quarter sine up, an exponential down to 0.4, a faster one from there, and a reflected wave."""
    time, rise, slow, fast = np.arange(0, 2e-3, 1e-6), 1e-4, 2e-4, 1e-4
    turn = rise + slow * np.log(1 / 0.4)
    falling = np.where(time < turn, np.exp(-(time - rise) / slow), 0.4 * np.exp(-(time - turn) / fast))
    pulse = np.where(time < rise, np.sin(np.pi / 2 * time / rise), falling)
    assert incident_pulse(time, pulse) is None
    shape = incident_pulse(time, pulse + 2 * np.exp(-(((time - 1.6e-3) / 5e-5) ** 2)))
    assert shape is not None
    onset = rise * 2 / np.pi * np.arcsin(0.02)
    assert shape.rise_s == pytest.approx(rise - onset, rel=0.02)
    assert shape.decay_per_s == pytest.approx(-1 / slow, rel=0.01)
    assert shape.duration_s == pytest.approx(turn + fast * np.log(0.4 / 0.02) - onset, rel=0.01)


def test_quoted_numbers_are_whole() -> None:
    table = quoted().table1.frame
    assert table.shape == (5, 7)
    assert table.notna().all().all()


@pytest.mark.long
def test_a_figure_without_an_engine_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    done = beads_process("figures", "fig6", "--runs", tmp_path / "runs", "--results", tmp_path / "out", PATH=str(empty))
    assert done.returncode == 0, done.stderr
    monkeypatch.setenv("PATH", str(empty))
    assert f"left out, since not installed: {', '.join(missing_codes())}" in done.stderr
    assert set(pd.read_csv(tmp_path / "out" / "fig6.csv")["engine"]) == {"reference", *installed_codes()}


@pytest.mark.parametrize("name", ["fig4", "fig5", "table1"])
def test_a_figure_of_the_reference_alone(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    product = make_figure(name, tmp_path / "runs")
    assert len(write_product(product, name, tmp_path / "out")) == 6 if name in CHAINS else 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fig5_incident_rise_us", "fig5_incident_rize_us", "missing key fig5_incident_rise_us"),
        ("force_N = [5, 2, 0.6, 0.1, 0.06]", "", "table1.force_N"),
        ("force_N = [5, 2, 0.6, 0.1, 0.06]", "force_N = [5, 2]", "5 numbers"),
        ("force_N = [5, 2,", "force_N = [5, 5,", "the same force twice"),
        ("force_N = [5, 2,", 'force_N = ["x", 2,', "table1.force_N"),
        ("force_N = [5, 2,", "force_N = [nan, 2,", "table1.force_N"),
        ("force_N = [5, 2,", "force_N = [-5, 2,", "above 0"),
        ("fig4_speed_m_s = 152 ", "fig4_sped_m_s = 152 ", "missing key fig4_speed_m_s"),
        ("[table1]", "[[", "TOML"),
        ("value = 8.287e8", "value = -1.0", "above 0"),
        ('law = "viscoelastic"', "", "law"),
        ("error = 0.0341", "eror = 0.0341", "error"),
    ],
)
def test_broken_numbers_of_the_paper_are_refused_in_one_line(
    old: str, new: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (name, reader) = next(each for each in READERS.items() if old in getattr(paths, each[0]).read_text())
    file: Path = getattr(paths, name)
    path = tmp_path / file.name
    path.write_text(file.read_text().replace(old, new))
    monkeypatch.setattr(paths, name, path)
    reader.cache_clear()
    try:
        with pytest.raises(InputError) as caught:
            reader()
    finally:
        reader.cache_clear()
    assert message in str(caught.value)
    assert path.name in str(caught.value)


def test_a_force_that_no_strike_gives_is_an_error() -> None:
    with pytest.raises(RunError, match=r"no striker speed gives a wave of 0\.001 N"):
        strike_for(1e-3, contact_peak)  # below the static force between the sensors


def test_a_scene_without_sensors_is_an_input_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    for scene in ("fig4", "table1"):
        text = (paths.SCENES / f"{scene}.toml").read_text()
        (scenes / f"{scene}.toml").write_text("\n".join(line for line in text.splitlines() if "sensors" not in line))
    monkeypatch.setattr(paths, "SCENES", scenes)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("fig4", "table1", "fig3"):
        with pytest.raises(InputError, match=r"chain\.sensors"):
            make_figure(name, tmp_path / "runs")


def test_a_figure_with_a_failed_run_leaves_no_files(tmp_path: Path) -> None:
    tools = tmp_path / "tools"
    tools.mkdir()
    for code in CODES:
        fake = tools / code
        fake.write_text("#!/bin/sh\necho ERROR: no licence today\nexit 1\n")
        fake.chmod(0o755)
    out = tmp_path / "out"
    done = beads_process(
        "figures", "fig6", "--runs", tmp_path / "runs", "--results", out, PATH=f"{tools}:/usr/bin:/bin"
    )
    assert done.returncode == 1
    assert "fig6" in done.stderr
    assert "failed: exit code 1" in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists() or not list(out.iterdir())
