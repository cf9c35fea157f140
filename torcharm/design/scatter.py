"""Arms as they are built: designs whose dimensions and forces are scattered about what was drawn.

Each source of scatter moves K parameters x of an arm, such as its radii, by `x_k = size_k t(w_k)` with `w = mix z`, z
independent standard normal numbers: t(w) = w where sizes are standard deviations, and `2 Φ(w) - 1` where they are half
widths of uniform distributions (correlated ones by a Gaussian copula).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators.deviation import ForceDeviation
from torcharm.actuators.protocol import is_moulded
from torcharm.arm import ArmDesign
from torcharm.arm_series import rebuilt, segments_of, with_slices
from torcharm.characterise.fit import FittedActuator
from torcharm.design.space import Arm, Array
from torcharm.inputs import check_choice, check_flag, check_number, shown
from torcharm.statics.cross_section import group_alike

UNITS = {"radii": "m", "length": "m", "limits": "kPa", "force": "1", "force_offset": "N", "bending": "1"}
"""Of the parameters that a source moves, in the order of its name; parts of the model's value have the unit 1."""
FIELDS = tuple(UNITS)
MODEL = "model"
"""The name of the source that is a fitted model's own covariance."""
SOURCE_WORDS = {
    "radii": "offsets",
    "length": "lengths",
    "limits": "limits",
    "force": "force scale",
    "force_offset": "force offset",
    "bending": "bending",
    "model": "model fit",
}
"""What pictures and tables call what is scattered."""
DISTRIBUTIONS = ("normal", "uniform")
MOST = {
    "radii": (0.1, "0.1 m (is it in millimetres?)"),
    "length": (0.1, "0.1 m (is it in millimetres?)"),
    "force": (1.0, "1 (is it in percent?)"),
    "bending": (1.0, "1 (is it in percent?)"),
}
"""What no tolerance exceeds, and in words: more was meant in other units."""
SHORTEST = 6.0
"""An actuator is longer than so many of its length's tolerances: a built one has a length, then."""
CLOSEST = 1e-12
"""Probabilities are kept so far from 0 and 1, whose normal numbers are infinite."""

Sizes = float | Sequence[float]


@dataclass(frozen=True)
class Scatter:
    """By how much built arms differ from the drawn one: each value one number, or one for each of M actuators.

    Actuators are scattered independently of each other, those of one model too, unless `correlated` says otherwise.
    Those moulded in one body have one length, and that is scattered once. In space both offsets of an actuator, y and
    z, are scattered by `radii`.

    Attributes:
        radii: of offsets [m].
        length: of neutral lengths [m].
        limits: of pressure limits [kPa]; those that are 0 stay.
        force: of the force's scale, in parts of 1: 0.05 is 5 %.
        force_offset: added to the force at any strain and pressure [N].
        bending: of the bending moment's scale, in parts of 1.
        model_covariance: whether coefficients of fitted models are scattered by the covariance of their fit, normally;
            actuators of one model have one model, and so the same.
        distribution: "normal", where values are standard deviations; or "uniform", where they are half widths: nothing
            is further off.
        correlated: by the name of what is scattered the correlation between any two actuators of the arm, 0 to 1: 1
            scatters all alike, as of one batch or one pressure supply.

    Raises:
        ValueError: a value is negative, not finite or beyond what its unit makes sense for, a name is none of those
            above, or nothing is scattered.

    Example:
        >>> [source.name for source in ta.Scatter(radii=1e-3, force=0.05).sources(ta.antagonistic_arm())]  # 1 mm, 5 %
        ['radii', 'force']
    """

    radii: Sizes = 0.0
    length: Sizes = 0.0
    limits: Sizes = 0.0
    force: Sizes = 0.0
    force_offset: Sizes = 0.0
    bending: Sizes = 0.0
    model_covariance: bool = False
    distribution: str = "normal"
    correlated: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_choice("distribution", self.distribution, DISTRIBUTIONS)
        check_flag("model_covariance", self.model_covariance)
        for name in FIELDS:
            given = getattr(self, name)
            listed = isinstance(given, (Sequence, np.ndarray, Tensor)) and not isinstance(given, str) and np.ndim(given)
            values = tuple(check_size(name, one) for one in (given if listed else [given]))
            object.__setattr__(self, name, values if listed else values[0])
        if not isinstance(self.correlated, Mapping):
            raise ValueError(f"correlated: must map names to correlations, got {shown(self.correlated)}")
        for name, value in self.correlated.items():
            check_correlation(name, value)
            if np.max(getattr(self, name)) == 0:
                raise ValueError(f"correlated.{name}: must be of what is scattered, got {value:g} with {name}=0")
        if not self.model_covariance and not any(np.max(getattr(self, name)) > 0 for name in FIELDS):
            raise ValueError(f"scatter: must have one of {', '.join(FIELDS)} above 0, or model_covariance, got none")

    def sources(self, arm: Arm) -> tuple["Source", ...]:
        """What moves which parameters of arms like one.

        Raises:
            ValueError: values are not one for each actuator, a length could vanish, or no model has a covariance.
        """
        segments = segments_of(arm)[0]
        if any(segment.deviation is not None for segment in segments):
            raise ValueError("arm: must be as it was drawn, got one whose actuators deviate from their models")
        found = [source for name in FIELDS if (source := self._source(name, arm)) is not None]
        found += _model_sources(arm) if self.model_covariance else []
        if not found:
            raise ValueError("limits: must be of actuators that are driven, got an arm whose pressure limits are all 0")
        return tuple(found)

    def _source(self, name: str, arm: Arm) -> "Source | None":
        count, given = arm.actuator_count, np.asarray(getattr(self, name), dtype=np.float64)
        if given.ndim and given.shape != (count,):
            raise ValueError(f"{name}: must be one number, or one for each of {count} actuators, got {len(given)}")
        size = torch.from_numpy(np.broadcast_to(given, (count,)).copy())
        if name == "limits":
            size = torch.where(_whole(arm, "max_pressure") > 0, size, 0.0)
        if name == "length" and bool((SHORTEST * size >= _whole(arm, "length")).any()):
            shortest = float(_whole(arm, "length").min())
            raise ValueError(
                f"length: must be below a sixth of the shortest, {shortest:g} m, got {float(size.max()):g} m"
            )
        if not bool((size > 0).any()):
            return None
        items = _items(arm) if name == "length" else list(range(count))
        if name == "radii" and arm.dimension == 3:  # y of all actuators, then z
            both = _mixed(items, self.correlated.get(name, 0.0))
            return Source(name, torch.block_diag(both, both), torch.cat((size, size)), self.distribution == "uniform")
        mix = _mixed(items, self.correlated.get(name, 0.0))
        return Source(name, mix, size, self.distribution == "uniform")


def check_size(name: str, value: Any) -> float:
    """How far one of `FIELDS` is scattered, if that is at least 0 and makes sense in its unit."""
    size, (most, words) = check_number(name, value, 0.0, unit=UNITS[name].strip("1")), MOST.get(name, (math.inf, ""))
    if size > most:
        raise ValueError(f"{name}: must be at most {words}, got {size:g}")
    return size


def check_correlation(name: str, value: Any) -> float:
    """A correlation of one of `FIELDS`, if it is from 0 to 1."""
    check_choice("correlated", name, FIELDS)
    if not 0 <= check_number(f"correlated.{name}", value) <= 1:
        raise ValueError(f"correlated.{name}: must be from 0 to 1, got {value:g}")
    return float(value)


@dataclass(frozen=True, eq=False)
class Source:
    """K parameters of an arm that are scattered together, by L independent normal numbers.

    Attributes:
        name: of what is scattered.
        mix: (K, L).
        size: (K,) in the unit of the parameters.
        uniform: whether sizes are half widths.
        powers: of a model's source those of its K coefficients; else none.
        members: of a model's source its actuators.
    """

    name: str
    mix: Tensor
    size: Tensor
    uniform: bool
    powers: tuple[tuple[int, int], ...] = ()
    members: tuple[int, ...] = ()

    def values(self, normal: Tensor) -> Tensor:
        """Parameters (..., K) by normal numbers (..., L)."""
        mixed = normal @ self.mix.mT
        return self.size * (2 * torch.special.ndtr(mixed) - 1 if self.uniform else mixed)

    @property
    def covariance(self) -> Tensor:
        """(K, K) of the parameters; of uniform ones under a Gaussian copula `asin(ρ/2) 6/π` times both deviations."""
        alike = self.mix @ self.mix.mT
        alike = 2 / math.pi * torch.asin(alike.clamp(-1, 1) / 2) if self.uniform else alike
        return self.size.unsqueeze(-1) * alike * self.size


def normal_numbers(sources: Sequence[Source], count: int, seed: int, *, quasi: bool = True) -> Tensor:
    """(S, ΣL) standard normal numbers: scrambled Sobol' points, or independent ones."""
    numbers = sum(source.mix.shape[1] for source in sources)
    if not quasi:
        return torch.randn(count, numbers, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    points = torch.quasirandom.SobolEngine(numbers, scramble=True, seed=seed).draw(count, dtype=torch.float64)
    return torch.special.ndtri(points.clamp(CLOSEST, 1 - CLOSEST))


def scattered(sources: Sequence[Source], normal: Tensor) -> list[Tensor]:
    """For each source its parameters (..., K), by normal numbers (..., ΣL)."""
    parts = normal.split([source.mix.shape[1] for source in sources], -1)
    return [source.values(part) for source, part in zip(sources, parts, strict=True)]


def built_arms(arm: Arm, sources: Sequence[Source], values: Sequence[Tensor]) -> Arm:
    """Arms with their parameters moved by values (*#batch, K) of each source, whose batch broadcasts with the arms'."""
    batch = torch.broadcast_shapes(arm.batch_shape, *(value.shape[:-1] for value in values))
    moves = {source.name: value for source, value in zip(sources, values, strict=True) if source.name != MODEL}
    models = [(source, value) for source, value in zip(sources, values, strict=True) if source.name == MODEL]
    slices = with_slices(segments_of(arm)[0])
    return rebuilt(arm, [_built(one, batch, own, arm.actuator_count, moves, models) for one, own in slices])


def _built(
    segment: ArmDesign,
    batch: tuple[int, ...],
    own: slice,
    count: int,
    moves: Mapping[str, Tensor],
    models: Sequence[tuple[Source, Tensor]],
) -> ArmDesign:
    """One segment, whose actuators are some of so many."""
    shape = (*batch, segment.actuator_count)

    def moved(value: Tensor, name: str, place: slice = own) -> Tensor:
        move = moves.get(name)
        return (value if move is None else value + move[..., place].to(value)).expand(shape)

    limit, flat = moved(segment.max_pressure, "limits").clamp(min=0), segment.out_of_plane
    flat = None if flat is None else moved(flat, "radii", slice(count + own.start, count + own.stop))
    arm = segment.with_values(moved(segment.radii, "radii"), moved(segment.length, "length"), limit, flat)
    if not models and not {"force", "force_offset", "bending"} & set(moves):
        return arm
    one, terms = torch.ones_like(segment.radii), [((0, 0), moved(torch.zeros_like(segment.radii), "force_offset"))]
    for source, value in models:
        here = one.new_tensor([float(index in source.members) for index in range(own.start, own.stop)])
        if bool(here.any()):
            terms += [
                (power, here * c.unsqueeze(-1).to(one))
                for power, c in zip(source.powers, value.unbind(-1), strict=True)
            ]
    powers = tuple(power for power, _ in terms)
    force, bending = (moved(one, name).clamp(min=0) for name in ("force", "bending"))
    return arm.with_deviation(ForceDeviation(force, bending, powers, tuple(term for _, term in terms)))


def _whole(arm: Arm, name: str) -> Tensor:
    """(M,) a field of all actuators; of a batch the least."""
    parts = [getattr(segment, name).detach().double().cpu() for segment in segments_of(arm)[0]]
    return torch.cat([part.reshape(-1, part.shape[-1]).amin(0) for part in parts])


def _items(arm: Arm) -> list[int]:
    """For each actuator the number of its length: those moulded in one body share it."""
    found: list[int] = []
    for segment in segments_of(arm)[0]:
        body: int | None = None
        for model in segment.actuators:
            own = max(found, default=-1) + 1
            if is_moulded(model):
                body = own if body is None else body
                own = body
            found.append(own)
    return found


def _mixed(items: Sequence[int], correlation: float) -> Tensor:
    """(M, L) mix of actuators that have some items, whose correlation is given: `sqrt(ρ) z_0 + sqrt(1 - ρ) z_item`."""
    own = torch.eye(max(items) + 1, dtype=torch.float64)[list(items)]
    if correlation == 0:
        return own
    common = torch.full((len(items), 1), math.sqrt(correlation), dtype=torch.float64)
    return common if correlation == 1 else torch.cat((common, math.sqrt(1 - correlation) * own), -1)


def _model_sources(arm: Arm) -> list[Source]:
    """One for each fitted model of an arm."""
    found = []
    for model, members in group_alike(arm.actuators):
        if not isinstance(model, FittedActuator) or model.quality is None:
            continue
        scale = float(torch.as_tensor(model.force_scale).detach())
        value, vector = np.linalg.eigh(np.asarray(model.quality.covariance, dtype=np.float64))
        mix: Array = scale * vector * np.sqrt(value.clip(min=0))
        powers = tuple((i, j) for i, j, _ in model.coefficients)
        ones = torch.ones(len(powers), dtype=torch.float64)
        found.append(Source(MODEL, torch.from_numpy(mix), ones, False, powers, tuple(members)))
    if not found:
        raise ValueError("model_covariance: must be False for arms without a fitted model that knows its covariance")
    return found
