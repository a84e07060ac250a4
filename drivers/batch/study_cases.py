"""What a study asks for: its cases with their decks, and the identities by which finished rows are found."""

import ast
import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.tolerances import tolerance
from drivers.batch.study import Study
from drivers.chain.case import Case
from drivers.engines import installed, load_engine
from drivers.limits.refusal import inability, refuse
from drivers.run.run import known_version, run_identity

REFERENCE = "reference"
SMALL = 1000  # bodies
ENGINES = paths.ROOT / "drivers" / "engines"
OBSERVING = ("drivers.run.guard", "drivers.run.session", "postproc.read.observables", "postproc.read.residual")


@dataclass(frozen=True)
class Planned:
    """A case of a study.

    Attributes:
        small_decks: by engine; those of long chains are not kept, since many cases are planned at a time.
        runs: identities of the runs by engine, as run folders have them; the reference is not among them where it does
            not model what the case has.
        identities: of the rows by engine: of the run, the gauges, and what observes them.
    """

    number: int
    label: str
    case: Case
    small_decks: dict[str, Deck]
    runs: dict[str, str]
    identities: dict[str, str]

    def deck(self, engine: str) -> Deck:
        """The deck of an engine."""
        return self.small_decks.get(engine) or load_engine(engine).render(self.case)

    def wanted(self, identities: set[str]) -> list[str]:
        """The engines of which the row is among these."""
        return [name for name, identity in self.identities.items() if identity in identities]

    @property
    def exact(self) -> bool:
        """Whether there are exact forces to count errors by."""
        return REFERENCE in self.runs

    @property
    def work(self) -> int:
        """Bodies times steps: what a run's cost goes with."""
        return self.case.chain.bodies * self.case.scene.steps


def versions_of(engines: tuple[str, ...], runs: Path) -> dict[str, str]:
    """Versions of installed engines, and of the reference, by which errors are counted."""
    versions = {}
    for name in dict.fromkeys((*installed(engines), REFERENCE)):
        engine = load_engine(name)
        executable = engine.find()
        assert executable is not None
        versions[name] = known_version(engine, executable, runs / name)
    return versions


def plan_case(study: Study, number: int, versions: dict[str, str]) -> Planned:
    """A case of the study with what identifies it on each engine.

    Raises:
        InputError: the case makes no scene, or none that can end well on an engine (``drivers.limits.refusal``).
    """
    from validation.accuracy import plan  # until it is handed in

    case = plan.plan_case(study.case(number))
    # exact forces, by which errors are counted, are known of straight chains only
    names = [name for name in versions if name in study.engines or inability(case, name) is None]
    if not study.unsafe:
        for name in names:
            refuse(case, name, override="unsafe = true in the study")
    gauges = f"{case.layout}\0{versions[REFERENCE]}\0{_digest_of(sources_of(OBSERVING))}\0{_guards()}"
    decks = {name: load_engine(name).render(case) for name in names}
    runs = {name: run_identity(name, versions[name], deck) for name, deck in decks.items()}
    identities = {
        name: hashlib.sha256(f"{run}\0{gauges}\0{_served(name)}".encode()).hexdigest()[:20]
        for name, run in runs.items()
    }
    small = case.chain.bodies < SMALL
    return Planned(number, study.label(number), case, decks if small else {}, runs, identities)


def _guards() -> str:
    return " ".join(
        str(tolerance("guard", each).limit) for each in ("energy", "impacts", "rounding", "friction", "least")
    )


@cache
def sources_of(modules: tuple[str, ...]) -> tuple[str, ...]:
    """Source files of modules of this project, and of all that they import, wherever in the file."""
    found: set[str] = set()
    waiting = [*modules]
    while waiting:
        path = paths.ROOT / waiting.pop().replace(".", "/")
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        name = str(file.relative_to(paths.ROOT))
        if name in found or not file.is_file():
            continue
        found.add(name)
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
    return tuple(sorted(found))


@cache
def _served(engine: str) -> str:
    """Digest of what asks an engine and reads what it says."""
    modules = [path.name for path in ENGINES.glob("_*.py")]
    return _digest_of(tuple(f"drivers/engines/{name}" for name in (*sorted(modules), f"{engine}.py"))) + str(
        load_engine(engine).server.sha256
    )


@cache
def _digest_of(files: tuple[str, ...]) -> str:
    digest = hashlib.sha256()
    for name in files:
        digest.update((paths.ROOT / name).read_bytes())
    return digest.hexdigest()
