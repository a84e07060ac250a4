"""``python -m validation elements``: switches elements, checks the rule, and writes tables and figures."""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.files import whole_file
from drivers.engines import installed_codes, missing_codes
from postproc.draw.product import Product, write_product
from postproc.paper.quoted import quoted
from validation.elements import between, oscilloscope
from validation.elements import rule_checks as rule
from validation.elements import switch_effects as measure
from validation.elements.element_figures import draw_effects, draw_oscilloscope
from validation.elements.elements_sentences import TABLES, effects_of, missed, quoted_of, read_tables, sentences
from validation.elements.switches import pairs_of, read_elements

REPEATS = 3  # runs from which a cost is the least
CHEAPEST = "liggghts"  # for what needs many seeds


def elements(results: Path, runs: Path, *, quick: bool = False) -> int:
    """Runs everything; the exit code is 1 where the rule does not hold.

    ``quick`` takes few seeds, and only the first scene where all are switched.

    Raises:
        RunError: no code is installed, or a run failed.
    """
    codes = installed_codes()
    if not codes:
        raise RunError(f"no code is installed that beads move sideways in: {', '.join(missing_codes())}")
    asked = read_elements()
    seeds = asked.quick_seeds if quick else asked.seeds
    if quick:
        asked = asked.model_copy(update={"scene": asked.scene[:1]})
    code = CHEAPEST if CHEAPEST in codes else codes[0]
    tables: dict[str, Sequence[Any]] = {
        "effects": measure.measure(pairs_of(asked, seeds), codes, 1 if quick else REPEATS, runs, _say),
        "nothing": rule.nothing_changes(asked.scene, codes, runs),
        "accuracies": rule.accuracies_kept(asked.scene[0].name, codes, runs),
        "between": between.compare_codes(asked.scene, seeds, codes, runs, _say),
    }
    shown = oscilloscope.watch(asked.scene, seeds, code, runs, _say)
    varied = oscilloscope.vary(asked.scene[:2], seeds, code, runs, _say)
    tables["steps"] = [line for each in shown for line in _lines(each.scene, each.step, "", each)]
    tables["ranges"] = [line for name, value, each in varied for line in _lines(each.scene, name, f"{value:g}", each)]
    write_tables(tables, results)
    read = read_tables(results)
    write_product(Product(draw_effects(read["effects"]), read["effects"]), "elements", results)
    told = quoted()
    for subject in asked.scene:
        own = [each for each in shown if each.scene == subject.name]
        numbers = read["steps"][read["steps"]["scene"] == subject.name]
        product = Product(draw_oscilloscope(own, quoted_of(told, subject.name)), numbers)
        write_product(product, f"oscilloscope-{subject.name}", results)
    for line in (*effects_of(read["effects"]), *sentences(read)):
        print(line)
    print(f"{paths.shown(results / TABLES['effects'])}: {len(asked.element)} elements on {len(asked.scene)} scenes")
    complaints = missed(read)
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


def write_tables(tables: dict[str, Sequence[Any]], results: Path) -> None:
    """Writes each table whole."""
    results.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        with whole_file(results / TABLES[name]) as draft:
            pd.DataFrame([row if isinstance(row, dict) else asdict(row) for row in rows]).to_csv(draft, index=False)


def _lines(scene: str, step: str, value: str, shown: oscilloscope.Shown) -> list[dict[str, Any]]:
    return [
        {
            "scene": scene,
            "step": step,
            "value": value,
            "observable": name,
            "mean": float(values.mean()),
            "spread": float(values.std(ddof=1)) if len(values) > 1 else float("nan"),
            "seeds": len(values),
        }
        for name, values in shown.values.items()
    ]


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
