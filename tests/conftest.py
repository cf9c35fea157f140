"""Shapes in signatures are checked at run time for as long as the tests run; tensors are small, so one thread does."""

import torch
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

_hook = install_import_hook("torcharm", "typecheck.checked")
_hook.__enter__()

settings.register_profile(
    "torcharm", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("torcharm")

torch.set_num_threads(1)


def pytest_collection_modifyitems(items):
    """Slow tests first: begun last, they would keep one process busy while all others have ended."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
