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


@pytest.fixture(scope="session", autouse=True)
def _each_worker_compiles_its_own_part():
    """Of the two kernels that take longest to compile: at once both workers would need, and compile, the same one."""
    if os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1") == "1":
        return
    import torcharm as ta

    arm, worker = ta.antagonistic_arm(), os.environ["PYTEST_XDIST_WORKER"]
    if worker == "gw0":
        ta.search_pressure(arm, ta.Task(ta.constant_curvature(0.1, nodes=2), [0.0] * 3), starts=1)
    elif worker == "gw1":
        ta.solve_equilibrium(arm, [0.0] * 4, [0.0] * 3, nodes=2)


@pytest.fixture(autouse=True)
def _signatures_are_checked_anew():
    typecheck.check_again()


def pytest_collection_modifyitems(items):
    """Slow tests first: begun last, they would keep one process busy while all others have ended."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
