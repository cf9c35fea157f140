"""From a block of designs and tasks to each node's distance from what is required to what is attainable."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm._outer import Block
from torcharm._sampled_distances import (
    Required,
    Sampling,
    decided,
    hulls_of,
    impossible_nodes,
    inputs_want_gradient,
    points_of,
    possible_sections,
    required_by_metric,
    sampled_distances,
    strain_excess,
)
from torcharm.actuators import want_gradients
from torcharm.distance.closed_form import BOUNDARY_ULPS, NearestFaces, face_normals, nearest_faces, signed_length
from torcharm.hulls import (
    Curves,
    ExactHulls,
    Hulls,
    Sections,
    build_hulls,
    corner_fractions,
    cross_sections,
    relative_curves,
    sample_curves,
)
from torcharm.polygon import face_square
from torcharm.wrench_sets.vertex_sets import DistanceFunction

if TYPE_CHECKING:
    from torcharm._arrays import Array
    from torcharm.distance.touch import CurveSums
    from torcharm.laws import Laws


@dataclass(frozen=True)
class Check(Sampling):
    """What to measure, and how.

    Attributes:
        polish: whether to go on from the sampled sets to the sets themselves.
        compiled: whether machine code may do so.
        solver: what answers distances to sets of vertices; None for the closed form.
        auditor: what answers for the residuals; None if they are not asked for.
    """

    polish: bool
    compiled: bool
    solver: DistanceFunction | None
    auditor: DistanceFunction | None


@dataclass(frozen=True, eq=False)
class Residuals:
    """How far to trust each node's distance, from its nearest point as a mix of the hull's vertices.

    `primal`, `dual` and `gap` are relative, and as of `kkt_residuals`.

    Attributes:
        primal: how far the weights of the mix are from convex.
        dual: how far a vertex lies beyond the supporting line.
        gap: primal minus dual objective.
        converged: whether primal residual and error of the distance are within tolerance.
        resolved: whether an exact method answered, because the solver asked for had failed.
    """

    primal: Tensor
    dual: Tensor
    gap: Tensor
    converged: Tensor
    resolved: Tensor


AGREEMENT = 1e-8
"""By how much of the polygon's size a distance may differ when its face is evaluated again with gradients."""
FEW_SECTIONS = 300
"""Up to so many the polygons' graph is the faster one, whatever the loads."""
INNER_SAMPLES = 5
"""Samples a curve, at least, and their kinks, of sets to be polished from inside."""
COLUMNS = tuple(field.name for field in fields(Residuals))
Columns = tuple[Tensor, ...]


def node_distances(block: Block, required: Required, check: Check, recompute: bool) -> Columns:
    """The strain excess (d, p, l), distances (d, p, l, K, N) to the hulls, whether they
    converged and, with an auditor, their residuals.

    Args:
        required: by all tasks, of which the block's are taken.
        recompute: whether to rebuild graphs when they are needed instead of keeping them.
    """
    sampled = check.solver is None and not check.polish and not _replay_is_cheaper(block, check)
    if sampled:
        answers, excess, shape = _of_polygons(block, required, check, recompute)
    elif check.solver is None:
        found = _by_machine_code(block, required, check, recompute) if check.polish and check.compiled else None
        answers, excess, shape = _by_closed_form(block, check, recompute) if found is None else found
    else:
        answers, excess, shape = _by_solver(block, check, check.solver, recompute)
    if not sampled:
        lengths = decided(block, check, [answer[0] for answer in answers])
        answers = [(length, *answer[1:]) for length, answer in zip(lengths, answers, strict=True)]
    if bool(impossible_nodes(block.arm.radii, block.twists).any()):
        excess = strain_excess(cross_sections(block.arm, block.twists))
    by_column = [torch.stack(column).unflatten(1, shape) for column in zip(*answers, strict=True)]  # (K, p, N, d, l)
    columns = [column.permute(3, 1, 4, 0, 2) for column in by_column]
    return excess.T.unsqueeze(-1).expand(columns[0].shape[:3]), *columns


def _replay_is_cheaper(block: Block, check: Check) -> bool:
    """Whether two pressures a face, evaluated again, make a smaller graph than a section's samples.

    So it is where a section bears few loads; of few sections, calls cost more than arithmetic, and polygons need fewer.
    """
    loads, sections = block.tip_load.shape[1], len(block.arm.radii) * block.twists.shape[:-1].numel()
    few = 4 * loads < 3 * check.samples and sections > FEW_SECTIONS
    return few and torch.is_grad_enabled() and inputs_want_gradient(block)


def _of_polygons(
    block: Block, required: Required, check: Check, recompute: bool
) -> tuple[list[Columns], Tensor, tuple[int, int, int]]:
    """For each metric distances (B, l), flags and residuals; the strain excess (p, d); and (p, N, d)."""
    found = sampled_distances(block, required, check, recompute=recompute)
    answers: list[Columns] = []
    for metric, length, hulls, point in zip(check.metrics, found.lengths, found.hulls, found.points, strict=True):
        relative, auditor = metric == "relative", check.auditor
        with torch.no_grad():
            residuals = () if auditor is None else _solve(found.sections, hulls, point, check, relative, auditor)[2:]
        answers.append((length, torch.ones_like(length, dtype=torch.bool), *residuals))
    assert found.excess is not None
    return answers, found.excess, found.sections.shape


def _by_closed_form(block: Block, check: Check, recompute: bool) -> tuple[list[Columns], Tensor, tuple[int, int, int]]:
    """As `_of_polygons`, of the sets themselves (polished), or where there are many sections of few loads.

    The hulls are searched without gradients. Where gradients are wanted, the reactions at the two
    ends of each nearest face are evaluated once more with them: a graph of two pressures a
    node, not of whole hulls.
    """
    followed = torch.is_grad_enabled() and inputs_want_gradient(block)
    with torch.no_grad():
        sections = possible_sections(block)
        curves = _Sampled.of(sections, check)
        found = [_nearest_face(block, sections, curves, check, metric, slots=followed) for metric in check.metrics]
    if followed:
        replay = _Replay(block, check, [one.fraction for one in found])
        *again, excess = checkpoint(replay, use_reentrant=False) if recompute else replay()
        replays = [_agreeing(square, one.faces, check.signed) for square, one in zip(again, found, strict=True)]
    else:
        replays = [(one.faces.square, torch.ones_like(one.converged)) for one in found]
        excess = strain_excess(sections)
    answers = [
        (
            signed_length(square, one.faces.inside, one.faces.blur, signed=check.signed),
            one.converged & agrees,
            *one.residuals,
        )
        for (square, agrees), one in zip(replays, found, strict=True)
    ]
    return answers, excess, sections.shape


def _by_machine_code(
    block: Block, required: Required, check: Check, recompute: bool
) -> tuple[list[Columns], Tensor, tuple[int, int, int]] | None:
    """As `_by_closed_form`, of the sets themselves; None where machine code does not know them or did not converge."""
    from torcharm._face_squares import Faces, face_squares  # load when they are first asked for
    from torcharm.distance.compiled import CompiledFaces, compiled_faces, law_table

    if check.auditor is not None or want_gradients(block.arm.actuators, block.arm.radii):
        return None
    followed = torch.is_grad_enabled() and inputs_want_gradient(block)
    again = followed and recompute
    points = [points_of(block, required[metric]) for metric in check.metrics]
    with torch.set_grad_enabled(followed and not again):
        sections = possible_sections(block)
    found: list[CompiledFaces] = []
    laws = law_table(sections)
    if laws is None:
        return None
    with torch.no_grad():
        for metric, point in zip(check.metrics, points, strict=True):
            one = compiled_faces(
                sections,
                laws,
                point,
                check.scale,
                relative=metric == "relative",
                signed=check.signed,
                fractions=followed,
            )
            if not bool(one.converged.all()):
                return None
            found.append(one)

    def replay(sections: Sections) -> Columns:
        squares: list[Tensor] = []
        for metric, point, one in zip(check.metrics, points, found, strict=True):
            assert one.fraction is not None
            faces = Faces(one.fraction, one.kinked, check.scale, metric == "relative")
            squares.append(face_squares(sections, point, faces))
        return *squares, strain_excess(sections)

    if again:
        *squares, excess = checkpoint(lambda: replay(possible_sections(block)), use_reentrant=False)
    elif followed:
        *squares, excess = replay(sections)
    else:
        squares, excess = [one.faces.square for one in found], strain_excess(sections)
    answers: list[Columns] = []
    for square, one in zip(squares, found, strict=True):
        agrees = one.converged
        if followed:
            square, agrees = _agreeing(square, one.faces, check.signed)
            if not bool(agrees.all()):  # a model's slopes are not those of its law
                return None
        answers.append((signed_length(square, one.faces.inside, one.faces.blur, signed=check.signed), agrees))
    return answers, excess, sections.shape


def _agreeing(square: Tensor, faces: NearestFaces, signed: bool) -> tuple[Tensor, Tensor]:
    """Squares (B, l) with gradients, where they are those that were found; and whether (B, l) they are.

    Of hulls that are slivers at the edge of what numbers can hold, faces may be lost in rounding. Where the
    distance is 0 there is nothing to agree on.
    """
    off = (square.detach().sqrt() - faces.square.sqrt()).abs()
    blurs = max(AGREEMENT / (BOUNDARY_ULPS * torch.finfo(off.dtype).eps), 1e4)
    close = off <= blurs * faces.blur
    touching = faces.square <= faces.blur.square()
    settled = touching if signed else touching | faces.inside
    return square if bool(close.all()) else torch.where(close, square, faces.square), close | settled


@dataclass(frozen=True)
class _Nearest:
    """Where the required wrenches (B, l) stand to the hulls of one metric.

    Attributes:
        faces: the nearest ones.
        fraction: (2, M, B, l) pressure fractions at their ends, if asked for.
        converged: (B, l) whether they are what was asked for.
        residuals: (B, l) each, if asked for.
    """

    faces: NearestFaces
    fraction: Tensor | None
    converged: Tensor
    residuals: Columns


@dataclass(frozen=True)
class _Sampled:
    """The curves of absolute reactions, sampled; to be polished, by their laws instead, if all models write theirs."""

    curves: Curves | None
    laws: "Laws | None"

    @classmethod
    def of(cls, sections: Sections, check: Check) -> "_Sampled":
        if check.polish:
            from torcharm.laws import section_laws  # loads when it is first asked for

            laws = section_laws(sections)
            if laws is not None:
                return cls(None, laws)
        return cls(sample_curves(sections, check.samples), None)

    def metric(self, sections: Sections, relative: bool) -> "Laws | None":
        """The laws of absolute or relative reactions, if known."""
        return self.laws.minus_first(sections) if self.laws is not None and relative else self.laws

    def samples(self, sections: Sections, check: Check, relative: bool, laws: "Laws | None") -> Curves:
        """The curves of absolute or relative reactions, sampled.

        From outside few samples show what to polish; inside, where the nearest of all faces counts, it takes more.
        """
        if self.curves is not None:
            return relative_curves(sections, self.curves) if relative else self.curves
        assert laws is not None
        count = max(check.samples, INNER_SAMPLES) if check.signed else check.samples
        grid, force = laws.samples(sections.radii, count, kinks=check.signed)
        bending = sections.bending - sections.at_first_node(sections.bending) if relative else sections.bending
        return Curves(grid, force, bending, sections.radii, sections.resting_moment(relative=relative))


def _nearest_face(
    block: Block, sections: Sections, sampled: _Sampled, check: Check, metric: str, *, slots: bool
) -> _Nearest:
    relative, auditor = metric == "relative", check.auditor
    point = required_points(block, check.scale, relative)
    laws = sampled.metric(sections, relative)
    sums = None
    if laws is not None:
        from torcharm.distance.touch import curve_sums  # loads when it is first asked for

        sums = curve_sums(laws, sections, check.scale, relative=relative)
        if not check.signed and auditor is None and bool(sums[1].all()):
            nearest = _outside(sections, sums[0], point, check, relative, slots)
            if bool(nearest.converged.all()):
                return nearest
    hulls = build_hulls(sampled.samples(sections, check, relative, laws), check.hull, check.scale)
    faces = nearest_faces(hulls.polygons, *point, slots=slots or check.polish)
    residuals = () if auditor is None else _solve(sections, hulls, point, check, relative, auditor)[2:]
    if not check.polish:
        fraction = _fractions(hulls, faces, point) if slots else None
        return _Nearest(faces, fraction, torch.ones_like(faces.inside), residuals)

    from torcharm.distance.polish import polish  # loads when it is first asked for

    assert isinstance(hulls, ExactHulls)

    polished = polish(sections, hulls, sums, faces, point, relative=relative, signed=check.signed, fractions=slots)
    fraction = polished.fraction
    if fraction is not None and not bool(polished.converged.all()):
        fraction = torch.where(polished.converged, fraction, _fractions(hulls, faces, point))
    return _Nearest(polished.faces, fraction, polished.converged, residuals)


def _outside(
    sections: Sections, sums: "CurveSums", point: tuple[Tensor, Tensor], check: Check, relative: bool, fractions: bool
) -> _Nearest:
    """Nearest faces of sets whose curves are written out, if points inside do not count."""
    from torcharm._arrays import as_array
    from torcharm.distance.outside import nearest_outside  # loads when it is first asked for

    x, y = point
    resting = sections.resting_moment(relative=relative)
    y = y if resting is None else y - check.scale[1] * resting.unsqueeze(-1)
    found = nearest_outside(sums, as_array(x), as_array(y), fractions=fractions)

    def tensor(value: "Array") -> Tensor:
        return torch.from_numpy(value).to(x.device)

    faces = NearestFaces(tensor(found.square), tensor(found.inside), tensor(found.blur), None)
    fraction = None if found.fraction is None else tensor(found.fraction)
    return _Nearest(faces, fraction, tensor(found.converged), ())


def _fractions(hulls: Hulls, faces: NearestFaces, point: tuple[Tensor, Tensor]) -> Tensor:
    """Pressure fractions (2, M, B, l) at the ends of the nearest faces."""
    assert faces.slot is not None
    return hulls.fractions(faces.slot, face_normals(hulls.polygons, faces, *point), point, faces.square)


@dataclass(frozen=True)
class _Replay:
    """Squared distances to faces already found, and the strain excess, with gradients."""

    block: Block
    check: Check
    fractions: list[Tensor | None]

    def __call__(self) -> Columns:
        sections = possible_sections(self.block)
        squares = []
        for metric, fraction in zip(self.check.metrics, self.fractions, strict=True):
            assert fraction is not None
            relative = metric == "relative"
            if self.check.polish:
                from torcharm.pieces import follow_kinks

                fraction = follow_kinks(sections, fraction, relative=relative)
            x, y = _scaled(sections.wrench(fraction, relative=relative), self.check)
            squares.append(
                face_square(required_points(self.block, self.check.scale, relative), (x[0], y[0]), (x[1], y[1]))
            )
        return *squares, strain_excess(sections)


def _by_solver(
    block: Block, check: Check, solver: DistanceFunction, recompute: bool
) -> tuple[list[Columns], Tensor, tuple[int, int, int]]:
    """As `_by_closed_form`, through a solver that is given the hulls' vertices, with their gradients."""
    each = 2 if check.auditor is None else 2 + len(COLUMNS)

    def work() -> Columns:
        sections = possible_sections(block)
        columns: list[Tensor] = []
        with torch.no_grad():
            curves = sample_curves(sections, check.samples)
        for metric in check.metrics:
            relative = metric == "relative"
            with torch.no_grad():
                hulls = hulls_of(sections, curves, check, relative)
            found = _solve(sections, hulls, required_points(block, check.scale, relative), check, relative, solver)
            columns += found[:each]
        return *columns, strain_excess(sections)

    *columns, excess = checkpoint(work, use_reentrant=False) if recompute and torch.is_grad_enabled() else work()
    answers = [tuple(columns[start : start + each]) for start in range(0, len(columns), each)]
    return answers, excess, (len(block.twists), block.twists.shape[-2], len(block.arm.radii))


def _solve(
    sections: Sections,
    hulls: Hulls,
    point: tuple[Tensor, Tensor],
    check: Check,
    relative: bool,
    solver: DistanceFunction,
) -> Columns:
    """Distances (B, l) by a solver that takes vertices, and its residuals."""
    with torch.no_grad():
        fraction = corner_fractions(hulls)
    vertices = torch.stack(_scaled(sections.wrench(fraction, relative=relative), check), -1)
    found = solver(torch.stack(point, -1), vertices.unsqueeze(1))
    return found.value, found.converged, *(getattr(found, name) for name in COLUMNS)


def _scaled(wrench: tuple[Tensor, Tensor], check: Check) -> tuple[Tensor, Tensor]:
    return check.scale[0] * wrench[0], check.scale[1] * wrench[1]


def required_points(block: Block, scale: tuple[float, float], relative: bool) -> tuple[Tensor, Tensor]:
    """Required wrenches, scaled, as two tensors (B, l)."""
    metric, designs = "relative" if relative else "absolute", len(block.arm.radii)
    x, y = required_by_metric(block, (metric,), scale)[metric]  # (p, N, l)
    x, y = (value.unsqueeze(2).expand(-1, -1, designs, -1).flatten(0, 2) for value in (x, y))
    return x, y
