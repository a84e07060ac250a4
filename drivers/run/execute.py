"""The executor: all work in parallel, on threads, on worker processes of this machine, or on a Dask cluster.

As a program it is the process from which workers are forked, so that modules are loaded once: ``python -P -m
drivers.run.execute FOLDER MODULE...``. FOLDER is that of temporary files. It loads the modules, and forks a worker for
each connection that it gets on its standard input. A worker does the work of another process until that closes their
connection: it sends the number of its process, then for each function with its argument True and the result, or False
and the error.
"""

import atexit
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from math import inf
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from threading import RLock
from typing import Any, TypeVar

from drivers.base.errors import InputError, RunError
from drivers.base.processes import Launched, all_stopped, cores, end, remove_abandoned, start, waited

Item = TypeVar("Item")
Result = TypeVar("Result")
LOCAL = "local"  # instead of an address: a Dask cluster on this machine
CONNECT_LIMIT_S = 5
RETRIES = 3  # of an item whose worker was killed
POLL_INTERVAL_S = 0.2
LIBRARIES = ("numba", "scipy.interpolate", "scipy.signal")  # which workers load at their start


class Worker:
    """Worker process, which ends at ``end`` or with this process, however that ends.

    It is in the session of the process from which it is forked, which the signals of a terminal do not reach.
    """

    def __init__(self) -> None:
        self._process: int | None = None
        self._pipe, theirs = Pipe()
        with theirs, _starting:
            try:
                send_handle(get_ready(), theirs.fileno(), None)
            except OSError:  # the process that forks was killed, and with it all workers
                _dismiss()
                send_handle(get_ready(), theirs.fileno(), None)

    def answer(self, work: Callable[[Any], Any], item: Any) -> tuple[bool, Any]:
        """True and the result of a function of an item, or False and its error.

        Raises:
            EOFError, ConnectionError: the process was killed.
            KeyboardInterrupt: all work is being stopped.
        """
        if self._process is None:
            self._process = self._received()
        self._pipe.send((work, item))
        succeeded, result = self._received()
        return succeeded, result

    def _received(self) -> Any:
        waited(self._pipe.poll, inf)
        return self._pipe.recv()

    def end(self) -> None:
        """End the process, whatever it does. It stays a zombie, so that no other process has its number."""
        self._pipe.close()
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.kill(self._process, signal.SIGKILL)


_forking: list[tuple[Launched, Connection]] = []  # the process from which workers are forked; one or none
_starting = RLock()
_idle: list[Worker] = []


def get_ready(*functions: Callable[..., Any]) -> Connection:
    """Connection to the process from which workers are forked.

    The first call starts it, in a session of its own. It loads the modules of functions, which nobody waits for.
    """
    with _starting:
        if not _forking:
            ours, theirs = Pipe()
            modules = (*(function.__module__ for function in functions), *LIBRARIES)
            command = (sys.executable, "-P", "-m", __name__, tempfile.gettempdir(), *modules)
            with theirs:
                _forking.append((start(command, Path.cwd(), {**os.environ}, stdin=theirs.fileno()), ours))
        return _forking[0][1]


@dataclass(frozen=True)
class Place:
    """Place of the work.

    Attributes:
        workers: number of threads, processes, or processes of a local Dask cluster.
        processes: True for worker processes, for work of Python; False for threads, which wait for engines.
        dask: address of a Dask scheduler, or ``local``.
    """

    workers: int = 0
    processes: bool = False
    dask: str = ""


CORES = Place()  # threads, one for each core


def execute(
    work: Callable[[Item], Result], items: Iterable[Item], place: Place = CORES, tick: Callable[[], None] = lambda: None
) -> Iterator[tuple[Item, Result]]:
    """Work on items in parallel; yields each with its result, as results come.

    An error of an item ends the work: items under way are finished on threads and ended in processes. An interrupt
    ends all engines and integrations. Worker processes and their engines end with this process, however it ends. An
    item whose worker was killed is begun again.

    Args:
        work: function of an item; for processes and Dask one that can be pickled.
        items: the items, begun in this order.
        place: threads, processes, or Dask.
        tick: function called several times a second.

    Raises:
        RunError: workers were killed again and again, or the connection to a Dask cluster was lost.
    """
    with _on_dask(place) if place.dask else _threads(place) as executor:
        work = partial(_in_worker, work) if place.processes else work
        under_way = {executor.submit(work, item): (number, item) for number, item in enumerate(items)}
        waiting = set(under_way)
        while waiting:
            ended, waiting = wait(waiting, POLL_INTERVAL_S, return_when="FIRST_COMPLETED")
            for future in sorted(ended, key=lambda future: under_way[future][0]):
                yield under_way[future][1], future.result()
            tick()


@contextmanager
def _threads(place: Place) -> Iterator[Executor]:
    """Threads; an error lets running items finish, an interrupt ends them, as an error does in worker processes."""
    with ThreadPoolExecutor(place.workers or cores()) as pool:
        try:
            yield pool
        except BaseException as error:
            with all_stopped() if place.processes or isinstance(error, KeyboardInterrupt) else nullcontext():
                pool.shutdown(cancel_futures=True)
            if place.processes:
                _dismiss()
            raise


def _in_worker(work: Callable[[Any], Any], item: Any) -> Any:
    """Result of an item by a worker process, by another one if that is killed."""
    for _ in range(1 + RETRIES):
        try:
            worker = _idle.pop()
        except IndexError:
            worker = Worker()
        try:
            succeeded, result = worker.answer(work, item)
        except (EOFError, ConnectionError):
            continue
        except BaseException:
            worker.end()
            raise
        _idle.append(worker)
        if not succeeded:
            raise result
        return result
    raise RunError("workers were killed; finished work is kept")


@atexit.register
def _dismiss() -> None:
    """End all workers, with the servers that they have started and their places."""
    _idle.clear()
    while _forking:
        launched, pipe = _forking.pop()
        pipe.close()
        end(*launched)
        remove_abandoned(Path(tempfile.gettempdir()))


def check_dask(address: str) -> None:
    """Check that a Dask cluster is available.

    Raises:
        InputError: ``distributed`` is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client

        if address != LOCAL:
            Client(address, timeout=CONNECT_LIMIT_S).close()
    except ImportError as error:
        raise InputError("--dask", "", "the package distributed is not installed; make cluster installs it") from error
    except (OSError, ValueError) as error:
        problem = "no scheduler answers; give the address of a running one, such as tcp://10.0.0.1:8786"
        raise InputError(f"--dask {address}", "", problem) from error


@contextmanager
def _on_dask(place: Place) -> Iterator[Executor]:
    """Workers of a Dask cluster, at an address or for this context on this machine."""
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        scheduler: Any = place.dask
        if place.dask == LOCAL:
            former = signal.signal(signal.SIGINT, signal.SIG_IGN)  # its processes must ignore Ctrl-C
            workers = place.workers or cores()
            cluster = LocalCluster(workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
            signal.signal(signal.SIGINT, former)
            scheduler = stack.enter_context(cluster)
        client = stack.enter_context(Client(scheduler, timeout=CONNECT_LIMIT_S))
        executor = client.get_executor(pure=False, retries=RETRIES)
        stack.callback(executor.shutdown, wait=False)  # does not wait after an error or Ctrl-C
        try:
            yield executor
        except CancelledError as lost:
            raise RunError("the connection to the cluster was lost; finished rows are kept") from lost
        except (InputError, RunError, OSError):
            raise
        except Exception as error:
            raise RunError(f"work failed on the cluster: {type(error).__name__}: {error}") from error


def main() -> None:
    """Fork workers, and work for another process as one of them."""
    tempfile.tempdir = sys.argv[1]  # else it would be tried with a file, which a kill would leave there
    for module in sys.argv[2:]:
        import_module(module)
    forking = Connection(os.dup(sys.stdin.fileno()))
    os.dup2(os.open(os.devnull, os.O_RDONLY), sys.stdin.fileno())  # else workers would open files in its place
    with suppress(EOFError, ConnectionError):  # by the other process
        while True:
            pipe = Connection(recv_handle(forking))
            if not os.fork():
                forking.close()
                _work(pipe)
            pipe.close()


def _work(pipe: Connection) -> None:
    """Work for the process at the other end of a connection until that closes it."""
    pipe.send(os.getpid())
    while True:
        work, item = pipe.recv()
        try:
            answer = True, work(item)
        except Exception as error:
            error.add_note(traceback.format_exc())  # which is lost on the way
            answer = False, error
        pipe.send(answer)


if __name__ == "__main__":
    main()
