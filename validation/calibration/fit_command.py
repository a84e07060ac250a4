"""``python -m validation fit``: finds free parameters of scenes by measured data, and has codes confirm the scene."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.progress import step
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.engines import codes
from drivers.limits.refusal import inability
from drivers.scene.read_scene import find_scene, lay_over, read_scene, set_value
from drivers.scene.settings import look_up
from validation.calibration.certainty import RISES
from validation.calibration.data_sets import DataSet, paper_data, scene_data
from validation.calibration.free import GAIN, TRIGGER, Free
from validation.calibration.outcome import Outcome, interval_in_words, solve, value_in_words
from validation.calibration.problem import Problem, pose
from validation.calibration.rows import DatumRow, Parameter, datum_rows, parameter_rows
from validation.compare.asked import Asked
from validation.compare.comparison import compare_scenes
from validation.studies import write_table

MEASURED = "measured"


@dataclass(frozen=True)
class Wanted:
    """What a command asks for.

    Attributes:
        free, own: options ``--free`` and ``--own``, a key each, with bounds or without.
        quoted: names of data sets of the paper.
        measured: a CSV file in place of those of the scene.
        quick: without profiles, left-out data and codes.
    """

    scenes: Sequence[str]
    free: Sequence[str]
    own: Sequence[str] = ()
    quoted: Sequence[str] = ()
    measured: Path | None = None
    settings: Sequence[str] = ()
    quick: bool = False


def problem_of(wanted: Wanted) -> Problem:
    """The problem that a command poses.

    Raises:
        InputError: nothing is free, nothing is measured, or something is wrong with either.
    """
    if not wanted.free and not wanted.own:
        raise InputError("fit", "--free", "nothing", "a key of the scene, such as --free contact.restitution")
    if wanted.quoted:
        if wanted.measured:
            raise InputError("fit", "--measured", "beside --quoted", "one of the two")
        sets = paper_data(wanted.quoted, wanted.settings)
    else:
        sets = [scene_data(scene, wanted.settings, wanted.measured) for scene in wanted.scenes]
    if not sets:
        raise InputError("fit", "", "no scene", "scenes with [[measured]] data, or --quoted")
    for name, count in Counter(data.name for data in sets).items():
        if count > 1:
            raise InputError("fit", "", f"{name} {count} times", "each data set once, scenes of different names")
    return pose(sets, wanted.free, wanted.own)


def run_fit(wanted: Wanted, runs: Path, results: Path) -> int:
    """Fits, prints and writes what is found, and lets the codes confirm it; 1 where they do not.

    Raises:
        InputError: the problem is wrong.
    """
    problem = problem_of(wanted)
    number = len(problem.free)
    with step(f"fit of {number} parameter{'s' * (number != 1)} to {len(problem.data)} data", unit="fit") as count:
        outcome = solve(problem, quick=wanted.quick, count=count)
    print(*lines(outcome), sep="\n", flush=True)
    name = f"fit-{Path((*wanted.scenes, *wanted.quoted)[0]).stem}"
    law, data = " ".join(wanted.settings), ", ".join(each.name for each in problem.sets)
    write_table(results / f"{name}.csv", Parameter, parameter_rows(law, data, outcome))
    write_table(results / f"{name}-data.csv", DatumRow, datum_rows(law, data, outcome))
    sources = wanted.scenes or [data.source for data in outcome.fit.problem.sets]
    fitted = [write_fitted(source, wanted.settings, outcome, results) for source in dict.fromkeys(sources)]
    print(*(paths.shown(results / f"{name}{end}") for end in (".csv", "-data.csv")), sep="\n")
    for path in fitted:
        print(paths.shown(path))
    return 0 if wanted.quick or not fitted else _confirm(fitted, runs)


def _confirm(fitted: Sequence[Path], runs: Path) -> int:
    """Compares fitted scenes on all engines; where no code has their law, the in-repo ones stand alone."""
    cases = [build_case(read_scene(path)) for path in fitted]
    theirs = any(inability(case, code) is None for case in cases for code in codes())
    if not theirs:
        print("no code has this law: the fitted scene rests on the in-repo engines")
    return compare_scenes([str(path) for path in fitted], (), runs, Asked(allow_missing=not theirs), unsafe=False)


def lines(outcome: Outcome) -> Iterator[str]:
    """The fit in words: parameters, data, what they say."""
    found = outcome.fit
    width = max(len(each.label) for each in found.problem.free)
    yield f"{'parameter':<{width}} {'value':>24}  " + "  ".join(f"{each:>22}" for each in RISES) + "  from"
    for index, free in enumerate(found.problem.free):
        value, error = free.value(float(found.place[index])), float(outcome.certainty.errors[index])
        profile = outcome.profiles.get(free.label)
        ends = [
            interval_in_words(free, profile.interval(rise), value, error) if profile else "" for rise in RISES.values()
        ]
        start = quantity(float(f"{free.start:.4g}"), free.unit) if free.unit else f"{free.start:.4g}"
        words = value_in_words(free, value, error)
        yield f"{free.label:<{width}} {words:>24}  " + "  ".join(f"{each:>22}" for each in ends) + f"  {start}"
    yield ""
    width = max(len(each.datum.label) for each in outcome.predictions)
    yield f"{'datum':<{width}} {'measured':>20} {'fitted':>11} {'off':>6}  {'by the others':>22} {'off':>6}"
    for each in outcome.predictions:
        yield f"{each.datum.label:<{width}} {_datum_in_words(each)}"
    yield ""
    yield from outcome.sentences()


def _datum_in_words(line: Any) -> str:
    number = line.datum.number
    if number is None:
        return f"{'':>20} {'':>11} {line.off:6.2f}"
    measured = f"{number.value:.4g} ± {number.error:.2g}"
    others = f"{line.without:.4g} ± {line.without_error:.2g}" if line.without == line.without else ""
    off = f"{line.without_off:6.2f}" if line.without_off == line.without_off else ""
    words = f"{measured:>20} {line.fitted:11.5g} {line.off:6.2f}  {others:>22} {off}"
    return words if number.fitted else f"{words.rstrip()}  (not fitted)"


def write_fitted(source: str, settings: Sequence[str], outcome: Outcome, results: Path) -> Path:
    """Writes a scene file with the fitted values in place, its comments kept; its name is ``fit-`` and the scene's."""
    import tomlkit

    path = find_scene(source)
    document: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    for setting in settings:
        lay_over(document, setting)
    for index, free in enumerate(outcome.fit.problem.free):
        if free.own in ("", path.stem) and not free.key.startswith(MEASURED):
            set_value(document, free.key, _rounded(free, outcome, index), str(path))
            value, error = free.value(float(outcome.fit.place[index])), float(outcome.certainty.errors[index])
            parent = look_up(document, free.key.rpartition(".")[0])
            if not isinstance(parent, tomlkit.items.InlineTable):  # a comment would hide the rest of its line
                look_up(document, free.key).comment(f"fitted: {value_in_words(free, value, error)}")
    for data in outcome.fit.problem.sets:
        if data.name == path.stem and data.records:
            document[MEASURED] = _entries(data, outcome, results)
    results.mkdir(parents=True, exist_ok=True)
    fitted = results / f"fit-{path.stem}.toml"
    with whole_file(fitted) as draft:
        draft.write_text(tomlkit.dumps(document), encoding="utf-8")
    return fitted


def _rounded(free: Free, outcome: Outcome, index: int) -> str | float:
    """A value with three digits more than its error asks for, with its unit."""
    value = float(f"{free.value(float(outcome.fit.place[index])):.6g}")
    return quantity(value, free.unit) if free.unit else value


def _entries(data: DataSet, outcome: Outcome, results: Path) -> Any:
    """The ``[[measured]]`` tables of a data set with fitted gains and triggers, paths as seen from ``results``."""
    import tomlkit

    found, files = tomlkit.aot(), {record.key: record.measured.file for record in data.records}
    labels = [free.label for free in outcome.fit.problem.free]
    for key, entry in data.entries.items():
        values = entry.model_dump(exclude_none=True, exclude_unset=True)
        if key in files:
            values["file"] = os.path.relpath(files[key], results)
        for end in (TRIGGER, GAIN) if key in files else ():
            label = f"{data.name}: {key}.{end}"
            if label in labels:
                index = labels.index(label)
                fitted = _rounded(outcome.fit.problem.free[index], outcome, index)
                values[end] = fitted if end == TRIGGER else _scaled(entry.gain, float(fitted), outcome, index)
        found.append(tomlkit.item({name: values[name] for name in values}))
    return found


def _scaled(gain: str | float | None, fitted: float, outcome: Outcome, index: int) -> str | float:
    """A fitted gain in the unit in which the scene gives it."""
    if not isinstance(gain, str):
        return fitted
    number, unit = gain.split(None, 1)
    return f"{float(number) * fitted / outcome.fit.problem.free[index].start:.6g} {unit}"
