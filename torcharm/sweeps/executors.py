"""Who computes shards: processes of this machine, any executor of `concurrent.futures`, or a Dask cluster."""

import os
import pickle
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from typing import Any

from torcharm.extras import extra
from torcharm.inputs import check_count, shown
from torcharm.sweeps.shards import Done, Job, compute_packed, compute_shard, load_engine

ATTEMPTS = 3
"""At a shard whose worker is lost: what ended three workers would end the fourth."""
AHEAD = 0.5
"""Shards handed over for each worker beside the one that it works on, so that few wait for their next one; more would
have to be finished after Ctrl-C."""
ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What a process is started with as 1: its libraries read it when they load."""
SECONDS = 0.5
"""At most, between two calls of whoever watches."""
ANSWER = 20
"""Seconds until which a scheduler must answer."""

Finished = Callable[[Done], None]
Watch = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Workers:
    """Where shards are handed to.

    Attributes:
        submit: hands over a shard of a job that was packed.
        slots: tells how many shards are worked on at once.
        renew: replaces all workers, once what they were given has ended; None where that is not for us to do.
        pack: makes bytes of a job.
        begin: has processes load what they need, before there is a shard to hand over.
    """

    submit: Callable[[bytes, int], "Future[Done]"]
    slots: Callable[[], int]
    renew: Callable[[], None] | None = None
    pack: Callable[[Job], bytes] = pickle.dumps
    begin: Callable[[], None] = lambda: None


@contextmanager
def workers_of(executor: Any, count: int | None) -> Iterator[Workers | None]:
    """Workers as asked for: `count` processes of this machine, an executor, or a Dask client or its address.

    None stands for this process alone, which it takes for one worker.

    Raises:
        ValueError: it is none of these, or Dask is asked for and not installed, or not there.
    """
    if count is not None and executor is not None:
        raise ValueError(f"workers: must be left out where an executor is given, got {shown(count)}")
    if executor is None:
        number = usable_cores() if count is None else check_count("workers", count, 1)
        if number == 1:
            yield None
            return
        with _own_processes(number) as own:
            yield own
    elif isinstance(executor, str):
        with _client(executor) as client:
            yield _of_dask(client)
    elif isinstance(executor, Executor):
        slots = int(getattr(executor, "_max_workers", 0) or usable_cores())
        yield Workers(lambda packed, shard: executor.submit(compute_packed, packed, shard), lambda: slots)
    elif hasattr(executor, "get_executor") and hasattr(executor, "nthreads"):
        yield _of_dask(executor)
    else:
        raise ValueError(
            "executor: must be None, an executor of concurrent.futures, a Dask client, or the address of a Dask "
            f"scheduler such as 'tcp://10.0.0.1:8786', got {shown(executor)}"
        )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_shards(workers: Workers | None, job: Job, shards: Sequence[int], finished: Finished, watch: Watch) -> bool:
    """Compute shards, in any order, and say whether all were.

    Ctrl-C stops as `watch` does; a second one at once.

    Args:
        workers: who computes; None is this process.
        job: what.
        shards: which, by their numbers.
        finished: is told of each that is done.
        watch: is called twice a second, or after each shard; True stops: what has begun is finished, and no more.

    Raises:
        ValueError: a shard lost its worker several times.
        OSError: a shard could not be written; and whatever else a shard raises.
    """
    pending: dict[Future[Done], int] = {}
    try:
        if workers is None:
            return _run_here(job, shards, finished, watch)
        return _run_there(workers, workers.pack(job), shards, pending, finished, watch)
    except KeyboardInterrupt:
        _finish(pending, finished)
        return False
    except BaseException:
        for future in pending:
            future.cancel()
        raise


def _run_here(job: Job, shards: Sequence[int], finished: Finished, watch: Watch) -> bool:
    for shard in shards:
        if watch():
            return False
        finished(compute_shard(job, shard))
    watch()
    return True


def _run_there(
    workers: Workers,
    packed: bytes,
    shards: Sequence[int],
    pending: dict["Future[Done]", int],
    finished: Finished,
    watch: Watch,
) -> bool:
    left, attempts = deque(shards), Counter[int]()
    while left or pending:
        lost = _hand_over(workers, packed, left, pending)
        for future in wait(pending, SECONDS, FIRST_COMPLETED).done:
            shard = pending.pop(future)
            if not _collect(future, finished):
                lost.append(shard)
        if lost and workers.renew is not None:  # with one process all others of its pool are lost
            workers.renew()
            lost += [shard for future, shard in pending.items() if not _collect(future, finished)]
            pending.clear()
        if lost:
            attempts.update(lost)
            _check_attempts(lost, attempts, workers)
            left.extendleft(sorted(lost, reverse=True))
        if watch():
            _finish(pending, finished)
            return False
    return True


def _hand_over(workers: Workers, packed: bytes, left: deque[int], pending: dict["Future[Done]", int]) -> list[int]:
    """Hand over shards until all workers are busy; returns those that a broken executor does not take."""
    slots = workers.slots()
    while left and len(pending) < slots + max(1, int(AHEAD * slots)):
        shard = left.popleft()
        try:
            pending[workers.submit(packed, shard)] = shard
        except BrokenExecutor:
            return [shard]
    return []


def _collect(future: "Future[Done]", finished: Finished) -> bool:
    """Tell of a shard that is done; False if its worker was lost."""
    try:
        done = future.result()
    except (BrokenExecutor, CancelledError):
        return False
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # Dask's, after several workers
            raise ValueError(f"executor: {error}") from None
        raise
    finished(done)
    return True


def _finish(pending: dict["Future[Done]", int], finished: Finished) -> None:
    """Wait for shards that have begun, and take back the others."""
    begun = [future for future in pending if not future.cancel()]
    for future in as_completed(begun):
        _collect(future, finished)
    pending.clear()


def _check_attempts(lost: Sequence[int], attempts: Counter[int], workers: Workers) -> None:
    worst = max(lost, key=lambda shard: attempts[shard])
    if workers.renew is None and attempts[worst] >= 2:
        raise ValueError("executor: has lost its workers; finished shards are kept, give another executor to go on")
    if attempts[worst] >= ATTEMPTS:
        raise ValueError(
            f"workers: processes ended {ATTEMPTS} times before shard {worst} was done: for want of memory, or because "
            "the script calls torcharm.sweep outside of `if __name__ == '__main__':`; what is finished stays"
        )


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of the Dask scheduler at an address."""
    distributed = extra("distributed", "sweep")
    try:
        client = distributed.Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ValueError(f"executor: no Dask scheduler answers at {address} ({error})") from None
    with client:
        yield client


def _of_dask(client: Any) -> Workers:
    """A Dask cluster; it does the shards of a lost worker again by itself.

    Force models of the calling script, which the cluster cannot import, are packed with their code.
    """
    executor = client.get_executor(pure=False)
    return Workers(
        lambda packed, shard: executor.submit(compute_packed, packed, shard),
        lambda: sum(client.nthreads().values()) or 1,
        pack=extra("cloudpickle", "sweep").dumps,
    )


@contextmanager
def _own_processes(count: int) -> Iterator[Workers]:
    """Processes of this machine, each of one thread."""
    pools = [_new_pool(count)]

    def renew() -> None:
        pools.pop().shutdown(wait=True, cancel_futures=True)
        pools.append(_new_pool(count))

    def begin() -> None:
        for _ in range(count):  # a pool starts one process for each call that none is free for
            pools[0].submit(load_engine)

    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield Workers(
            lambda packed, shard: pools[0].submit(compute_packed, packed, shard), lambda: count, renew, begin=begin
        )
    finally:
        pools[0].shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _new_pool(count: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """In a process of ours: one thread, no Ctrl-C of its own, and an end when the process that started it ends."""
    import signal

    import torch

    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """End this process when its parent has ended, as by kill -9: nobody would tell it."""
    connection.wait([sentinel])
    os._exit(1)
