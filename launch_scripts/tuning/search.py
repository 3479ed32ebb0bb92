"""Carries searches out: they run here, in threads; only fitness is asked for elsewhere."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from threading import Event
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.pso.minimize import search
from ampc_ros.pso.swarm import Swarm
from launch_scripts.tuning.files import Checkpoints
from launch_scripts.tuning.space import dimensions
from launch_scripts.tuning.task import Job
from launch_scripts.tuning.workers import Workers

Progress = Callable[[Job, Swarm], None]


class Found(NamedTuple):
    """What a search came to."""

    gains: Gains
    fitness: float
    """Infinite: every car was lost."""


class Stopped(Exception):
    """Another search has failed."""


def carry_out(
    jobs: Sequence[Job], workers: Workers, checkpoints: Checkpoints, show: Progress
) -> dict[str, Found]:
    """Search, several at a time; gives what was found by the job's name.

    Args:
        jobs: The searches; each begins where its checkpoint is.
        workers: Who evaluates.
        checkpoints: Receive every generation before the next one begins.
        show: Called after each generation, in whatever thread.

    Raises:
        ValueError: The workers are gone, or a checkpoint cannot be read or written.
    """
    stop = Event()

    def one(job: Job) -> tuple[str, Found]:
        return job.name, _search(job, workers, checkpoints, show, stop)

    with ThreadPoolExecutor(min(len(jobs), workers.places + 1)) as drivers:
        tasks = [drivers.submit(one, job) for job in jobs]
        try:
            done, _ = wait(tasks, return_when=FIRST_EXCEPTION)
            failures = [e for task in done if (e := task.exception()) is not None]
            for failure in sorted(failures, key=lambda e: isinstance(e, Stopped)):
                raise failure
        except workers.losses as error:
            cause = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"workers: lost ({cause}); --resume goes on without them") from error
        finally:
            stop.set()
    return dict(task.result() for task in tasks)


def _search(
    job: Job, workers: Workers, checkpoints: Checkpoints, show: Progress, stop: Event
) -> Found:
    before = checkpoints.load(job.name)
    where, share = dimensions(job.space), _spread(workers)
    for swarm in search(job.cost, where, job.settings, job.rng, share, before):
        if swarm is not before:
            checkpoints.save(job.name, swarm)
        show(job, swarm)
        if stop.is_set():
            raise Stopped
    best = swarm.best_position[swarm.leader]
    rounded = np.where([item.integer for item in where], np.rint(best), best)
    return Found(job.gains(rounded), float(swarm.best_fitness[swarm.leader]))


def _spread(workers: Workers) -> Callable[[Callable[..., Any], Array], Iterable[Any]]:
    """Give a `map` that hands a generation to the workers in as many parts as they are."""

    def spread(cost: Callable[..., Any], positions: Array) -> Array:
        parts = np.array_split(positions, min(workers.places, len(positions)))
        tasks = [workers.executor.submit(cost, part) for part in parts]
        return np.concatenate([task.result() for task in tasks])

    return spread
