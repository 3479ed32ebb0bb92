"""Who evaluates: threads, processes, or the workers of a Dask cluster, behind one `Executor`."""

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

PATIENCE = 10
"""How long a scheduler may take to answer [s]."""
NO_TRUST = (
    "Dask sends pickles, which run whatever code they hold: only with --trust-scheduler, and best "
    "with a tls:// address"
)
RETRIES = 3
"""Of a task whose worker died."""


class Workers(NamedTuple):
    """Where functions run."""

    executor: Executor
    places: int
    """How many functions can run at once."""
    losses: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    """What a result raises where the workers are gone."""


@contextmanager
def open_workers(
    count: int, processes: bool = False, scheduler: str = "", trusted: bool = False
) -> Iterator[Workers]:
    """Give workers, and let them go in the end.

    Args:
        count: Threads or processes.
        processes: Whether they are processes; the compiled call does not need them.
        scheduler: Address of a Dask scheduler, to use its workers instead.
        trusted: Whether to take pickles from it, which may hold any code.

    Raises:
        ValueError: No trust, or no scheduler there, or it has no workers, or they run other code.
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
    connect: Any = Client  # it has no types
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = connect(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"--scheduler {address}: no scheduler answers there: {cause}") from error
    try:
        count = _hired(client, address)
        losses = (BrokenExecutor, CancelledError, KilledWorker)
        yield Workers(client.get_executor(retries=RETRIES), count, losses)
    finally:
        client.close(timeout=PATIENCE)


def _hired(client: Any, address: str) -> int:
    """Number of threads of all workers, after a look at what they run."""
    try:
        codes = client.run(source_hash)
    except Exception as error:  # whatever their machine lacks
        cause = " ".join(str(error).split())
        raise ValueError(f"--scheduler {address}: its workers cannot run this: {cause}") from error
    if not codes:
        raise ValueError(f"--scheduler {address}: has no workers")
    for worker, code in codes.items():
        if code != source_hash():
            raise ValueError(f"--scheduler {address}: worker {worker} has another version of this")
    return sum(client.nthreads().values())
