"""Store of the rows of all studies of a runs folder: the SQLite database ``runs/batch.sqlite``.

Table ``rows`` has one row for each case and engine, table ``claims`` the rows on which processes work now. Processes of
one machine share the database. On a network file system, where locks cannot be trusted, each process writes a database
of its own beside it; all are read, and the next batch merges those of ended processes. Each row holds a digest of
itself, so a row that is read is as it was written, or is reported and does not count.
"""

import errno
import hashlib
import json
import os
import platform
import re
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple, dataclass, fields
from functools import cache, cached_property
from itertools import count
from math import nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import psutil

from drivers.base import paths
from drivers.base.errors import InputError

NAME = "batch.sqlite"
SCHEMA_VERSION = 1
OF_PROCESS = re.compile(r"batch-(.+)-([0-9]+)\.sqlite")  # machine and number of the process
ALLOWED = "the rows of batches; move the file away to begin anew"
BUSY_LIMIT_S = 60.0  # longest wait for the transaction of another process
KEYS = 10_000  # of one query
PAGE_BYTES = 16_384  # a row has about 2 kB
NETWORK = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "lustre", "gpfs", "beegfs", "ceph", "afs", "glusterfs", "fuse.sshfs")
CLOCK_S = 10.0  # by which the start of a process may seem to move when the clock is set
CLAIM_S = 600.0  # a claim of another machine counts for this time
ABANDONED_S = 86400.0  # a database of another machine without a change for this time is merged and removed

_stores = count()


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

    @cached_property
    def values(self) -> dict[str, float]:
        """Observables by name; NaN, which JSON lacks, where the run does not show one."""
        return {name: nan if value is None else value for name, value in json.loads(self.observables).items()}


COLUMNS = ", ".join(field.name for field in fields(StudyRow))
MARKS = ", ".join("?" * (len(fields(StudyRow)) + 1))
SCHEMA = f"""
CREATE TABLE rows ({COLUMNS}, sha256, PRIMARY KEY (case_sha256, engine));
CREATE INDEX by_identity ON rows (identity);
CREATE TABLE claims (case_sha256, engine, owner, since, PRIMARY KEY (case_sha256, engine));
"""
KEY = "case_sha256 = ? AND engine = ?"
OF_CASES = "FROM rows JOIN json_each(?) ON case_sha256 = value WHERE engine = ?"


class Store:
    """Rows of a runs folder.

    Attributes:
        runs: the runs folder.
        common: database that the processes of this machine share.
        own: database that this process writes: the common one, or on a network file system one of its own.
        former: folder with the rows of versions before the database.
        owner: name under which it claims rows: machine, process, and number of the store.
        damaged: damaged rows that were read: digest of the case, engine, and the digest that is not that of the row.
    """

    def __init__(self, runs: Path) -> None:
        self.runs = runs
        self.common = runs / NAME
        self.own = self.common if is_shared(runs) else runs / f"batch-{platform.node()}-{os.getpid()}.sqlite"
        self.former = runs / "batch"  # rows of versions before the database
        self.damaged: set[tuple[str, str, str]] = set()
        self.owner = f"{_process()} {next(_stores)}"  # threads of Dask share a process
        self._open: sqlite3.Connection | None = None

    def __enter__(self) -> "Store":
        """Return the store itself, which is opened when it is used."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the claims of this store and of dead processes, and close the database if it has been written."""
        if self._open:
            self.release()
            self._open.close()
            self._open = None

    def release(self) -> None:
        """Release the claims of this store and of dead processes."""
        with _transaction(self._connection, self.own) as connection:
            owners = connection.execute("SELECT owner, max(since) FROM claims GROUP BY owner").fetchall()
            released = [(owner,) for owner, since in owners if not self._is_other(owner, since)]
            connection.executemany("DELETE FROM claims WHERE owner = ?", released)

    @property
    def files(self) -> list[Path]:
        """Databases of the runs folder, the common one first."""
        others = (file for file in self.runs.glob("batch-*.sqlite") if OF_PROCESS.fullmatch(file.name))
        return [*filter(Path.exists, [self.common]), *sorted(others)]

    def rows(self, engine: str, cases: Sequence[str]) -> dict[str, StudyRow]:
        """Rows of cases on an engine, by the digest of the case."""
        rows: dict[str, StudyRow] = {}
        for row in self._verified(f"SELECT {COLUMNS}, sha256 {OF_CASES}", cases, engine):
            known = rows.setdefault(row.case_sha256, row)
            if _outranks((row.status, row.program, row.ended), (known.status, known.program, known.ended)):
                rows[row.case_sha256] = row
        return rows

    def states(self, engine: str, cases: Sequence[str]) -> dict[str, tuple[str, str]]:
        """Status and program of the rows of cases on an engine, not verified, by the digest of the case."""
        states: dict[str, tuple[str, str, float]] = {}
        for case, *state in self._read(f"SELECT case_sha256, status, program, ended {OF_CASES}", cases, engine):
            if case not in states or _outranks((*state,), states[case]):
                states[case] = (*state,)
        return {case: state[:2] for case, state in states.items()}

    def equal(self, identity: str) -> StudyRow | None:
        """Row done of the same numbers, of any case."""
        query = f"SELECT {COLUMNS}, sha256 FROM rows JOIN json_each(?) ON identity = value WHERE status = ?"
        return next(self._verified(query, [identity], "done"), None)

    def newest(self, engine: str, count: int) -> list[StudyRow]:
        """Newest rows of an engine."""
        query = f"SELECT {COLUMNS}, sha256 FROM rows, json_each(?) WHERE engine = ? ORDER BY ended DESC LIMIT {count}"
        return sorted(self._verified(query, [""], engine), key=lambda row: -row.ended)[:count]

    def after(self, position: dict[Path, int]) -> list[StudyRow]:
        """Rows written after a position, which moves on; an empty one is set to the present end, without rows."""
        fresh: list[StudyRow] = []
        begun = bool(position)
        for file in self.files:
            last = position.setdefault(file, 0 if begun else -1)
            query = f"SELECT {COLUMNS}, sha256, rowid FROM rows WHERE rowid > ?"
            if last < 0:
                query, last = "SELECT max(rowid) FROM rows WHERE rowid > ?", 0
            with self._reading(file) as connection:
                found = connection.execute(query, [last]).fetchall()
            position[file] = max([last, *(values[-1] or 0 for values in found)])
            fresh += filter(None, (self._checked(values[:-1]) for values in found if len(values) > 1))
        return fresh

    def claimed(self, engine: str, cases: Sequence[str]) -> set[str]:
        """Cases of an engine on which other live processes work."""
        query = f"SELECT case_sha256, owner, since {OF_CASES.replace('rows', 'claims')}"
        return {case for case, owner, since in self._read(query, cases, engine) if self._is_other(owner, since)}

    def claim(self, engine: str, cases: Sequence[str]) -> set[str]:
        """Claim cases of an engine on which no other live process works; returns them."""
        with _transaction(self._connection, self.own) as connection:
            free = set(cases) - self.claimed(engine, cases)
            claims = [(case, engine, self.owner, time.time()) for case in free]
            connection.executemany("INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?)", claims)
        return free

    def finish(self, row: StudyRow) -> None:
        """Store a row and release its claim; a failure does not replace a row done by the same program.

        Raises:
            OSError: the disk is full, or the runs folder cannot be written to.
        """
        with _transaction(self._connection, self.own) as connection:
            _put(connection, row)
            connection.execute(f"DELETE FROM claims WHERE {KEY}", [row.case_sha256, row.engine])

    def remove_damaged(self) -> None:
        """Remove the damaged rows that were read."""
        for file in self.files if self.damaged else ():
            with closing(_opened(file)) as connection, _transaction(connection, file):
                connection.executemany(f"DELETE FROM rows WHERE {KEY} AND sha256 = ?", self.damaged)

    def merge(self) -> None:
        """Copy the rows of the databases of ended processes into the common one, and remove these databases."""
        for file in self.files:
            writer = OF_PROCESS.fullmatch(file.name)
            if writer is None or file == self.own:
                continue
            if writer[1] == platform.node():
                in_use = psutil.pid_exists(int(writer[2]))
            else:
                in_use = time.time() - file.stat().st_mtime < ABANDONED_S
            if not in_use:
                with self._reading(file) as connection:
                    found = connection.execute(f"SELECT {COLUMNS}, sha256 FROM rows").fetchall()
                with closing(_opened(self.common)) as common, _transaction(common, self.common):
                    for row in filter(None, map(self._checked, found)):
                        _put(common, row, merged=True)
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

    @property
    def _connection(self) -> sqlite3.Connection:
        """Connection to the own database, which is made if there is none."""
        if self._open is None:
            self.runs.mkdir(parents=True, exist_ok=True)
            self._open = _opened(self.own)
        return self._open

    @contextmanager
    def _reading(self, file: Path) -> Iterator[sqlite3.Connection]:
        """Connection to a database of the folder."""
        if file == self.own and self._open:
            with _named(file):
                yield self._open
        else:
            with closing(_opened(file)) as connection, _named(file):
                yield connection

    def _read(self, query: str, keys: Sequence[str], value: str) -> Iterator[tuple[Any, ...]]:
        """Results of a query of all databases for some keys and a further value."""
        for file in self.files:
            with self._reading(file) as connection:
                for start in range(0, len(keys), KEYS):
                    yield from connection.execute(query, [json.dumps(keys[start : start + KEYS]), value])

    def _verified(self, query: str, keys: Sequence[str], value: str) -> Iterator[StudyRow]:
        """Rows of a query, without damaged ones."""
        return filter(None, map(self._checked, self._read(query, keys, value)))

    def _checked(self, values: tuple[Any, ...]) -> StudyRow | None:
        """Row of its values and their digest; None if it is damaged."""
        if _digest_of(values[:-1]) == values[-1]:
            return StudyRow(*values[:-1])
        self.damaged.add((values[0], values[1], values[-1]))
        return None


def _put(connection: sqlite3.Connection, row: StudyRow, *, merged: bool = False) -> None:
    """Insert a row, unless its program has done it before; a merged one also unless there is a newer one."""
    key = [row.case_sha256, row.engine]
    for known in connection.execute(f"SELECT status, program, ended FROM rows WHERE {KEY}", key):
        if (merged or known[1] == row.program) and not _outranks((row.status, row.program, row.ended), known):
            return
    values = astuple(row)
    connection.execute(f"INSERT OR REPLACE INTO rows VALUES ({MARKS})", [*values, _digest_of(values)])


def _outranks(one: tuple[str, str, float], other: tuple[str, str, float]) -> bool:
    """True if a row counts rather than another: status, program and end; of one program a row done, else the newer."""
    if one[1] == other[1]:
        return one[0] == "done" or other[0] != "done"
    return one[2] >= other[2]


def is_shared(runs: Path) -> bool:
    """True unless the runs folder is on a network file system, where locks cannot be trusted."""
    place, best = runs.resolve(), 0
    kind = ""
    for partition in psutil.disk_partitions(all=True):
        if place.is_relative_to(partition.mountpoint) and len(partition.mountpoint) >= best:
            best, kind = len(partition.mountpoint), partition.fstype
    return kind not in NETWORK


def _digest_of(values: tuple[Any, ...]) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()


@cache
def _process() -> str:
    """Machine, number and start of this process."""
    return f"{platform.node()} {os.getpid()} {psutil.Process().create_time()}"


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
            raise InputError(paths.shown(file), "", f"a damaged file ({error})", ALLOWED) from error
        code = errno.ENOSPC if name == "SQLITE_FULL" else errno.EIO
        raise OSError(code, os.strerror(code) if name == "SQLITE_FULL" else str(error), str(file)) from error


def _opened(file: Path) -> sqlite3.Connection:
    """Connection to a database, which is made if there is none.

    Raises:
        InputError: the database is damaged or of another version.
    """
    writable = os.access(file.parent, os.W_OK) and (not file.exists() or os.access(file, os.W_OK))
    mode = "" if writable else "?mode=ro" if file.with_name(f"{file.name}-wal").exists() else "?immutable=1"
    uri = f"file://{quote(os.fsencode(file.absolute()))}{mode}"
    if not file.exists():
        _make(file)
    with _named(file):
        connection = sqlite3.connect(uri, BUSY_LIMIT_S, isolation_level=None, check_same_thread=False, uri=True)
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version != SCHEMA_VERSION:
            found = f"rows of version {version} of the store"
            raise InputError(
                paths.shown(file), "", found, f"version {SCHEMA_VERSION}; move the file away to begin anew"
            )
        connection.execute("PRAGMA synchronous = NORMAL")  # commits outlive the process, not a power cut
    return connection


def _make(file: Path) -> None:
    """Make an empty database, which appears when it is complete, since others may make it at the same time."""
    with TemporaryDirectory(prefix=".", dir=file.parent) as folder, _named(file):
        draft = Path(folder, NAME)
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


@contextmanager
def _transaction(connection: sqlite3.Connection, file: Path) -> Iterator[sqlite3.Connection]:
    """Transaction that no other process' transaction interrupts, undone after an error."""
    with _named(file):
        connection.execute("BEGIN IMMEDIATE")
        with connection:
            yield connection
