"""Table of engines against features in the README of drivers: each cell is what runs, measured here."""

from contextlib import closing
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.chain.schemes import default_limit_s
from drivers.engines import engine_names, load_engine
from drivers.limits import inability
from drivers.run.build import build_of
from drivers.run.compute import Session, compute
from drivers.run.scheme import checked_trace
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

SHORT = ("chain.count=6", "chain.sensors=[]", "run.duration=20 us")
KUWABARA = ("contact.dissipation=kuwabara-kono", "contact.relaxation=2 us")
HUNT = ("contact.dissipation=hunt-crossley", "contact.slowness=0.2 s/m")
POWER = ("contact.dissipation=power", "contact.gamma=3")
DRIVEN = ("driven-steel", "run.duration=20 us")
# columns of the table: alternatives by name, of which the first one that runs counts
COLUMNS: dict[str, tuple[dict[str, tuple[str, ...]], ...]] = {
    "straight": ({"yes": ("fig4", *SHORT)},),
    "tube": ({"yes": ("fig4-tube", *SHORT)},),
    "dissipation": (
        {
            "viscoelastic": ("fig4", *SHORT, "contact.restitution=0.05"),
            "viscoelastic, restitution from 0.2137": ("fig4", *SHORT, "contact.restitution=0.2138"),
        },
        {"Kuwabara-Kono": ("fig4", *SHORT, *KUWABARA)},
        {"Hunt-Crossley": ("fig4", *SHORT, *HUNT)},
        {
            "power": ("fig4", *SHORT, *POWER, "contact.alpha=2"),
            "power with `alpha = 1`": ("fig4", *SHORT, *POWER, "contact.alpha=1"),
        },
    ),
    "drive": (
        {"force": DRIVEN},
        {"displacement": (*DRIVEN, "drive.force=", "drive.displacement=-1 um", "drive.from_wall=12")},
    ),
    "10,000 beads": ({"yes": ("fig4", "chain.count=10000", *SHORT[1:])},),
}


def runs(settings: tuple[str, ...], engine: str) -> bool:
    """True if an engine runs a case; False if it refuses the case by name."""
    case = case_of(*settings)
    if inability(case, engine):
        return False
    assert compute(case, engine).done
    return True


def serves(engine: str, folder: Path) -> bool:
    """True if one process of a code runs a deck after another."""
    case, code = case_of("fig4", *SHORT), load_engine(engine)
    deck = code.render(case)
    with closing(Session(code, build_of(code).command, folder)) as session:
        for _ in range(2):
            checked_trace(case, code, session.run(deck, default_limit_s(case)), session.case)
        return session.start_s == 0.0 and code.server.command[0] != "sh"


@pytest.mark.long
@pytest.mark.parametrize("engine", engine_names())
def test_the_readme_tells_what_each_engine_runs(engine: str, tmp_path: Path) -> None:
    need(engine)
    cells = [f"`{engine}`"]
    for asked in COLUMNS.values():
        ran = (next((name for name, settings in each.items() if runs(settings, engine)), "") for each in asked)
        cells.append("; ".join(filter(None, ran)) or "no")
    in_repository = load_engine(engine).in_repository
    cells.append("no process" if in_repository else "yes" if serves(engine, tmp_path) else "no")
    cells.append("yes" if in_repository or (paths.ROOT / f"requirements-{engine}.lock").exists() else "no")
    row, table = f"| {' | '.join(cells)} |", (paths.ROOT / "drivers" / "README.md").read_text()
    assert row in table.splitlines(), row
    assert f"| engine | {' | '.join(COLUMNS)} | one process for many decks | without root |" in table
