"""Who computes shards: this process, processes of this machine, any executor of `concurrent.futures`, or Dask."""

import os
import threading
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
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from itertools import islice
from multiprocessing import connection, get_context, parent_process
from typing import Any

from torcharm.extras import extra
from torcharm.inputs import check_count, shown

ATTEMPTS = 3
"""In a row in which workers are lost before one shard is done: what ended three would end the fourth."""
ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What a process is started with as 1: its libraries read it when they load."""
SECONDS = 0.5
"""At most, between two calls of whoever watches."""
ANSWER = 20
"""Seconds until which a scheduler must answer."""

Crew = tuple[Executor, Callable[[], int]]
"""An executor, and what tells how many shards it works on at once."""
Workers = Callable[[], AbstractContextManager[Crew]]
"""Starts a crew, again where one was lost."""


@contextmanager
def workers_of(executor: Any, count: int | None) -> Iterator[Workers]:
    """Workers as asked for: `count` processes of this machine, an executor, or a Dask client or its address.

    Raises:
        ValueError: it is none of these; or Dask is asked for and not installed, or not there.
    """
    if count is not None and executor is not None:
        raise ValueError(f"workers: must be left out where an executor is given, got {shown(count)}")
    if executor is None:
        number = usable_cores() if count is None else check_count("workers", count, 1)
        yield partial(_own_processes, number) if number > 1 else lambda: nullcontext((_Here(), lambda: 1))
    elif isinstance(executor, str):
        with _client(executor) as client:
            yield partial(_given, *_of_dask(client))
    elif isinstance(executor, Executor):
        slots = int(getattr(executor, "_max_workers", 0) or usable_cores())
        yield partial(_given, executor, lambda: slots)
    elif hasattr(executor, "get_executor") and hasattr(executor, "nthreads"):
        yield partial(_given, *_of_dask(executor))
    else:
        raise ValueError(
            "executor: must be None, an executor of concurrent.futures, a Dask client, or the address of a Dask "
            f"scheduler such as 'tcp://10.0.0.1:8786', got {shown(executor)}"
        )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_shards(
    workers: Workers,
    compute: Callable[[int], object],
    shards: Sequence[int],
    finished: Callable[[int], None],
    watch: Callable[[], bool],
) -> bool:
    """Compute shards, in any order, and say whether all were; with new workers where some are lost.

    Ctrl-C stops as `watch` does; a second one at once.

    Args:
        workers: who computes.
        compute: does so, given the number of a shard.
        shards: which, by their numbers.
        finished: is told of each that is done.
        watch: is called twice a second, or after each shard; True stops: what has begun is finished, and no more.

    Raises:
        ValueError: processes of this machine were lost again and again, or a given executor lost its workers.
        OSError: a shard could not be written; and whatever else a shard raises.
    """
    left, vain = list(shards), 0
    while True:
        before = len(left)
        try:
            with workers() as (executor, slots):
                return _run(executor, slots, compute, left, finished, watch)
        except Exception as error:
            if not _is_loss(error):
                raise
        vain = vain + 1 if len(left) == before else 1
        if vain >= ATTEMPTS:
            raise ValueError(
                f"workers: were lost {ATTEMPTS} times before a shard was done: for want of memory, or because the "
                "script calls torcharm.sweep outside of `if __name__ == '__main__':`; what is finished stays"
            )


def _run(
    executor: Executor,
    slots: Callable[[], int],
    compute: Callable[[int], object],
    left: list[int],
    finished: Callable[[int], None],
    watch: Callable[[], bool],
) -> bool:
    """Compute what is left, of which shards are taken that are done."""
    queue, pending = iter(tuple(left)), dict[Future[object], int]()

    def collect(future: Future[object]) -> None:
        shard = pending.pop(future)
        future.result()
        finished(shard)
        left.remove(shard)

    try:
        while not watch():
            more = slots() + slots() // 2 - len(pending)  # few wait for their next one, or for the end after Ctrl-C
            for shard in islice(queue, max(0, more)):
                pending[executor.submit(compute, shard)] = shard
            if not pending:
                return True
            for future in wait(pending, SECONDS, FIRST_COMPLETED).done:
                collect(future)
    except KeyboardInterrupt:
        pass
    except BaseException:
        for future in pending:
            future.cancel()
        raise
    with suppress(BrokenExecutor, CancelledError):  # no others are started now
        for future in as_completed([one for one in pending if not one.cancel()]):
            collect(future)
    return not left


def _is_loss(error: Exception) -> bool:
    """Whether workers were lost; the last is what Dask says once it has given up a shard."""
    return isinstance(error, (BrokenExecutor, CancelledError)) or type(error).__name__ == "KilledWorker"


class _Here(Executor):
    """This process, which does at once what it is given."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """What is done already."""
        future = Future[Any]()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def _given(executor: Executor, slots: Callable[[], int]) -> Iterator[Crew]:
    """An executor that is not ours to start again."""
    try:
        yield executor, slots
    except Exception as error:
        if not _is_loss(error):
            raise
        raise ValueError(
            "executor: has lost its workers; finished shards are kept, give another executor to go on"
        ) from error


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


def _of_dask(client: Any) -> Crew:
    """A Dask cluster, which does the shards of a lost worker again by itself."""
    return client.get_executor(pure=False), lambda: sum(client.nthreads().values()) or 1


@contextmanager
def _own_processes(count: int) -> Iterator[Crew]:
    """Processes of this machine, each of one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        with ProcessPoolExecutor(count, get_context("spawn"), _begin) as pool:
            yield pool, lambda: count
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


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
