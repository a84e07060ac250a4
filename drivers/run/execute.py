"""The executor: all work in parallel, on threads, on worker processes of this machine, or on a Dask cluster."""

import atexit
import multiprocessing
import os
import platform
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from multiprocessing import connection, forkserver, resource_tracker
from pathlib import Path
from typing import Any, TypeVar

from drivers.base.errors import InputError, RunError
from drivers.base.processes import all_stopped, cores, leave, private_temporary_folder, workplace

Item = TypeVar("Item")
Result = TypeVar("Result")
LOCAL = "local"  # instead of an address: a Dask cluster on this machine
CONNECT_LIMIT_S = 5
RETRIES = 3  # of an item whose Dask worker died
POLL_INTERVAL_S = 0.2
EXIT_LIMIT_S = 10.0  # for workers that are asked to end
MAX_PLACE_BYTES = 66  # of the folder and the machine's name in paths of sockets, which Linux limits to 107 bytes
LIBRARIES = ("scipy.interpolate", "scipy.signal")  # imported once for all workers
WARNING_FILTER = "ignore:resource_tracker"  # after a kill, Python would warn of leaked semaphores


class WorkersKilledError(RunError):
    """Workers or their fork server were killed from outside."""


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
    work: Callable[[Item], Result],
    items: Iterable[Item],
    place: Place = CORES,
    tick: Callable[[], None] = lambda: None,
) -> Iterator[tuple[Item, Result]]:
    """Work on items in parallel; yields each with its result, as results come.

    An error of an item ends the work: items under way are finished on threads and ended in processes. An interrupt
    ends all engines and integrations. Worker processes and their engines end with this process, however it ends.

    Args:
        work: function of an item; for processes and Dask one that can be pickled.
        items: the items, begun in this order.
        place: threads, processes, or Dask.
        tick: function called several times a second.

    Raises:
        WorkersKilledError: a worker process or the fork server was killed.
        RunError: the connection to a Dask cluster was lost.
    """
    executor_at = _on_dask if place.dask else _processes if place.processes else _threads
    with executor_at(place) as executor:
        with ThreadPoolExecutor(1) as thread:  # no signal interrupts it: a worker with half of its setup complains
            under_way = thread.submit(
                lambda: {executor.submit(work, item): (number, item) for number, item in enumerate(items)}
            ).result()
        waiting = set(under_way)
        while waiting:
            ended, waiting = wait(waiting, POLL_INTERVAL_S, return_when="FIRST_COMPLETED")
            for future in sorted(ended, key=lambda future: under_way[future][0]):
                yield under_way[future][1], future.result()
            tick()


@contextmanager
def _threads(place: Place) -> Iterator[Executor]:
    """Threads; an error lets running items finish, an interrupt ends them."""
    with ThreadPoolExecutor(place.workers or cores()) as pool:
        try:
            yield pool
        except BaseException as error:
            with all_stopped() if isinstance(error, KeyboardInterrupt) else nullcontext():
                pool.shutdown(cancel_futures=True)
            raise


def get_ready(*functions: Callable[..., Any]) -> None:
    """Start the fork server of worker processes, with the modules of functions loaded, without waiting for it."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(
        [*(function.__module__ for function in functions), *LIBRARIES]
    )
    if WARNING_FILTER not in sys.warnoptions:
        sys.warnoptions.append(WARNING_FILTER)
    _start_fork_server()


@cache
def _keep_sockets() -> None:
    """Have multiprocessing keep its sockets in a workplace, which the next one removes if this process is killed.

    It is in another folder if temporary files lie too deep for a socket, as on clusters.
    """
    home, node = private_temporary_folder(), platform.node()
    places = workplace(home if len(os.fsencode(home)) + len(node) <= MAX_PLACE_BYTES else Path("/tmp"))
    multiprocessing.current_process()._config["tempdir"] = str(places.__enter__())  # type: ignore[attr-defined]
    atexit.register(places.__exit__, None, None, None)


def _start_fork_server() -> None:
    """Start the fork server if it does not run, deaf to signals that a terminal or a scheduler sends to all processes.

    A server that Ctrl-C ends prints a traceback; after SIGTERM its workers would seem dead while they end engines.
    """
    _keep_sockets()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})  # inherited, as the others
    try:
        resource_tracker.ensure_running()  # which unblocks the others here, and ignores them
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def _processes(place: Place) -> Iterator[Executor]:
    """Worker processes, which end with the context."""
    _start_fork_server()
    context = multiprocessing.get_context("forkserver")
    pool = ProcessPoolExecutor(place.workers or cores(), context, _begin)
    try:
        yield pool
    except BaseException as error:
        processes = multiprocessing.active_children()
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(EXIT_LIMIT_S)
        # after the workers have ended: one that is stopped while it reads from the pool's queue would damage the queue
        pool.shutdown(cancel_futures=True)
        if isinstance(error, (BrokenProcessPool, EOFError, ConnectionError)):
            raise WorkersKilledError("workers were killed; finished work is kept") from error
        raise
    pool.shutdown()


def _begin() -> None:
    """Initialize a worker process: it heeds SIGTERM alone, which its parent sends, and dies with its parent."""
    signal.signal(signal.SIGTERM, lambda *_: leave())
    tempfile.gettempdir()  # tries its folder with a file, which a signal would leave there
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """Kill this worker when its parent dies; its engines end with it."""
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGKILL)


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


def check_dask(address: str) -> None:
    """Check that a Dask cluster is available.

    Raises:
        InputError: ``distributed`` is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--dask", "", "the package distributed is not installed; make cluster installs it") from error
    try:
        if address != LOCAL:
            Client(address, timeout=CONNECT_LIMIT_S).close()
    except (OSError, ValueError) as error:
        problem = "no scheduler answers; give the address of a running one, such as tcp://10.0.0.1:8786"
        raise InputError(f"--dask {address}", "", problem) from error
