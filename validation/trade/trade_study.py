"""``python -m validation trade``: measures, and writes tables and diagrams."""

import sys
from pathlib import Path

import pandas as pd

from drivers.base import paths
from drivers.base.files import whole_file
from validation.trade.advice import advice, orders
from validation.trade.climb import climb, write_table
from validation.trade.ladder import SCENES
from validation.trade.levers import pull_all, write_levers
from validation.trade.trade_sentences import sentences
from validation.trade.work_precision import draw_quantities, draw_scene

TABLE, LEVERS = "trade.csv", "trade-levers.csv"


def trade(budget_s: float, results: Path, scenes: tuple[str, ...] = SCENES) -> None:
    """Measures the ladder within a budget and the levers; writes tables and diagrams, says what they mean."""
    rows = climb(budget_s, scenes, lambda line: print(line, file=sys.stderr, flush=True))
    levers = pull_all()
    write_table(rows, results / TABLE)
    write_levers(levers, results / LEVERS)
    table = pd.read_csv(results / TABLE)
    for name, made in (("trade-advice.csv", advice(table)), ("trade-orders.csv", pd.DataFrame(orders(table)))):
        with whole_file(results / name) as draft:
            made.to_csv(draft, index=False)
    for scene in scenes:
        with whole_file(results / f"trade-{scene}.svg") as draft:
            draw_scene(table, scene).savefig(draft, format="svg", metadata={"Date": None})
    with whole_file(results / "trade-quantities.svg") as draft:
        draw_quantities(table, scenes[0]).savefig(draft, format="svg", metadata={"Date": None})
    for line in sentences(table, pd.read_csv(results / LEVERS)):
        print(line)
    done = int((table["status"] == "done").sum())
    print(f"{paths.shown(results / TABLE)}: {done} runs of {len(table)} within {budget_s:g} s of engine time")
