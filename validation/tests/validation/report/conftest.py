"""A page with hostile texts, for the tests of its bytes and for those in a browser."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from drivers.chain.trace import until
from postproc.figures.table1 import EXACT_LONGER, SPREAD
from postproc.paper import quoted
from postproc.paper.strikes import COLUMNS
from validation.chapters import shown_of
from validation.checks import FAIL, NOT_RUN, REPRODUCED, without_run
from validation.compare.comparison import ComparedScene
from validation.report.parts import Chapter, store_part
from validation.report.write_report import write_report
from validation.tests.helpers.runs import blown_up, checks_of
from validation.tests.validation.claims.published import published_checks

TITLE = """</script><img src=x onerror="throw 1"><script>throw 2</script><b>&'"{{ 7 * 7 }}]]>"""
HOSTILE = f"{TITLE}\x1b[31m\x00"
FIGURE = '<svg xmlns="http://www.w3.org/2000/svg" width="9pt" onload="throw 3"><script>throw 3</script></svg>'


def write_table_1(results: Path) -> int:
    """Table 1 as if the exact motion were the paper's, and its number of rows."""
    table = pd.DataFrame(quoted().table1)
    exact = {f"reference_{name}": table[f"computed_{name}"] * (1 + 1e-3) for name in COLUMNS}
    longer = {f"{EXACT_LONGER}_{name}": table[f"computed_{name}"] for name in COLUMNS}
    table = table.assign(**exact, **longer, **{SPREAD: 4.2e-6})
    store_part("table1", Chapter({}, shown=shown_of("table1", table)), {}, results)
    return len(table)


@pytest.fixture(scope="session")
def hostile(tmp_path_factory: pytest.TempPathFactory, compared: ComparedScene) -> Path:
    """Folder of a page: a hostile title, figure and failed run, Table 1, and a number that is missed."""
    folder = tmp_path_factory.mktemp("hostile")
    store_part("fig4", Chapter({}), {"fig4": (TITLE, FIGURE)}, folder)
    write_table_1(folder)
    *published, second, last = published_checks(("yade", "reference"))
    failed = replace(second, verdict=FAIL, value=2 * second.limit, where=f"found 2, expected 1: {TITLE}")
    not_run = without_run(last.scene, last.engine, "not installed", NOT_RUN)
    cases = [check for check in (*published, failed, not_run) if check.verdict != REPRODUCED]
    claims = Chapter({}, [TITLE, TITLE], checks=cases)
    store_part("claims", claims, {}, folder)
    case = replace(compared.case, scene=compared.case.scene.model_copy(update={"title": TITLE}))
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    half = until(blown_up(compared.runs["verlet"].trace, 200), 290)
    checks, diagnoses = checks_of(case, compared.runs, absent), {"yade": f"matches {HOSTILE}"}
    scene = ComparedScene(case, compared.runs, absent, checks, diagnoses, {"yade": half})
    write_report([scene], folder / "report.html", "make it again", Path("my runs"))
    return folder
