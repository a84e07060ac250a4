"""The plan of a study: what identifies every row it asks for, worked out once and kept until something changes."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.files import whole_file
from drivers.batch.columns import column_name, value_at
from drivers.batch.store import Row, Store
from drivers.batch.study import Study
from drivers.batch.study_cases import plan_case

PLANS = ".plans"
KEPT_PLANS = 20  # of a runs folder
SOURCES = {"drivers": "*.py", "postproc": "*.py", "validation/reference": "*.py", "templates": "*.j2"}


@dataclass(frozen=True)
class Plan:
    """All cases of a study, in order.

    Attributes:
        identities: of the rows by engine, one for each case; only engines that are installed.
        work: bodies times steps of each case.
        values: swept values by column, in SI units, one for each case.
    """

    identities: dict[str, list[str]]
    work: list[int]
    values: dict[str, list[Any]]

    def rows_of(self, store: Store, engine: str) -> list[Row | None]:
        """The rows that the store has on an engine, in the order of the cases."""
        return [store.rows.get(identity) for identity in self.identities[engine]]


def plan_part(study: Study, numbers: Sequence[int], versions: dict[str, str]) -> Plan:
    """The plan of some cases.

    Raises:
        InputError: one of them makes no scene.
    """
    identities: dict[str, list[str]] = {name: [] for name in versions}
    work = []
    columns = {column_name(name, key): key for name, key in study.columns.items()}
    values: dict[str, list[Any]] = {column: [] for column in columns}
    for number in numbers:
        planned = plan_case(study, number, versions)
        work.append(planned.work)
        for column, key in columns.items():
            values[column].append(value_at(planned.case.scene, key))
        for name in versions:
            identities[name].append(planned.identities.get(name, ""))  # none of what does not model the case
    return Plan(identities, work, values)


def joined(parts: Sequence[Plan]) -> Plan:
    """Plans of consecutive cases as one."""
    return Plan(
        {name: [each for part in parts for each in part.identities[name]] for name in parts[0].identities},
        [work for part in parts for work in part.work],
        {name: [each for part in parts for each in part.values[name]] for name in parts[0].values},
    )


def kept_plan(study: Study, versions: dict[str, str], store: Store) -> Plan | None:
    """The plan as it was worked out before, if nothing it depends on has changed since."""
    try:
        plan = Plan(**json.loads(_plan_file(study, versions, store).read_text()))
        columns: list[list[Any]] = [*plan.identities.values(), plan.work, *plan.values.values()]
        whole = set(plan.identities) == set(versions) and {len(column) for column in columns} == {study.count}
    except (OSError, ValueError, TypeError, AttributeError):
        return None
    return plan if whole else None


def keep_plan(plan: Plan, study: Study, versions: dict[str, str], store: Store) -> None:
    """Keeps a plan, and not too many old ones."""
    path = _plan_file(study, versions, store)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        draft.write_text(json.dumps(asdict(plan)))
    with suppress(OSError):  # another batch may be tidying up too
        kept = sorted(path.parent.glob("[!.]*.json"), key=lambda each: each.stat().st_mtime)
        for old in kept[:-KEPT_PLANS]:
            old.unlink(missing_ok=True)


def _plan_file(study: Study, versions: dict[str, str], store: Store) -> Path:
    """Named by all that a plan depends on: the study with its scene, the engines' versions, and the sources."""
    digest = hashlib.sha256(repr((study, sorted(versions.items()))).encode())
    for path in _sources():
        digest.update(f"{path}\0".encode())
        digest.update(path.read_bytes())
    return store.folder / PLANS / f"{study.name}-{digest.hexdigest()[:16]}.json"


def _sources() -> Iterator[Path]:
    for folder, pattern in SOURCES.items():
        yield from sorted((paths.ROOT / folder).rglob(pattern))
    yield paths.TOLERANCES
