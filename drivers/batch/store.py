"""Store of the rows of all studies of a runs folder: the SQLite database ``runs/batch.sqlite``.

Table ``rows`` has one row for each case and engine, table ``claims`` the rows on which processes work now. Processes of
one machine share the database. On a network file system, where locks cannot be trusted, each process writes a database
of its own beside it; all are read, and the next batch merges those of ended processes. Each row holds a digest of
itself, so a row that is read is as it was written, or is reported and does not count.
"""

import errno
import json
import os
import platform
import re
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, fields
from functools import cache
from itertools import count, product, starmap
from math import nan
from pathlib import Path
from typing import Any
from urllib.parse import quote

import psutil

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import sha256_in
from drivers.base.processes import workplace

NAME = "batch.sqlite"
SCHEMA_VERSION = 1
OF_PROCESS = re.compile(r"batch-(.+)-([0-9]+)\.sqlite")  # machine and number of the process
ANEW = "move it away to begin anew"
BUSY_LIMIT_S = 60.0  # longest wait for the transaction of another process
PAGE_BYTES = 16_384  # a row has about 2 kB
NETWORK = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "lustre", "gpfs", "beegfs", "ceph", "afs", "glusterfs", "fuse.sshfs")
CLOCK_S = 10.0  # by which the start of a process may seem to move when the clock is set
CLAIM_S = 600.0  # a claim of another machine counts for this time
ABANDONED_S = 86400.0  # a database of another machine without a change for this time is merged and removed

_stores = count()

Key = tuple[str, str]  # digest of a case, engine


@dataclass(frozen=True)
class StudyRow:
    """Row of the table: one case on one engine, with the columns of the database.

    Attributes:
        case_sha256: digest of the case, as the study describes it.
        engine: name of the engine.
        program: digest of build, sources, templates and tolerances; a row with another one is stale.
        study, label: study and case for which the row was made.
        build: identity of the build (``Build.identity``).
        ended: time of the end, in seconds of Unix time.
        status: ``done``, ``failed``, ``timeout`` or ``refused``.
        reason: reason of a failure.
        identity: digest of deck, gauges and program; rows of the same identity have equal numbers.
        observables: numbers by name, as JSON with null for NaN.
        trace_sha256: digest of forces and energies.
        force_error_share: largest error of the force divided by the largest change of force; None for the reference.
        bodies_times_steps: size of the case.
        start_s, engine_s, loop_s, workflow_s, reference_s: cost in s by activity.
    """

    case_sha256: str
    engine: str
    program: str
    study: str
    label: str
    build: str
    ended: float
    status: str
    reason: str = ""
    identity: str = ""
    observables: str = "{}"
    trace_sha256: str = ""
    force_error_share: float | None = None
    bodies_times_steps: int | None = None
    start_s: float | None = None
    engine_s: float | None = None
    loop_s: float | None = None
    workflow_s: float | None = None
    reference_s: float | None = None

    @property
    def done(self) -> bool:
        """True if the run succeeded."""
        return self.status == "done"

    @property
    def values(self) -> dict[str, float]:
        """Observables by name; NaN, which JSON lacks, where the run does not show one."""
        return {name: nan if value is None else value for name, value in json.loads(self.observables).items()}


NAMES = [field.name for field in fields(StudyRow)]
COLUMNS = ", ".join(NAMES)
SCHEMA = f"""
CREATE TABLE rows ({COLUMNS}, sha256, PRIMARY KEY (case_sha256, engine));
CREATE INDEX by_identity ON rows (identity);
CREATE TABLE claims (case_sha256, engine, owner, since, PRIMARY KEY (case_sha256, engine));
"""
ROWS = f"SELECT {COLUMNS}, sha256 FROM rows"
OF_CASES = "JOIN json_each(?) ON case_sha256 = value"
# a row done stays instead of a later failure of its program, and a newer row instead of one that is merged
PUT = f"""
INSERT OR REPLACE INTO rows SELECT {", ".join(f":{name}" for name in NAMES)}, :sha256 WHERE NOT EXISTS (
    SELECT * FROM rows WHERE case_sha256 = :case_sha256 AND engine = :engine
    AND iif(program = :program, status = 'done' AND :status <> 'done', :merged AND ended > :ended)
)
"""


class Store(AbstractContextManager["Store"]):
    """Rows of a runs folder. The context closes its databases.

    Attributes:
        runs: the runs folder.
        common: database that the processes of this machine share.
        own: database that this process writes: the common one, or on a network file system one of its own.
        owner: name under which it claims rows: machine, process, and number of the store.
        damaged: damaged rows that were read: digest of the case, engine, and the digest that is not that of the row.
    """

    def __init__(self, runs: Path) -> None:
        self.runs = runs
        self.common = runs / NAME
        self.own = self.common if is_shared(runs) else runs / f"batch-{platform.node()}-{os.getpid()}.sqlite"
        self.damaged: set[tuple[str, str, str]] = set()
        start_s = psutil.Process().create_time()
        self.owner = f"{platform.node()} {os.getpid()} {start_s} {next(_stores)}"  # threads of Dask share a process
        self._connections: dict[Path, sqlite3.Connection] = {}

    def __exit__(self, *_: object) -> None:
        """Close the databases; if this store has written, release its claims and those of dead processes."""
        if self.own in self._connections and self._connections[self.own].total_changes:
            self.release()
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()

    @property
    def files(self) -> list[Path]:
        """Databases of the runs folder."""
        names = os.listdir(self.runs) if self.runs.exists() else ()  # noqa: PTH208, for each row: ten times as fast
        return [self.runs / name for name in names if name == NAME or OF_PROCESS.fullmatch(name)]

    def rows(self, cases: Sequence[str], programs: Mapping[str, str]) -> dict[Key, StudyRow]:
        """Rows of cases by case and engine.

        Of several databases a row of the program of its engine counts rather than others, then a row done, then the
        newest one.
        """
        return _by_key(self._rows(OF_CASES, json.dumps(cases)), programs)

    def states(self, cases: Sequence[str], programs: Mapping[str, str]) -> dict[Key, StudyRow]:
        """Rows as in ``rows`` with program, end and status alone, and not verified; a tenth of the time."""
        ended = "ifnull(CAST(ended AS REAL), 0)"  # a number also in an altered row
        query = f"SELECT case_sha256, engine, program, '', '', '', {ended}, status FROM rows {OF_CASES}"
        return _by_key(starmap(StudyRow, self._found(query, json.dumps(cases))), programs)

    def equal(self, identity: str) -> StudyRow | None:
        """Row done of the same numbers, of any case."""
        return next(self._rows("WHERE identity = ? AND status = 'done'", identity), None)

    def newest(self, engine: str, count: int) -> list[StudyRow]:
        """Newest rows of an engine."""
        found = self._rows("WHERE engine = ? ORDER BY ended DESC LIMIT ?", engine, count)
        return sorted(found, key=lambda row: -row.ended)[:count]

    def written(self, study: str, ends: dict[Path, int]) -> int:
        """Number of rows of a study that were written after the ends of the databases, which move on."""
        count = 0
        for file in self.files:
            query = "SELECT coalesce(sum(study = ?), 0), max(rowid) FROM rows WHERE rowid > ?"
            ((fresh, end),) = self._found(query, study, ends.get(file, 0), files=[file])
            count, ends[file] = count + fresh, end or ends.get(file, 0)
        return count

    def claimed(self) -> set[Key]:
        """Cases and engines on which other live processes work."""
        claims, is_other = self._found("SELECT case_sha256, engine, owner, since FROM claims"), cache(self._is_other)
        return {(case, engine) for case, engine, owner, since in claims if is_other(owner, since)}

    def claim(self, cases: Sequence[str], engines: Iterable[str]) -> None:
        """Claim cases on engines, except those on which other live processes work."""
        with self._writing(self.own) as connection:
            free, now = {*product(cases, engines)} - self.claimed(), time.time()
            claims = [(case, engine, self.owner, now) for case, engine in free]
            connection.executemany("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", claims)

    def release(self) -> None:
        """Release the claims of this store and of dead processes."""
        with self._writing(self.own) as connection:
            owners = connection.execute("SELECT owner, max(since) FROM claims GROUP BY owner").fetchall()
            released = [(owner,) for owner, since in owners if not self._is_other(owner, since)]
            connection.executemany("DELETE FROM claims WHERE owner = ?", released)

    def finish(self, row: StudyRow) -> None:
        """Store a row; a failure does not replace a row done by the same program.

        Raises:
            OSError: the disk is full, or the runs folder cannot be written to.
        """
        with self._writing(self.own) as connection:
            _put(connection, row, merged=False)

    def note_study(self, path: Path) -> None:
        """Note the path of a study of which rows will be run."""
        with self._writing(self.own) as connection:
            connection.execute("CREATE TABLE IF NOT EXISTS studies (name PRIMARY KEY, path)")
            connection.execute("INSERT OR REPLACE INTO studies VALUES (?, ?)", (path.stem, str(path.resolve())))

    def path_of(self, study: str | Path) -> str | Path:
        """Path of a noted study by its name, unless there is another study of that name."""
        if Path(study).is_file() or (paths.STUDIES / f"{study}.toml").is_file():
            return study
        table = "SELECT 1 FROM sqlite_master WHERE name = 'studies'"
        noted = [file for file in self.files if [*self._found(table, files=[file])]]
        paths_noted = self._found("SELECT path FROM studies WHERE name = ?", str(study), files=noted) if noted else ()
        return next((path for (path,) in paths_noted), study)

    def remove_damaged(self) -> None:
        """Remove the damaged rows that were read."""
        for file in self.files:
            with self._writing(file) as connection:
                query = "DELETE FROM rows WHERE case_sha256 IS ? AND engine IS ? AND sha256 IS ?"
                connection.executemany(query, self.damaged)
        self.damaged.clear()

    def merge(self) -> None:
        """Copy the rows of the databases of ended processes into the common one, and remove these databases."""
        for file in self.files:
            writer = OF_PROCESS.fullmatch(file.name)
            if writer is None or file == self.own:
                continue
            changed = time.time() - file.stat().st_mtime < ABANDONED_S
            in_use = psutil.pid_exists(int(writer[2])) if writer[1] == platform.node() else changed
            if not in_use:
                with self._writing(self.common) as connection:
                    for row in self._rows("", files=[file]):
                        _put(connection, row, merged=True)
                self._connections.pop(file).close()
                file.unlink()

    def _is_other(self, owner: str, since: float) -> bool:
        """True if the owner of a claim is another that is alive, as far as this machine can tell."""
        machine, process, start, _ = owner.rsplit(" ", 3)
        if machine != platform.node():
            return time.time() - since < CLAIM_S
        with suppress(psutil.Error):
            apart_s = psutil.Process(int(process)).create_time() - float(start)
            return owner != self.owner and abs(apart_s) < CLOCK_S
        return False

    def _connection(self, file: Path) -> sqlite3.Connection:
        """Connection to a database, which is made if there is none.

        Raises:
            InputError: the database is of another version.
        """
        if file in self._connections:
            return self._connections[file]
        if not file.exists():
            _make(file)
        writable = os.access(file.parent, os.W_OK) and os.access(file, os.W_OK)
        mode = "" if writable else "?mode=ro" if file.with_name(f"{file.name}-wal").exists() else "?immutable=1"
        uri = f"file://{quote(os.fsencode(file.absolute()))}{mode}"
        connection = sqlite3.connect(uri, BUSY_LIMIT_S, isolation_level=None, check_same_thread=False, uri=True)
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        connection.execute("PRAGMA synchronous = NORMAL")  # commits outlive the process, not a power cut
        if version != SCHEMA_VERSION:
            found = f"rows of version {version} of the store"
            raise InputError(paths.shown(file), "", found, f"version {SCHEMA_VERSION}; {ANEW}")
        return self._connections.setdefault(file, connection)

    @contextmanager
    def _writing(self, file: Path) -> Iterator[sqlite3.Connection]:
        """Transaction that no other process' transaction interrupts, undone after an error."""
        with _named(file), self._connection(file) as connection:
            connection.execute("BEGIN IMMEDIATE")
            yield connection

    def _found(self, query: str, *values: Any, files: Iterable[Path] = ()) -> Iterator[Any]:
        """Results of a query of some or all databases."""
        for file in files or self.files:
            with _named(file):
                found = self._connection(file).execute(query, values).fetchall()
            yield from found

    def _rows(self, query: str, *values: Any, files: Iterable[Path] = ()) -> Iterator[StudyRow]:
        """Rows of a query of some or all databases, without damaged ones."""
        for *columns, sha256 in self._found(f"{ROWS} {query}", *values, files=files):
            row = StudyRow(*columns)
            if _digest_of(row) == sha256:
                yield row
            else:
                self.damaged.add((row.case_sha256, row.engine, sha256))


def _by_key(rows: Iterable[StudyRow], programs: Mapping[str, str]) -> dict[Key, StudyRow]:
    """Of rows of the same case and engine the one that counts."""

    def rank(row: StudyRow) -> tuple[bool, bool, float]:
        return row.program == programs.get(row.engine), row.done, row.ended

    return {(row.case_sha256, row.engine): row for row in sorted(rows, key=rank)}


def _put(connection: sqlite3.Connection, row: StudyRow, *, merged: bool) -> None:
    """Insert a row unless a row stays that is there."""
    connection.execute(PUT, {**vars(row), "sha256": _digest_of(row), "merged": merged})


def _digest_of(row: StudyRow) -> str:
    return sha256_in(repr((*vars(row).values(),)))


@cache
def is_shared(runs: Path) -> bool:
    """True unless the runs folder is on a network file system, where locks cannot be trusted."""
    place = runs.resolve()
    mounted = [part for part in psutil.disk_partitions(all=True) if place.is_relative_to(part.mountpoint)]
    innermost = max(reversed(mounted), key=lambda part: len(part.mountpoint), default=None)
    return innermost is None or innermost.fstype not in NETWORK


@contextmanager
def _named(file: Path) -> Iterator[None]:
    """Raise errors of a database with its name.

    Raises:
        InputError: the database is damaged, or no database.
        OSError: any other error, such as of a full disk.
    """
    try:
        yield
    except sqlite3.DatabaseError as error:
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB")):
            found = f"a damaged file ({error})"
            raise InputError(paths.shown(file), "", found, f"the rows of batches; {ANEW}") from error
        reason = os.strerror(errno.ENOSPC) if name == "SQLITE_FULL" else str(error)
        raise OSError(errno.EIO, reason, str(file)) from error


def _make(file: Path) -> None:
    """Make an empty database, which appears when it is complete, since others may make it at the same time."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with workplace(file.parent) as folder:
        draft = folder / NAME
        with closing(sqlite3.connect(draft, isolation_level=None)) as connection:
            connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            connection.execute(f"PRAGMA journal_mode = {'WAL' if is_shared(file.parent) else 'DELETE'}")
            connection.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT")
        try:
            os.link(draft, file)
        except FileExistsError:  # another process was faster
            pass
        except OSError:  # there are no hard links, as on some network file systems
            draft.rename(file)
