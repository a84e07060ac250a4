"""From a fit to the next experiment: made-up experiments by an independent integrator, predicted and designed."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.scene.settings import look_up
from validation.calibration.command import Fitted, fit, problems_of, request_of
from validation.calibration.design import _row, design
from validation.calibration.fit import DECISIVE, Fit, rows_of, taken_as_exact
from validation.calibration.fit import fit as least_squares
from validation.calibration.parameters import law_of
from validation.calibration.predict import by_fits, chapter_of, predict, quantile
from validation.calibration.problem import Problem, checked, pose, scene_data
from validation.tests.helpers.made_up_experiment import (
    LAWS,
    MODULUS,
    MODULUS_PA,
    SHORT,
    TRIGGER_S,
    make_up,
    true_observables,
)

OTHER = (
    "chain.count=16", "run.duration=1 ms", "striker.speed=0.5 m/s",
    "chain.sensors=[{ from_wall = 12 }, { from_wall = 7 }, { from_wall = 3 }]",
)  # fmt: skip
PREDICTED = (
    "bead_12_amplitude_N", "bead_7_arrival_s", "bead_3_amplitude_N", "bead_7_duration_4pct_s", "wall_peak_N",
    "speed_12_to_7_m_s",
)  # fmt: skip
NOISES_N = (0.01, 0.06, 0.3)  # for pulses of 2 N
REPEATED = 22


def fitted(folder: Path, law: str, noise_N: float, seed: int, laws: tuple[str, ...], **more: float) -> Fitted:
    """Fits to a made-up experiment that start at the truth, without a folder."""
    path = make_up(folder / "shot.csv", law, noise_N, (seed, len(law), int(1e3 * noise_N)), "fig4", SHORT, **more)
    request = request_of(["fig4"], free=(MODULUS,), laws=laws, settings=SHORT, measured=path, quick=True)
    start = {MODULUS: MODULUS_PA, **{key: value for key, value, _ in LAWS.values()}}
    fits = {name: least_squares(each, [start], search=False) for name, each in problems_of(request).items()}
    return Fitted(folder, request, fits, {})


@pytest.mark.long
def test_parameters_and_predictions_are_within_their_95_pct_as_often_as_they_say(tmp_path: Path) -> None:
    """Three laws, three noise levels; the predicted scene has another speed, length and other gauges."""
    inside = defaultdict[str, list[bool]](list)
    for law, (key, value, _) in LAWS.items():
        true = {MODULUS: MODULUS_PA, key: value, "fig4: measured.0.trigger": TRIGGER_S}
        known = true_observables(law, "fig4", OTHER)
        for noise_N in NOISES_N:
            for seed in range(REPEATED):
                found = fitted(tmp_path, law, noise_N, seed, (law,))
                assert found.fits[law].explained
                for (name, at), error in zip(found.fits[law].values.items(), found.fits[law].errors, strict=True):
                    inside["law" if name == key else name].append(abs(at - true[name]) < 1.96 * error)
                for row in rows_of(by_fits(found, checked("fig4", OTHER)).observables):
                    if row.observable in PREDICTED:
                        inside[row.observable].append(row.low_95pct < known[row.observable] < row.high_95pct)
    assert len(inside) == 3 + len(PREDICTED)
    shares = {name: np.mean(each) for name, each in inside.items()}
    assert {name: share for name, share in shares.items() if not 0.9 <= share <= 0.99} == {}


@pytest.mark.parametrize(("law", "noise_N"), [("kuwabara-kono", 0.06), ("power", 0.3)])
def test_a_prediction_by_the_wrong_law_alone_does_not_hold(law: str, noise_N: float, tmp_path: Path) -> None:
    """Chi-square is 1.11 and 1.03 per degree of freedom, and the predicted amplitude is many errors off."""
    found = predict(fitted(tmp_path, law, noise_N, 0, ("viscoelastic",)), "fig4", OTHER)
    assert not found.holds
    assert found.said[0].startswith("the prediction does not hold: ")
    assert min(found.others, key=found.others.__getitem__) == law
    assert found.others[law] < -DECISIVE
    row: Any = found.observables.set_index("observable").loc["bead_12_amplitude_N"]
    assert abs(row["value"] - true_observables(law, "fig4", OTHER)["bead_12_amplitude_N"]) > 5 * row["error"]


@pytest.mark.parametrize(("noise_N", "interval_s"), [(0.002, 1e-7), (0.006, 1e-7), (0.006, 1e-6)])
def test_the_right_law_explains_coarsely_rounded_readings(noise_N: float, interval_s: float, tmp_path: Path) -> None:
    """A digit of a hundredth of the pulse, with noise of 0.1 to 0.3 digits, also averaged."""
    found = fitted(tmp_path, "viscoelastic", noise_N, 4, ("viscoelastic",), interval_s=interval_s, digit_N=0.02)
    assert found.fits["viscoelastic"].explained


def test_lack_of_fit_shows_where_chi_square_is_that_of_a_slightly_larger_noise(tmp_path: Path) -> None:
    """Chi-square is 1.11 per degree of freedom; errors are enlarged by what the noise of the spline leaves."""
    found = fitted(tmp_path, "kuwabara-kono", 0.06, 0, ("viscoelastic", "kuwabara-kono")).fits
    wrong, right = found["viscoelastic"], found["kuwabara-kono"]
    assert wrong.chi_square / wrong.freedom < 1.2
    assert not wrong.explained
    assert 1.3 < wrong.enlargement < 2.0
    assert right.explained
    assert right.enlargement == 1


def test_laws_that_the_data_leave_open_widen_the_interval(tmp_path: Path) -> None:
    found = fitted(tmp_path, "viscoelastic", 0.3, 1, ("viscoelastic", "kuwabara-kono"))
    both = predict(found, "fig4", OTHER)
    assert both.holds
    first, second = found.fits.values()
    ratio = both.weights["viscoelastic"] / both.weights["kuwabara-kono"]
    assert np.log(ratio) == pytest.approx((second.aic - first.aic) / 2)
    row: Any = both.observables.set_index("observable").loc["bead_3_amplitude_N"]
    assert row["between_laws"] > 2 * row["error"]
    assert row["high_95pct"] - row["low_95pct"] > row["between_laws"]
    assert row["low_95pct"] < min(row["value_viscoelastic"], row["value_kuwabara-kono"])
    wide: Any = both.forces["wall_high_95pct_N"] - both.forces["wall_low_95pct_N"]
    assert wide.max() > 0.1
    assert wide[0] < 1e-9, "at rest the force is known"


def test_a_scene_without_gauges_is_predicted_without_a_figure(tmp_path: Path) -> None:
    found = fitted(tmp_path, "viscoelastic", 0.3, 1, ("viscoelastic",))
    bare = by_fits(found, checked("fig4", ("chain.sensors=", "wall=")))
    assert [*bare.forces] == ["time_s"]
    assert chapter_of(bare, "bare").figures == {}


def test_a_fit_to_quoted_numbers_predicts_though_one_law_lacks_an_observable(tmp_path: Path) -> None:
    """Elastic beads and damped ones do not show the same numbers; the folder names the quoted data, not its scenes."""
    laws = ("elastic", "viscoelastic")
    fitted_one = fit(quoted=["fig4"], free=[MODULUS], laws=laws, quick=True, results=tmp_path)
    found = predict(fitted_one.folder, "fig4", {"striker.speed": "1 m/s"})
    assert [*found.weights] == [*laws]
    table: Any = found.observables.set_index("observable")
    assert table.loc["bead_9_amplitude_N", "low_95pct"] < table.loc["bead_9_amplitude_N", "high_95pct"]
    assert (table["value_elastic"].isna() != table["value_viscoelastic"].isna()).any()


def test_quantiles_of_mixtures() -> None:
    shares, values, errors = (
        np.array([[0.9], [0.1]]),
        np.array([[0.0, 1.0], [5.0, 1.0]]),
        np.array([[1.0, 2.0], [0.5, 2.0]]),
    )
    low, high = (quantile(shares, values, errors, probability) for probability in (0.025, 0.975))
    for end, probability in ((low, 0.025), (high, 0.975)):
        below = (shares * norm.cdf((end - values) / errors)).sum(axis=0)
        assert below == pytest.approx([probability] * 2, rel=1e-9)
    assert (low[1], high[1]) == pytest.approx((1 - 2 * 1.95996, 1 + 2 * 1.95996), rel=1e-5)
    assert high[0] > 4.5, "a tenth of the weight reaches into the interval"


@pytest.mark.long
def test_the_designed_experiment_tells_the_laws_apart_as_expected(tmp_path: Path) -> None:
    """Mean of four made-up repetitions; an experiment of the middle of the candidates does not."""
    laws = ("viscoelastic", "kuwabara-kono")
    base = make_up(tmp_path / "base.csv", laws[0], 0.3, (1,), "fig4", SHORT)
    settings = dict(text.split("=") for text in SHORT)
    options: dict[str, Any] = {"free": [MODULUS], "laws": laws, "quick": True}
    first = fit("fig4", measured=base, settings=settings, results=tmp_path, **options)
    found = design(first.folder, ["striker.speed=0.05..8", "chain.count=8..30"], "2..15", candidates=40)
    expected: Any = found.table["expected"]
    assert expected[found.best] > 4 * expected[0], "the experiment as it was"
    assert expected.median() < 0.1 * expected[found.best]
    scene = tmp_path / "designed.toml"
    scene.write_text(found.scene)
    differences = []
    for seed in range(4):
        shot = make_up(tmp_path / "new.csv", laws[0], 0.3, (seed, 9), str(scene), ())
        again = fit(scene, measured=shot, results=tmp_path / "new", **options)
        differences.append(again.fits[laws[1]].chi_square - again.fits[laws[0]].chi_square)
    assert 1 / 1.5 < np.mean(differences) / expected[found.best] < 1.5
    assert min(differences) > DECISIVE


def test_settings_of_a_prediction_stay(tmp_path: Path) -> None:
    """Even of a fitted strike; what is not set is that of the fit, with all of its parameters or in another scene."""
    path = make_up(tmp_path / "shot.csv", "viscoelastic", 0.06, (2,), "fig4", SHORT)
    settings: dict[str, Any] = dict(text.split("=") for text in SHORT)
    free = (MODULUS, "striker.speed=2±1%")
    found = fit(
        "fig4", free=free, laws=["viscoelastic"], settings=settings, measured=path, quick=True, results=tmp_path
    )
    slow = {"striker.speed": "0.2 m/s"}
    own, named = predict(found, settings=slow), predict(found.folder, "fig4", settings | slow)
    for column in ("value", "error"):
        one, other = (each.observables.set_index("observable")[column] for each in (own, named))
        assert one["bead_9_peak_N"] == pytest.approx(other["bead_9_peak_N"], rel=1e-6)
    assert own.simulation.case.scene.run.duration == found.fits["viscoelastic"].problem.sets[0].scene.run.duration / 2
    for setting in ({"contact.restitution": 1}, {"contact.dissipation": "power", "contact.gamma": 2}, {MODULUS: 1e9}):
        scene = predict(found, "fig4", setting).simulation.case.scene
        assert all(look_up(scene, key) == value for key, value in setting.items())
    with pytest.raises(InputError, match=r"contact.gamma"):
        predict(found, "fig4", {"contact.gamma": 2})


def test_a_descent_of_a_design_does_not_stop_at_a_parameter_without_effect() -> None:
    """The candidate has a force and a speed, but no width, on which the cut would act: nothing tells the laws apart."""
    request = request_of((), free=(MODULUS,), laws=("viscoelastic", "power"), quoted=("fig4", "table1"), quick=True)
    found: dict[str, dict[str, float]] = {
        "viscoelastic": {MODULUS: 1.2e9, "contact.restitution": 0.75, "reading.cut": 0.1, "reading.speed_scale": 1.1},
        "power": {MODULUS: 5.2e8, "contact.gamma": 0.048, "reading.force_scale": 1.2, "reading.speed_scale": 0.87},
    }
    fits = dict[str, Fit]()
    for law, problem in problems_of(request).items():
        place = [free.coordinate(found[law].get(free.label, free.start)) for free in problem.free]
        fits[law] = Fit(problem, np.array(place))
    row = _row(fits, "", ["striker.speed"], (), {"striker.speed": 2.25})
    assert row["expected"] < 1e-3


def test_designs_know_parameters_of_one_law_and_values_that_were_zero(tmp_path: Path) -> None:
    """Two numbers and two parameters of each law: nothing can tell the laws apart."""
    path = tmp_path / "scene.toml"
    values = "[[measured]]\nvalues = { bead_9_amplitude = '2 N', speed_9_to_5 = '150 m/s' }\n"
    scene = paths.SCENES / "fig4.toml"
    path.write_text(scene.read_text() + values + "errors = { bead_9_amplitude = 0.1, speed_9_to_5 = 0.05 }\n")
    free = (MODULUS, "chain.precompression=0..1 N")
    found = fit(path, free=free[:1], laws=["viscoelastic", "power"], quick=True, results=tmp_path)
    table: Any = design(found, ["striker.speed=0.5..4"], candidates=3).table
    assert table["expected"].max() < 1e-3
    pinned: Any = design(found, ["striker.speed=0.5..4"], pin="contact.gamma", candidates=1).table
    assert pinned["expected"].notna().all()
    loaded = fit(path, free=free, laws=["viscoelastic"], quick=True, results=tmp_path)
    assert design(loaded, ["striker.speed=0.5..4"], pin=MODULUS, candidates=1).table["problem"][1] == ""
    with pytest.raises(InputError, match="that the fit has not found"):
        design(found, [f"{MODULUS}=1 GPa..2 GPa"])


@pytest.mark.long
def test_a_design_pins_a_parameter_down_at_the_error_that_a_fit_then_has(tmp_path: Path) -> None:
    path = make_up(tmp_path / "shot.csv", "viscoelastic", 0.06, (2,), "fig4", SHORT)
    laws, settings = ["viscoelastic"], dict(text.split("=") for text in SHORT)
    found = fit("fig4", free=[MODULUS], laws=laws, settings=settings, measured=path, quick=True, results=tmp_path)
    designed = design(found, ["striker.speed=0.5..4"], pin="contact.restitution", candidates=4)
    table: Any = designed.table
    assert table["expected"].idxmin() == designed.best
    assert table["striker.speed"][designed.best] == table["striker.speed"].max(), "the noise is the same"
    assert table["expected"][0] == pytest.approx(found.fits["viscoelastic"].errors[1], rel=0.1), "as it was"


def shifted(problem: Problem, start: Fit) -> dict[str, float]:
    return least_squares(problem, [start.values], search=False).values


def test_numbers_taken_as_exact_move_parameters_as_a_repeated_fit_does(tmp_path: Path) -> None:
    found = fitted(tmp_path, "viscoelastic", 0.06, 3, ("viscoelastic",))
    one, path = found.fits["viscoelastic"], tmp_path / "shot.csv"
    changes: Any = taken_as_exact(one).set_index(["key", "parameter"])["change_by_1pct"]
    settings = (*law_of("viscoelastic"), *found.request.settings)
    for setting, key in (("striker.speed=2.02 m/s", "striker.speed"), ("chain.mass=0.123826 g", "chain.mass")):
        data = scene_data("fig4", (*settings, setting), path)
        again = shifted(pose([data], (MODULUS, "contact.restitution")), one)
        for name in (MODULUS, "contact.restitution"):
            assert again[name] - one.values[name] == pytest.approx(
                changes[key, name], rel=0.1, abs=1e-3 * one.errors[1]
            )
    data = scene_data("fig4", settings, path)
    unsure = pose([data], (MODULUS, "contact.restitution", "striker.speed=±0.1%"))
    grown = np.hypot(one.errors[0], changes["striker.speed", MODULUS] / 10)
    assert least_squares(unsure, [one.values], search=False).errors[0] == pytest.approx(grown, rel=0.03)
    assert grown > 1.05 * one.errors[0]
