"""Workers that evaluate the fitness: threads, processes or a Dask cluster behind one Executor."""

import logging
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from typing import Any, NamedTuple

from ampc_msgs_config.compiled import source_hash

CONNECTION_TIMEOUT = 10
"""Longest time until a scheduler answers [s]."""
NO_TRUST = (
    "Dask sends pickles, which can run any code: use it only with --trust-scheduler, and "
    "preferably with a tls:// address"
)
RETRIES = 3
"""Number of attempts to repeat a task whose worker died."""


class Workers(NamedTuple):
    """An executor and its properties."""

    executor: Executor
    capacity: int
    """Number of functions that run at the same time."""
    losses: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    """Exceptions of a result if the workers are lost."""


@contextmanager
def open_workers(
    count: int, processes: bool = False, scheduler: str = "", trusted: bool = False
) -> Iterator[Workers]:
    """Start workers, and release them at the end.

    Args:
        count: Number of threads or processes.
        processes: Use processes; threads are as fast because compiled code releases the GIL.
        scheduler: Address of a Dask scheduler whose workers are used instead.
        trusted: Accept pickles from the scheduler, which can hold any code.

    Raises:
        ValueError: The scheduler is not trusted, does not answer, has no workers, or its workers
            run other source code.
    """
    if scheduler:
        if not trusted:
            raise ValueError(f"--scheduler {scheduler}: {NO_TRUST}")
        with _cluster(scheduler) as workers:
            yield workers
    elif processes:
        with ProcessPoolExecutor(count, multiprocessing.get_context("forkserver")) as pool:
            yield Workers(pool, count)
    else:
        with ThreadPoolExecutor(count) as threads:
            yield Workers(threads, count)


@contextmanager
def _cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise ValueError(
            "--scheduler needs Dask: pip install -r lock/requirements-dask.txt"
        ) from error
    connect: Any = Client  # has no type annotations
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = connect(address, timeout=CONNECTION_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"--scheduler {address}: no scheduler answers: {cause}") from error
    try:
        count = _count_threads(client, address)
        losses = (BrokenExecutor, CancelledError, KilledWorker)
        yield Workers(client.get_executor(retries=RETRIES), count, losses)
    finally:
        client.close(timeout=CONNECTION_TIMEOUT)


def _count_threads(client: Any, address: str) -> int:
    """Return the number of threads of all workers, after a check of their source code."""
    try:
        hashes = client.run(source_hash)
    except Exception as error:  # any exception that the remote machine raises
        cause = " ".join(str(error).split())
        raise ValueError(f"--scheduler {address}: its workers cannot run AMPC: {cause}") from error
    if not hashes:
        raise ValueError(f"--scheduler {address}: has no workers")
    for worker, code in hashes.items():
        if code != source_hash():
            raise ValueError(f"--scheduler {address}: worker {worker} runs other source code")
    return sum(client.nthreads().values())
