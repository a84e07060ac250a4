"""The executor: all work in parallel, on threads, on worker processes of this machine, or on a Dask cluster.

As a program it is a worker process, which does the work of another process until that closes their connection: ``python
-P -m drivers.run.execute FOLDER MODULE...``, with the connection as standard input. FOLDER is that of temporary files.
The modules are loaded before the first work. The answer to a function with its argument is True and the result, or
False and the error.
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
from pathlib import Path
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
    """Worker process, in a session of its own, which the signals of a terminal do not reach.

    It begins with loading ``modules``, and ends at ``end`` or with this process, however that ends.
    """

    def __init__(self, *modules: str) -> None:
        ours, theirs = Pipe()
        command = (sys.executable, "-P", "-m", __name__, tempfile.gettempdir(), *modules, *LIBRARIES)
        with theirs:
            self._launched: Launched = start(command, Path.cwd(), {**os.environ}, stdin=theirs.fileno())
        self._pipe: Connection = ours

    def answer(self, work: Callable[[Any], Any], item: Any) -> tuple[bool, Any]:
        """True and the result of a function of an item, or False and its error.

        Raises:
            EOFError, ConnectionError: the process was killed.
            KeyboardInterrupt: all work is being stopped.
        """
        self._pipe.send((work, item))
        waited(self._pipe.poll, inf)
        succeeded, result = self._pipe.recv()
        return succeeded, result

    def end(self) -> None:
        """End the process, whatever it does."""
        end(*self._launched)
        self._pipe.close()


_idle: list[Worker] = []


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
                remove_abandoned(Path(tempfile.gettempdir()))  # places of the workers
            raise


def get_ready(workers: int, *functions: Callable[..., Any]) -> None:
    """Start worker processes, which load the modules of functions, without waiting for them."""
    _idle.extend(Worker(*(function.__module__ for function in functions)) for _ in range(workers - len(_idle)))


def idle_worker() -> Worker:
    """A worker process that waits for work, or a new one; ``end`` ends it."""
    try:
        return _idle.pop()
    except IndexError:
        return Worker()


def _in_worker(work: Callable[[Any], Any], item: Any) -> Any:
    """Result of an item by a worker process, by another one if that is killed."""
    for _ in range(1 + RETRIES):
        worker = idle_worker()
        try:
            succeeded, result = worker.answer(work, item)
        except BaseException as error:
            worker.end()
            if not isinstance(error, (EOFError, ConnectionError)):
                raise
            continue
        _idle.append(worker)
        if not succeeded:
            raise result
        return result
    raise RunError("workers were killed; finished work is kept")


@atexit.register
def _dismiss() -> None:
    """End the workers, with the servers that they have started and their places."""
    for worker in _idle:
        worker.end()
    if _idle:
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
    """Work for another process."""
    tempfile.tempdir = sys.argv[1]  # else it would be tried with a file, which a kill would leave there
    for module in sys.argv[2:]:
        import_module(module)
    pipe = Connection(sys.stdin.fileno())
    with suppress(EOFError):
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
