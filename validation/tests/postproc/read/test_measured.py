"""Measured traces and quoted values: read with their units, refused in one line, not part of a run."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.run.run import run_case
from drivers.scene.read_scene import read_scene
from postproc.read.measured import MeasuredTrace, read_measured, read_quoted
from validation.accuracy.plan import planned_case
from validation.tests.helpers.commands import assert_in_order
from validation.tests.helpers.scenes import SceneWriter

GAUGES = ("bead_3", "wall")
NAMES = ("bead_9_amplitude_N", "wall_envelope_per_s", "bead_5_width_4pct_diameters", "bead_9_peak_N")
TIME_US = np.arange(64.0)
PULSE = np.exp(-(((TIME_US - 30) / 5) ** 2))
FILE = 'file = "trace.csv"\n'
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


def read(path: Path) -> MeasuredTrace | dict[str, tuple[float, float]]:
    """The trace, or the quoted values, of a scene's only entry."""
    scene = read_scene(path)
    (entry,) = scene.measured
    if entry.file:
        return read_measured(entry, scene.folder, GAUGES, scene.file, "measured.0")
    return read_quoted(entry, NAMES, scene.file, "measured.0")


def trace_of(path: Path) -> MeasuredTrace:
    trace = read(path)
    assert isinstance(trace, MeasuredTrace)
    return trace


@pytest.fixture
def scene(scene_file: SceneWriter) -> Path:
    return scene_file(chain=SENSORS)


def add_entry(scene: Path, keys: str) -> None:
    scene.write_text(f"{scene.read_text()}[[measured]]\n{keys}\n")


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
    add_entry(scene, FILE + keys)
    trace = trace_of(scene)
    assert np.allclose(trace.time_s, TIME_US * 1e-6, rtol=1e-12)
    assert list(trace.reading) == ["wall"]
    assert np.allclose(trace.reading["wall"] * trace.gain, PULSE, rtol=1e-12)


def test_stated_values_of_a_trace_come_in_si_units(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = written(tmp_path_factory.mktemp("elsewhere"), "time_us,CH1 [mV],CH2 [mV]")
    keys = """gauges = { wall = "CH2", bead_3 = "CH1" }
gain = "0.5 V/N"
gain_uncertainty = 0.03
trigger = "-12 us"
baseline = "3 mV"
noise = "5 uV"
drift = true
"""
    add_entry(scene, f'file = "{file}"\n{keys}')
    trace = trace_of(scene)
    assert (trace.gain, trace.gain_uncertainty, trace.trigger_s) == (2.0, 0.03, -12e-6)
    assert (trace.baseline, trace.noise, trace.drift) == (3e-3, 5e-6, True)
    assert list(trace.reading) == ["wall", "bead_3"]
    assert trace.reading["wall"].max() == 1e-3


def test_quoted_values_come_in_si_units(scene: Path) -> None:
    stated = {
        "bead_9_amplitude": "'2 N'", "bead_9_peak_N": "'2000 mN'",
        "wall_envelope": "'-0.0067 us^-1'", "bead_5_width_4pct": "4.1",
    }  # fmt: skip
    values, errors = (
        ", ".join(f"{name} = {text}" for name, text in texts.items())
        for texts in (stated, dict.fromkeys(stated, "0.1"))
    )
    add_entry(scene, f"values = {{ {values} }}\nerrors = {{ {errors} }}")
    expected = {
        "bead_9_amplitude_N": 2.0, "bead_9_peak_N": 2.0,
        "wall_envelope_per_s": -6700.0, "bead_5_width_4pct_diameters": 4.1,
    }  # fmt: skip
    quoted = read(scene)
    assert isinstance(quoted, dict)
    assert {name: value for name, (value, _) in quoted.items()} == pytest.approx(expected, rel=1e-14)
    assert {error for _, error in quoted.values()} == {0.1}


def table(separator: str, rows: Iterable[str]) -> bytes:
    return "\n".join([f"time_us{separator}wall_N", *rows, ""]).encode()


# changes of the file or its bytes, keys of the entry, then parts of the message: place, found, allowed
BAD_FILES: list[tuple[dict[str, str] | bytes, str, str, str, str]] = [
    ({}, 'gauges = { bead_9 = "wall" }', "measured.0.gauges.bead_9", "an unknown gauge", "bead_3, wall"),
    ({"header": "time_us,CH1_N"}, "", "measured.0.gauges", "CH1_N", 'gauges = { bead_3 = "CH1_N" }'),
    ({"header": "time_us,CH1_N"}, "gauges = { wall = 'Ch 1' }", "gauges.wall", '"Ch 1"', "did you mean CH1_N?"),
    ({"header": "time_us,wall_N,wall_V"}, "", "measured.0.gauges", "more than one", "wall_V"),
    ({"header": "time_N,wall_N"}, "", "measured.0.time_unit", '"N" for "time_N"', "a unit of time"),
    ({"header": "time (us),wall\nms,N"}, "", "measured.0.time_unit", '"us and ms"', "a unit of time"),
    ({}, 'time_unit = "ms"', "measured.0.time_unit", 'us and ms for "time_us"', "one unit"),
    ({"header": "time_us,wall [parrots]"}, "", "measured.0.unit", '"parrots"', "a unit of force"),
    ({"header": "time_us,wall"}, "", "measured.0.unit", "missing key", 'unit = "mV"'),
    ({"header": "time_us,wall_V"}, "", "measured.0.gain", "missing key", 'gain = "2.1 N/V"'),
    ({"header": "time_us,wall_V"}, 'gain = "2 N/A"', "measured.0.gain", "2 N/A", "N/V"),
    ({}, "gain = 0", "measured.0.gain", "0", "other than 0"),
    ({}, "gain = -2", "trace.csv: wall_N", "no pulse", "a gain of the other sign"),
    ({}, 'baseline = "2 mV"', "measured.0.baseline", "2 mV", "2 N"),
    ({}, 'noise = "2 N"', "trace.csv: wall_N", "nothing rises above noise", "a pulse"),
    ({"header": "time_us,wall_N,bead_3_V"}, "gain = 2", "measured.0.gauges", "in N and V", "of one unit"),
    ({"at_5_1": "x"}, "", "trace.csv: line 7, wall_N", '"x"', "a finite number"),
    ({"at_63_0": "inf"}, "", "trace.csv: line 65, time_us", "inf", "a finite number"),
    ({"at_5_1": '"0,5"'}, "", "trace.csv: line 7, wall_N", "0,5", 'decimals with "."'),
    ({"at_5_1": '"1,234.5"'}, "", "trace.csv: line 7, wall_N", "1,234.5", "no thousands separators"),
    ({"style": ",,"}, "", "trace.csv: line 2", "more than 2 cells", "decimal commas need semicolons"),
    ({"header": "# time_us,wall_N"}, "", "trace.csv: line 2", "without headings", "without #"),
    ({"at_9_0": "8"}, "", "trace.csv: line 11, time_us", "8 after 8", "times that increase"),
    ({"at_9_1": "1,2"}, "", "trace.csv: line 11", "more than 2 cells", "2, as many as"),
    ({"at_9_1": '"1'}, "", "trace.csv: line 11, wall_N", "1 10.0", "quotation marks in pairs"),
    (b"", "", "trace.csv", "an empty file", ""),
    (table(",", []), "", "trace.csv", "no table of numbers", ""),
    (table("|", ["1|2"] * 20), "", "trace.csv", "no table of numbers", ""),
    (table(",", [f"{i},{i}" for i in range(15)]), "", "trace.csv", "15 samples", "at least 16"),
    (table(",", [f"{i},3" for i in range(99)]), "", "trace.csv", "a constant", ""),
    (table(";", [f"{i};2,04{i % 9}" for i in range(99)]), "", "trace.csv", '"2,040", thousands', ""),
    (b"\x89PNG\r\n\x1a\n\x00\x00", "", "trace.csv", "no table of numbers", ""),
]
BAD_ENTRIES = [
    ('file = "none.csv"', "measured.0.file", "no such file", "a CSV file"),
    ("", "measured.0", "no file and no values", "exactly one"),
    ('file = "a.csv"\nvalues = { a = 1 }', "measured.0", "both", "exactly one"),
    ('file = "a.csv"\nerrors = { a = 1 }', "measured.0.errors", "errors", "gain_uncertainty"),
    ('file = "a.csv"\ngain = nan', "measured.0.gain", "nan", "with its unit"),
    ('file = "a.csv"\ngain_uncertainty = -0.1', "measured.0.gain_uncertainty", "-0.1", "greater than or equal to 0"),
    ('file = "a.csv"\ntrigger = 12', "measured.0.trigger", "12", '"12 us"'),
    ('file = "a.csv"\ngauges = {}', "measured.0.gauges", "{}", "at least 1 item"),
    ("values = { a = 1 }", "measured.0.errors.a", "missing key", "relative standard error"),
    ("values = { a = 1 }\nerrors = { a = 0 }", "measured.0.errors.a", "0", "greater than 0"),
    ("values = { a = 1 }\nerrors = { a = 1, b = 1 }", "measured.0.errors.b", "without a value", "a"),
    ("values = { a = 1 }\nerrors = { a = 1 }\ngain = 2", "measured.0.gain", "with values", "errors, gain_uncert"),
    (
        "values = { wall_envelope = '2 s^-1', wall_envelope_per_s = '2 s^-1' }\n"
        "errors = { wall_envelope = 1, wall_envelope_per_s = 1 }",
        "wall_envelope_per_s",
        "wall_envelope twice",
        "once",
    ),
]
BAD_VALUES = [
    ("bead_9_amplitud", "'2 N'", "an unknown observable", "(did you mean bead_9_amplitude?)"),
    ("bead_9_amplitude", "2", "2", '"2 N"'),
    ("bead_5_width_4pct", "'4 mm'", "4 mm", "a plain number"),
    ("wall_envelope", "'2 N'", "2 N", '"2 s^-1"'),
    ("bead_9_amplitude", "'0 N'", "0 N", "a value other than 0"),
]
BAD = [
    *((file, FILE + keys, *parts) for file, keys, *parts in BAD_FILES),
    *((b"", entry, *parts) for entry, *parts in BAD_ENTRIES),
    *(
        (b"", f"values = {{ {name} = {value} }}\nerrors.{name} = 1", f"measured.0.values.{name}", *parts)
        for name, value, *parts in BAD_VALUES
    ),
]


@pytest.mark.parametrize(("file", "entry", "place", "found", "allowed"), BAD, ids=range(len(BAD)))
def test_a_bad_file_or_entry_is_named_in_one_line(
    scene: Path, file: dict[str, str] | bytes, entry: str, place: str, found: str, allowed: str
) -> None:
    if isinstance(file, bytes):
        (scene.parent / "trace.csv").write_bytes(file)
    else:
        written(scene.parent, **file)
    add_entry(scene, entry)
    with pytest.raises(InputError) as caught:
        read(scene)
    assert "\n" not in str(caught.value)
    assert_in_order(str(caught.value), place, found, allowed)


@pytest.mark.parametrize(("samples", "slope"), [(16, 0.0), (100, 1e-3), (10_000, 0.0)])
def test_noise_and_drift_below_it_are_no_pulse(scene: Path, samples: int, slope: float) -> None:
    add_entry(scene, FILE)
    for seed in range(3):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, samples) + slope * np.arange(samples)
        pulse = 30 * np.exp(-((np.arange(samples) - samples / 2) ** 2))
        frame = pd.DataFrame({"time_us": np.arange(samples), "wall_N": noise})
        frame.to_csv(scene.parent / "trace.csv", index=False)
        with pytest.raises(InputError, match="no pulse"):
            read(scene)
        frame.assign(wall_N=noise + pulse).to_csv(scene.parent / "trace.csv", index=False)
        read(scene)


def test_measured_traces_are_not_part_of_a_run(scene: Path, tmp_path: Path) -> None:
    """Deck and record are the same; an earlier run is found, and the measured file is not read."""
    plain = planned_case(scene)
    before = run_case(plain, "verlet", tmp_path / "runs")
    add_entry(scene, FILE)
    add_entry(scene, "values = { wall_peak = '2 N' }\nerrors.wall_peak = 0.1")
    case = planned_case(scene)
    assert len(case.scene.measured) == 2
    assert case.scene.model_dump(mode="json") == plain.scene.model_dump(mode="json")
    again = run_case(case, "verlet", tmp_path / "runs")
    assert (again.folder, again.record) == (before.folder, before.record)
