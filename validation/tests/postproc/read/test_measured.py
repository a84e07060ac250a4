"""Measured traces and quoted values: read with their units, refused in one line, not part of a run."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.engines import load_engine
from drivers.run.run import run_case
from drivers.scene.model import MeasuredEntry
from drivers.scene.read_scene import read_scene
from postproc.read.measured import MeasuredTrace, read_measured, read_quoted
from validation.accuracy.plan import planned_case
from validation.tests.helpers.scenes import SceneWriter

GAUGES = ("bead_3", "wall")
TIME_US = np.arange(64.0)
PULSE = np.exp(-(((TIME_US - 30) / 5) ** 2))
ENTRY = '[[measured]]\nfile = "trace.csv"\n'
SENSORS = "sensors = [{ from_wall = 3 }]"


def written(
    folder: Path, header: str = "time_us,wall_N", style: str = ",.", encoding: str = "utf-8", **cells: object
) -> Path:
    """Writes a file with a pulse below headings.

    Args:
        folder: Folder of the file.
        header: Lines above the numbers, the last with as many cells as columns.
        style: Separator and decimal mark, as the first two characters; further ones are appended to each row.
        encoding: Encoding of the file.
        **cells: ``at_ROW_COLUMN`` replaces a cell.
    """
    separator, decimal, tail = style[0], style[1], style[2:]
    columns = header.strip().rpartition("\n")[2].replace(" [", "[").rstrip(separator).count(separator)
    rows = [[str(x).replace(".", decimal) for x in row] for row in zip(TIME_US, *[PULSE] * columns, strict=True)]
    for change, text in cells.items():
        _, row, column = change.split("_")
        rows[int(row)][int(column)] = str(text)
    path = folder / "trace.csv"
    path.write_text("\n".join([header, *(separator.join(row) + tail for row in rows), ""]), encoding, newline="")
    return path


def read(scene: Path, *settings: str) -> MeasuredTrace:
    found = read_scene(scene, settings)
    return read_measured(found.measured[0], found.folder, GAUGES, found.file, "measured.0")


@pytest.fixture
def scene(scene_file: SceneWriter) -> Path:
    path = scene_file(chain=SENSORS)
    path.write_text(path.read_text() + ENTRY)
    return path


WALL = 'gauges = { wall = "CH1" }\n'
VOLTS = f'{WALL}gain = "1 N/V"'
TEKTRONIX = "Model,TBS1102\nRecord Length,2500\nSample Interval,4e-7\n\nVertical Scale,0.5,0.2\n,\n"
# header, style, encoding, keys of the entry
FILES = [
    ("time_us,wall_N", ",.", "utf-8", ""),
    ("time_µs,wall_N", ",.", "latin-1", ""),
    ("time (µs)\twall (N)", "\t.", "utf-16", ""),
    ("\ufefftime_us, wall_N", ",.", "utf-8", ""),
    ('"time [us]","CH1 [V]"', ",.", "utf-8", VOLTS),
    ("t,CH1 [V]", ",.", "utf-8", 'time_unit = "us"\ngauges = { wall = "CH1 [V]" }\ngain = "0.001 V/mN"'),
    ("t_us,CH1_V,CH2_V", ",.", "utf-8", 'time = "t"\ngauges = { wall = "CH1_V" }\ngain = "1 kV/kN"'),
    ("# of an oscilloscope\n\ntime_us;wall_N;", ";,;", "utf-8", ""),
    ("Shot 12, PTFE chain\nof 1 May\n\ntime_us\twall_N", "\t,", "utf-8", ""),
    ("time [us] wall [N]", " .", "utf-8", ""),
    (f"{TEKTRONIX}TIME,CH1\nmicroseconds,Volts", ",.", "utf-8", VOLTS),
    ("x-axis,1\nusec,Volt", ",.\r", "utf-8", 'gauges = { wall = "1" }\ngain = "1 N/V"'),
    ("Time;Channel A;Other\n(us);(mV);()\n", ";,", "utf-8-sig", 'gauges = { wall = "Channel A" }\ngain = "1 kN/V"'),
]


@pytest.mark.parametrize(("header", "style", "encoding", "keys"), FILES)
def test_files_are_read_as_oscilloscopes_write_them(
    scene: Path, header: str, style: str, encoding: str, keys: str
) -> None:
    written(scene.parent, header, style, encoding)
    scene.write_text(scene.read_text() + keys)
    trace = read(scene)
    assert np.allclose(trace.time_s, TIME_US * 1e-6, rtol=1e-12)
    assert list(trace.reading) == ["wall"]
    assert np.allclose(trace.reading["wall"] * trace.gain, PULSE, rtol=1e-12)


def test_stated_values_come_in_si_units(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = written(tmp_path_factory.mktemp("elsewhere"), "time_us,CH1 [mV],CH2 [mV]")
    keys = """gauges = { wall = "CH2", bead_3 = "CH1" }
gain = "-2.1 N/V"
gain_uncertainty = 0.03
trigger = "-12 us"
baseline = "3 mV"
noise = "5 uV"
drift = true
"""
    scene.write_text(scene.read_text().replace("trace.csv", str(file)) + keys)
    with pytest.raises(InputError, match="a negative gain inverts the trace"):
        read(scene)
    trace = read(scene, "measured.0.gain=2.1 N/V")
    assert (trace.gain, trace.gain_uncertainty, trace.trigger_s) == (2.1, 0.03, -12e-6)
    assert (trace.baseline, trace.noise, trace.drift) == (3e-3, 5e-6, True)
    assert list(trace.reading) == ["wall", "bead_3"]
    assert trace.reading["wall"].max() == 1e-3


# changes of the file, settings, then parts of the message: where and key, found, allowed
BAD_FILES = [
    ({}, ["file=none.csv"], "scene.toml", "measured.0.file", "no such file", "a CSV file"),
    ({}, ["time=t"], "scene.toml", "measured.0.time", 'no column "t"', "time_us, wall_N"),
    ({}, ["gauges={bead_9='wall'}"], "scene.toml", "measured.0.gauges.bead_9", "an unknown gauge", "bead_3, wall"),
    ({"header": "time_us,CH1_N"}, [], "scene.toml", "measured.0.gauges", "CH1_N", 'gauges = { bead_3 = "CH1_N" }'),
    ({"header": "time_us,CH1_N"}, ["gauges={wall='Ch 1'}"], "scene.toml", "wall", '"Ch 1"', "did you mean CH1_N?"),
    ({"header": "time_us,wall_N,wall_V"}, [], "scene.toml", "measured.0.gauges", "more than one", "wall_V"),
    ({"header": "time_N,wall_N"}, [], "scene.toml", "measured.0.time_unit", '"N" for "time_N"', "a unit of time"),
    ({"header": "time (us),wall\nms,N"}, [], "scene.toml", "measured.0.time_unit", '"us and ms"', "a unit of time"),
    ({}, ["time_unit=ms"], "scene.toml", "measured.0.time_unit", 'us and ms for "time_us"', "one unit"),
    ({"header": "time_us,wall [parrots]"}, [], "scene.toml", "measured.0.unit", '"parrots"', "a unit of force"),
    ({"header": "time_us,wall"}, [], "scene.toml", "measured.0.unit", 'unit = "mV"', ""),
    ({"header": "time_us,wall_V"}, [], "scene.toml", "measured.0.gain", 'gain = "2.1 N/V"', ""),
    ({"header": "time_us,wall_V"}, ["gain=2"], "scene.toml", "measured.0.gain", "2", "N/V"),
    ({"header": "time_us,wall_V"}, ["gain=2 N/A"], "scene.toml", "measured.0.gain", "2 N/A", "N/V"),
    ({}, ["gain=0"], "scene.toml", "measured.0.gain", "0", "other than 0"),
    ({}, ["baseline=2 mV"], "scene.toml", "measured.0.baseline", "2 mV", "2 N"),
    ({}, ["noise=2 N"], "trace.csv", "wall_N", "nothing rises above noise", "a pulse"),
    ({"header": "time_us,wall_N,bead_3_V"}, ["gain=2"], "scene.toml", "0.gauges", "in N and V", "of one unit"),
    ({"at_5_1": "x"}, [], "trace.csv", "line 7, wall_N", '"x"', "a finite number"),
    ({"at_63_0": "inf"}, [], "trace.csv", "line 65, time_us", "inf", "a finite number"),
    ({"at_5_1": '"0,5"'}, [], "trace.csv", "line 7, wall_N", "0,5", 'decimals with "."'),
    ({"at_5_1": '"1,234.5"'}, [], "trace.csv", "line 7, wall_N", "1,234.5", "no thousands separators"),
    ({"style": ",,"}, [], "trace.csv", "line 2", "more than 2 cells", "decimal commas need semicolons"),
    ({"header": "# time_us,wall_N"}, [], "trace.csv", "line 2", "without headings", "without #"),
    ({"at_9_0": "8"}, [], "trace.csv", "line 11, time_us", "8 after 8", "times that increase"),
    ({"at_9_1": "1,2"}, [], "trace.csv", "line 11", "more than 2 cells", "2, as many as"),
    ({"at_9_1": '"1'}, [], "trace.csv", "line 2", "more than 2 cells", "quotation marks in pairs"),
]  # fmt: skip


@pytest.mark.parametrize(("file", "settings", "where", "key", "found", "allowed"), BAD_FILES)
def test_a_bad_file_is_named_in_one_line(
    scene: Path, file: dict[str, str], settings: list[str], where: str, key: str, found: str, allowed: str
) -> None:
    written(scene.parent, **file)
    must_refuse(scene, settings, where, key, found, allowed)


def test_messages_on_a_file_alone_name_the_measured_table(tmp_path: Path) -> None:
    for header, start in (
        ("time [us],CH1 [mV]", "measured.gauges: found headings time [us], CH1 [mV]"),
        ("time [us],wall [mV]", "measured.gain: missing key"),
    ):
        entry = MeasuredEntry(file=str(written(tmp_path, header)))
        with pytest.raises(InputError) as caught:
            read_measured(entry, Path(), GAUGES, "--measured trace.csv")
        assert start in str(caught.value)
        assert "in [[measured]], such as " in str(caught.value)


def must_refuse(scene: Path, settings: list[str], *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        read(scene, *(f"measured.0.{setting}" for setting in settings))
    where, key, found, allowed = caught.value.args
    assert "\n" not in str(caught.value)
    assert parts[0] in where
    assert parts[1] in f"{where}: {key}"
    assert parts[2] in found
    assert parts[3] in allowed


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "an empty file"),
        (b"time_us,wall_N\n", "no table of numbers"),
        (b"time_us|wall_N\n" + b"1|2\n" * 20, "no table of numbers"),
        (b"time_us,wall_N\n" + b"".join(b"%d,%d\n" % (i, i) for i in range(15)), "15 samples"),
        (b"time_us,wall_N\n" + b"".join(b"%d,3\n" % i for i in range(99)), "a constant"),
        (b"time_us;wall_N\n" + b"".join(b"%d;2,04%d\n" % (i, i % 9) for i in range(99)), '"2,040", thousands'),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "no table of numbers"),
    ],
)
def test_a_file_that_is_no_table_is_named(scene: Path, content: bytes, found: str) -> None:
    (scene.parent / "trace.csv").write_bytes(content)
    must_refuse(scene, [], "trace.csv", "", found, "")


@pytest.mark.parametrize(("samples", "slope"), [(16, 0.0), (100, 1e-3), (10_000, 0.0)])
def test_noise_and_drift_below_it_are_no_pulse(scene: Path, samples: int, slope: float) -> None:
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, samples) + slope * np.arange(samples)
        table = pd.DataFrame({"time_us": np.arange(samples), "wall_N": noise})
        table.to_csv(scene.parent / "trace.csv", index=False)
        must_refuse(scene, [], "trace.csv", "wall_N", "no pulse", "a pulse")
        table["wall_N"] += 30 * np.exp(-((table["time_us"] - samples / 2) ** 2))
        table.to_csv(scene.parent / "trace.csv", index=False)
        read(scene)


BAD_ENTRIES = [
    ("", "measured.0", "no file and no values", "exactly one"),
    ('file = "a.csv"\nvalues = { a = 1 }', "measured.0", "both", "exactly one"),
    ('file = "a.csv"\nerrors = { a = 1 }', "measured.0.errors", "errors", "gain_uncertainty"),
    ('file = "a.csv"\ngain = nan', "measured.0.gain", "nan", "with its unit"),
    ('file = "a.csv"\ngain_uncertainty = -0.1', "measured.0.gain_uncertainty", "-0.1", "0 or more"),
    ('file = "a.csv"\ntrigger = 12', "measured.0.trigger", "12", '"12 us"'),
    ('file = "a.csv"\ngauges = {}', "measured.0.gauges", "empty", "CH1"),
    ("values = { a = 1 }", "measured.0.errors.a", "missing key", "relative standard error"),
    ("values = { a = 1 }\nerrors = { a = 0 }", "measured.0.errors.a", "0", "above 0"),
    ("values = { a = 1 }\nerrors = { a = 1, b = 1 }", "measured.0.errors.b", "without a value", "a"),
    ('values = { a = 1 }\nerrors = { a = 1 }\ngain = 2', "measured.0.gain", "with values", "errors, gain_uncert"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "key", "found", "allowed"), BAD_ENTRIES)
def test_a_bad_entry_is_named_in_one_line(
    scene_file: SceneWriter, keys: str, key: str, found: str, allowed: str
) -> None:
    path = scene_file()
    path.write_text(f"{path.read_text()}\n[[measured]]\n{keys}\n")
    with pytest.raises(InputError) as caught:
        read_scene(path)
    assert caught.value.args[1] == key
    assert found in caught.value.args[2]
    assert allowed in "".join(caught.value.args[2:4])
    assert "\n" not in str(caught.value)


NAMES = (
    "bead_9_amplitude_N",
    "speed_9_to_5_m_s",
    "wall_envelope_per_s",
    "bead_5_width_4pct_diameters",
    "bead_9_peak_N",
)


def quoted_of(scene_file: SceneWriter, **values: str) -> dict[str, tuple[float, float]]:
    path = scene_file()
    quoted, errors = (
        ", ".join(f"{name} = {own}" for name, own in given.items()) for given in (values, dict.fromkeys(values, 0.1))
    )
    path.write_text(f"{path.read_text()}\n[[measured]]\nvalues = {{ {quoted} }}\nerrors = {{ {errors} }}\n")
    scene = read_scene(path)
    return read_quoted(scene.measured[0], NAMES, scene.file, "measured.0")


@pytest.mark.parametrize(
    ("name", "value", "full", "number"),
    [
        ("bead_9_amplitude", '"2 N"', "bead_9_amplitude_N", 2.0),
        ("bead_9_amplitude_N", '"2000 mN"', "bead_9_amplitude_N", 2.0),
        ("wall_envelope", '"-0.0067 us^-1"', "wall_envelope_per_s", -6700.0),
        ("bead_5_width_4pct", "4.1", "bead_5_width_4pct_diameters", 4.1),
    ],
)
def test_quoted_values_come_in_si_units(
    scene_file: SceneWriter, name: str, value: str, full: str, number: float
) -> None:
    quoted = quoted_of(scene_file, **{name: value})
    assert [*quoted] == [full]
    assert quoted[full] == pytest.approx((number, 0.1), rel=1e-14)


@pytest.mark.parametrize(
    ("name", "value", "found", "allowed"),
    [
        ("bead_9_amplitud", '"2 N"', "an unknown observable", "(did you mean bead_9_amplitude?)"),
        ("bead_9_amplitude", "2", "2", '"2 N"'),
        ("bead_9_amplitude", '"2 V"', "2 V", '"2 N"'),
        ("bead_5_width_4pct", '"4 mm"', "4 mm", "a plain number"),
        ("wall_envelope", '"2 N"', "2 N", '"2 s^-1"'),
        ("bead_9_amplitude", '"0 N"', "0 N", "a value other than 0"),
    ],
)
def test_a_bad_quoted_value_is_named(scene_file: SceneWriter, name: str, value: str, found: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        quoted_of(scene_file, **{name: value})
    assert caught.value.args[1] == f"measured.0.values.{name}"
    assert found in caught.value.args[2]
    assert allowed in caught.value.args[3]


def test_an_observable_is_quoted_once(scene_file: SceneWriter) -> None:
    with pytest.raises(InputError, match="bead_9_amplitude twice"):
        quoted_of(scene_file, bead_9_amplitude='"2 N"', bead_9_amplitude_N='"2 N"')


@pytest.mark.parametrize("engine", ["verlet", "reference"])
def test_measured_traces_are_not_part_of_a_run(scene_file: SceneWriter, tmp_path: Path, engine: str) -> None:
    """Deck and record are the same; an earlier run is found, and the measured file is not read."""
    path = scene_file(chain=SENSORS)
    plain = planned_case(path)
    before = run_case(plain, engine, tmp_path / "runs")
    path.write_text(
        f"{path.read_text()}{ENTRY}[[measured]]\nvalues = {{ wall_peak = '2 N' }}\nerrors.wall_peak = 0.1\n"
    )
    case = planned_case(path)
    assert len(case.scene.measured) == 2
    assert load_engine(engine).render(case) == load_engine(engine).render(plain)
    assert case.scene.model_dump(mode="json") == plain.scene.model_dump(mode="json")
    again = run_case(case, engine, tmp_path / "runs")
    assert (again.folder, again.record) == (before.folder, before.record)
