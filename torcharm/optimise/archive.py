"""Results and checkpoints as files: a JSON header and arrays in one .npz, written at once or not at all. No pickle."""

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm._inputs import shown
from torcharm.actuators import Actuator, Bellows, McKibben, PolynomialActuator
from torcharm.arm import ArmDesign
from torcharm.files import StrPath, atomic_write, check_writable, read_file

KINDS = {model.__name__: model for model in (Bellows, McKibben, PolynomialActuator)}
FORMAT = 1
Arrays = dict[str, npt.NDArray[Any]]


def write_archive(path: StrPath, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a header and arrays; the file appears whole, replacing what was there, or what was there stays.

    Raises:
        ValueError: there can be no such file.
        OSError: writing failed.
    """
    check_writable(path)
    text = json.dumps({"format": FORMAT, **header})
    with atomic_write(path) as partial, partial.open("wb") as file:
        np.savez(file, header=np.array(text), **{name: _as_array(value) for name, value in arrays.items()})


def read_archive(path: StrPath) -> tuple[dict[str, Any], Arrays]:
    """The header and arrays of a file.

    Raises:
        ValueError: the file cannot be read, or is none that `write_archive` wrote.
    """
    whole = read_file(path)
    try:
        with np.load(io.BytesIO(whole), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(str(arrays.pop("header")))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        raise ValueError(f"{path}: is no optimisation that torcharm saved") from None
    if header.get("format") != FORMAT:
        raise ValueError(f"{path}: is of format {header.get('format')}, this torcharm reads {FORMAT}")
    return header, arrays


def _as_array(value: Any) -> npt.NDArray[Any]:
    return value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)


def plain(value: Any) -> Any:
    """Settings as what JSON holds."""
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(entry) for name, entry in asdict(value).items()}
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (Tensor, np.ndarray, np.generic)):
        return value.tolist()
    return value if value is None or isinstance(value, (bool, int, float, str)) else shown(value)


def model_header(models: Sequence[Actuator]) -> list[dict[str, Any]]:
    """Force models as JSON; those that are not torcharm's own by name only."""
    return [
        {"kind": type(model).__name__, **(plain(model) if type(model) in KINDS.values() else {"foreign": shown(model)})}
        for model in models
    ]


def models_from(header: Sequence[Mapping[str, Any]], given: Sequence[Actuator] | None, path: object) -> list[Actuator]:
    """The force models that a header describes; those that are not torcharm's own must be given.

    Raises:
        ValueError: a model is not torcharm's own and none are given, or as many as needed are not.
    """
    if given is not None:
        if len(given) != len(header):
            raise ValueError(f"actuators: {path} has {len(header)}, got {len(given)}")
        return list(given)
    models: list[Actuator] = []
    for entry in header:
        if "foreign" in entry:
            raise ValueError(
                f"actuators: {path} holds a force model of your own, {entry['foreign']}; pass actuators=..."
            )
        options = {name: _tuples(value) for name, value in entry.items() if name != "kind"}
        models.append(KINDS[entry["kind"]](**options))
    return models


def _tuples(value: Any) -> Any:
    return tuple(_tuples(entry) for entry in value) if isinstance(value, list) else value


def design_arrays(name: str, arm: ArmDesign) -> dict[str, Tensor]:
    """Designs as arrays under a prefix."""
    return {f"{name}.{field}": getattr(arm, field) for field in ("radii", "length", "max_pressure")}


def design_from(name: str, arrays: Arrays, models: Sequence[Actuator]) -> ArmDesign:
    """The designs under a prefix."""
    radii, length, limit = (
        torch.from_numpy(arrays[f"{name}.{field}"]) for field in ("radii", "length", "max_pressure")
    )
    return ArmDesign(radii, length, models, limit)
