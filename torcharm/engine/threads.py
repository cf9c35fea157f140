"""Work on batches in as many threads as PyTorch takes."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import torch

LEAST = 16
"""Elements that are worth a thread: fewer take less time than to hand them over."""
PARTS = 4
"""Of a batch for each thread: elements take unlike times."""


def spread(count: int, work: Callable[[int, int], None]) -> None:
    """Do work on the elements from one to another, without the last, of so many."""
    threads = min(torch.get_num_threads(), count // LEAST)
    if threads < 2:
        work(0, count)
        return
    edges = [count * part // (PARTS * threads) for part in range(PARTS * threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # none that a fork would inherit without its threads
        for done in [pool.submit(work, *edge) for edge in pairwise(edges)]:
            done.result()
