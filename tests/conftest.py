"""Shapes in signatures are checked at run time for as long as the tests run; tensors are small, so one thread does."""

import os

# numpy's and scipy's threads, and those of processes that tests start, would wait for one another
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "Agg"  # figures open no window

import pytest
import torch
import typecheck
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

_hook = install_import_hook("torcharm", "typecheck.checked")
_hook.__enter__()

settings.register_profile(
    "torcharm", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("torcharm")

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _signatures_are_checked_anew():
    typecheck.check_again()


def pytest_collection_modifyitems(items):
    """Slow tests first: begun last, they would keep one process busy while all others have ended."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
