"""``beads fit``: laws compared, predictions, and the folder that can be sent."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.scene.read_scene import read_scene
from validation.calibration.command import fit, read_fits
from validation.calibration.parameters import calibration_file, law_of
from validation.report.parts import read_part
from validation.tests.helpers.commands import beads
from validation.tests.validation.calibration.test_fit import MODULUS, RESTITUTION, SHORT, made_up


@pytest.mark.long
def test_quoted_numbers_give_a_folder_without_traces_unless_another_has_its_name(tmp_path: Path) -> None:
    """The fitted mass is replaced inside its inline table, where a comment would be invalid TOML."""
    free = ("--free", "chain.sensors.0.mass", "--free", RESTITUTION)
    words = ("fit", *free, "--quoted", "fig4", "--quick", "--results", tmp_path)
    folder = tmp_path / "fit-fig4"
    folder.mkdir()
    (folder / "notes.txt").touch()
    done = beads(*words)
    assert done.returncode == 2
    assert "a folder that is not of a fit" in done.stderr
    assert [path.name for path in tmp_path.rglob("*.*")] == ["notes.txt"]
    shutil.rmtree(folder)
    assert beads(*words).returncode == 0
    tables = {f"{name}.csv" for name in ("parameters", "data", "laws", "exact")}
    names = {"fit.json", "fit-fig4.toml", "parameters.png", "parameters.svg"} | tables
    assert {path.name for path in folder.glob("[!.]*")} == names
    part = read_part("fit-fig4", tmp_path)  # for the page
    assert part
    assert [*part.figures] == ["parameters"]
    assert read_scene(folder / "fit-fig4.toml").chain.sensors[0].mass != 1.16e-4


@pytest.mark.long
def test_a_folder_works_wherever_it_is_copied_to(tmp_path: Path) -> None:
    """Its scenes read their data from it, it fits again, and overlay takes the fitted scene."""
    done = beads(
        *("fit", "example-measured", "--free", MODULUS, "--quick", "--set", "contact.restitution=0.97"),
        *("--set", "contact.friction=0.1", "--results", tmp_path / "first"),
    )
    assert done.returncode == 0, done.stderr
    sent = tmp_path / "sent" / "folder"
    shutil.copytree(tmp_path / "first" / "fit-example-measured", sent)
    shutil.rmtree(tmp_path / "first")
    fitted = read_scene(sent / "fit-example-measured.toml")
    assert {entry.file for entry in fitted.measured if entry.file} == {"data/example-measured.csv"}
    assert {entry.trigger for entry in fitted.measured if entry.file} == {40e-6}
    assert fitted.contact.friction == 0.1
    assert fitted.materials["ptfe"].youngs_modulus == pytest.approx(1.35e9, rel=5e-3)
    text = (sent / "fit-example-measured.toml").read_text(encoding="utf-8")
    assert "# INVENTED readings" in text
    assert "# fitted: 1.35" in text
    again = beads("fit", sent, "--quick", "--results", tmp_path / "again")
    over = beads("overlay", sent / "fit-example-measured.toml", "--results", tmp_path / "over")
    assert again.stdout.splitlines()[:4] == done.stdout.splitlines()[:4]
    assert over.returncode == 0, over.stderr


@pytest.mark.long
def test_laws_are_compared_on_the_same_data_and_a_second_fit_replaces_their_files_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trace is viscoelastic; the second fit is made inside the folder, and its data file is named like a table."""
    trace, folder = made_up(tmp_path / "data.csv", noise=0.01), tmp_path / "results" / "fit-fig4"
    laws = [word for law in ("elastic", "viscoelastic") for word in ("--law", law)]
    asked = ("--free", MODULUS, *laws, "--quick")
    short = [word for setting in SHORT for word in ("--set", setting)]
    done = beads("fit", "fig4", *short, "--measured", trace, *asked, "--results", tmp_path / "results")
    assert done.returncode == 0, done.stderr
    assert "the model does not explain the data" in done.stdout
    assert "viscoelastic is the best law" in done.stdout
    names = {path.name for path in folder.glob("fit-*.toml")}
    assert names == {"fit-fig4-elastic.toml", "fit-fig4-viscoelastic.toml"}
    table = pd.read_csv(folder / "laws.csv")
    assert table["law"].tolist() == ["elastic", "viscoelastic"]
    assert table["freedom"][0] == table["freedom"][1] + 1
    (folder / "notes.txt").touch()
    monkeypatch.chdir(folder)
    done = beads("fit", "fig4.toml", "--free", MODULUS, "--quick", "--results", "..")
    assert done.returncode == 0, done.stderr
    assert [path.name for path in folder.glob("fit-*.toml")] == ["fit-fig4.toml"]
    assert (folder / "notes.txt").is_file()
    assert (folder / "data" / "data.csv").read_bytes() == trace.read_bytes()


def test_constants_of_laws_are_fixed_and_damaged_tables_refused(tmp_path: Path) -> None:
    laws = ("power,gamma=3", "power", "viscoelastic")
    free = [MODULUS, "contact.alpha=1..2"]
    found = fit(quoted=["fig4"], free=free, laws=laws, quick=True, results=tmp_path)
    keys = {law: {key for key in each.values if key.startswith("contact")} for law, each in found.fits.items()}
    assert keys == {laws[0]: {"contact.alpha"}, laws[1]: {"contact.alpha", "contact.gamma"}, laws[2]: {RESTITUTION}}
    assert [*read_fits(found.folder).fits] == [*laws]
    assert found.tables["laws"]["law"].to_dict() == dict(enumerate(laws))
    for text in ("", "a,b\n1,2\n", "law,parameter,value\npower,contact.gamma,much\n"):
        (found.folder / "parameters.csv").write_text(text)
        with pytest.raises(InputError, match=r"fit-fig4.*damaged tables.*fits again"):
            read_fits(found.folder)


def test_a_law_of_ones_own_starts_at_an_end_of_its_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(calibration_file().start, "contact.gamma")
    assert "contact.gamma=5" in law_of("power", {"contact.gamma": "contact.gamma=0..5"})
    assert "contact.gamma=3" in law_of("power,gamma=3")
    with pytest.raises(InputError, match=r"no start of contact.gamma; allowed: bounds"):
        law_of("power")
