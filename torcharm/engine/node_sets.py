"""Distances of required wrenches from attainable sets, for batches of designs, shapes, nodes and loads."""

from functools import cache
from typing import Any, NamedTuple

from jaxtyping import Float64

from torcharm.engine.arrays import Array, make
from torcharm.engine.compilation import kernel, part
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.curves import (
    Curves,
    Samples,
    copy_curve,
    make_curves,
    most_pieces,
    write_curve,
    write_difference,
)
from torcharm.engine.depth import Polytope, signed_distance_part, sizes_of_set
from torcharm.engine.distance import GAP, curve_support, nearest_part
from torcharm.engine.forces import Models
from torcharm.engine.reach import sides
from torcharm.engine.references import by_reference
from torcharm.engine.sharpen import BEYOND, sharpen_part
from torcharm.engine.simplex import Simplex


@by_reference
class Sections(NamedTuple):
    """The actuators at the cross-sections of B designs on P shapes of N nodes."""

    limit: Float64[Array, "B M"]  # of pressures [kPa]
    strain: Float64[Array, "B P N M"]
    lever: Float64[Array, "B M D"]  # the wrench of a force of 1 N
    bending: Float64[Array, "B P N M D-1"]  # the moments of a pressure of 1 kPa
    constant: Float64[Array, "B P N D"]  # the wrench that no pressure changes
    samples: Samples  # curves of the models that the engine does not know


@by_reference
class Scratch(NamedTuple):
    """Scratch to work in, for one thread."""

    own: Curves  # of a node
    first: Curves  # of the first node
    change: Curves  # their difference
    simplex: Simplex
    polytope: Polytope
    middle: Float64[Array, "D"]  # of the set
    start: Float64[Array, "L D"]  # the last node's normals, to begin the next node's with


@by_reference
class Answers(NamedTuple):
    """What is found, for B designs, P shapes, L loads and N nodes."""

    distance: Float64[Array, "B P L N"]  # negative inside if that was asked for
    gap: Float64[Array, "B P L N"]  # by how much of the problem's size it may be too long
    normal: Float64[Array, "B P L N D"]  # unit normals; empty if not asked for, like what follows
    weight: Float64[Array, "B P L N D"]  # of the points whose mix is nearest
    pressure: Float64[Array, "B P L N D M"]  # of these points [kPa]
    size: Float64[Array, "B P L N"]  # of the problem, the most that the numbers in it can add up to


def make_scratch(models: Models, dimension: int, loads: int, samples: Samples) -> Scratch:
    """Scratch for sets of wrenches of so many components."""
    pieces, sizes = most_pieces(samples), sizes_of_set(len(models.kind), dimension)
    own, first = (make_curves(models, dimension, pieces) for _ in range(2))
    change = make_curves(models, dimension, 2 * pieces, terms=2)
    return make(Scratch, sizes | {"L": loads}, own=own, first=first, change=change)


@part
def write_node(sections, scratch, b, h, i, relative):  # type: ignore[no-untyped-def]
    """Write the curves of node i of shape h of design b, less those of the first node if `relative`."""
    own = scratch.own
    number = (b * sections.strain.shape[1] + h) * sections.strain.shape[2] + i
    for a in range(len(own.pieces)):
        copy_row(own.bending[a], sections.bending[b, h, i, a])
        copy_row(own.lever[a], sections.lever[b, a])
        write_curve(own, a, sections.strain[b, h, i, a], sections.limit[b, a], sections.samples, number, not relative)
        if relative:
            if i == 0:
                copy_curve(scratch.first, a, own)
            write_difference(scratch.change, a, own, scratch.first)
            scratch.change.side[a] = sides(scratch.change, a)
        else:
            own.side[a] = sides(own, a)


@part
def measure(curves, middle):  # type: ignore[no-untyped-def]
    """Write the middle of the sum of the curves' ends; returns the most that their numbers can add up to."""
    extent = 0.0
    for c in range(len(middle)):
        middle[c] = 0.0
    for a in range(len(curves.pieces)):
        last, most = curves.pieces[a], 0.0
        for k in range(last):
            for j in range(4):
                most = max(most, abs(curves.control[a, k, j]))
        centre, p = 0.5 * (curves.control[a, 0, 0] + curves.control[a, last - 1, 3]), curves.edge[a, last]
        for c in range(len(middle)):
            middle[c] += centre * curves.lever[a, c]
            extent += most * abs(curves.lever[a, c])
            if c > 0:
                middle[c] += 0.5 * p * curves.bending[a, c - 1]
                extent += p * abs(curves.bending[a, c - 1])
    return extent


@part
def aim(sections, required, scratch, b, h, l, i, relative):  # type: ignore[no-untyped-def]
    """Write the wrench asked of a node, less what no pressure changes; returns the sum of its components' sizes."""
    target, size = scratch.simplex.target, 0.0
    for c in range(len(target)):
        target[c] = required[b, h, l, i, c] - sections.constant[b, h, i, c]
        if relative:
            target[c] -= required[b, h, l, 0, c] - sections.constant[b, h, 0, c]
        size += abs(target[c])
    return size


@part
def keep_answer(answers, simplex, at):  # type: ignore[no-untyped-def]
    """Write the normal, the weights and the pressures of an answer, if they are asked for."""
    b, h, l, i = at
    if len(answers.normal) > 0:
        copy_row(answers.normal[b, h, l, i], simplex.normal)
        copy_row(answers.weight[b, h, l, i], simplex.weight)
        copy_rows(answers.pressure[b, h, l, i], simplex.pressure)


@cache
def distance_kernel(dimension: int, signed: bool = False) -> Any:
    """The kernel for wrenches of so many components, which measures from the outside or, signed, from both sides."""
    ask = curve_support(dimension)
    nearest = nearest_part(dimension, ask)
    sharpen = sharpen_part(dimension)
    signed_distance = signed_distance_part(dimension, ask, sharpen)

    @part
    def measure_again(curves, simplex, distance, gap, size):  # type: ignore[no-untyped-def]
        """The distance along a sharper normal, and the gap that is left."""
        ahead, low = 0.0, 0.0
        for c in range(dimension):
            for k in range(dimension):
                ahead -= simplex.weight[k] * simplex.corner[k, c] * simplex.normal[c]
        if gap > GAP * size:
            ask(curves, simplex)
            for c in range(dimension):
                low -= simplex.normal[c] * simplex.point[c]
            gap = min(gap, max(ahead - low, 0.0))
        return (ahead, gap) if abs(ahead - distance) <= gap + GAP * size else (distance, gap)

    @kernel
    def distances(sections, required, relative, begin, end, scratch, answers):  # type: ignore[no-untyped-def]
        """Of designs from `begin` to `end`; required wrenches (B, P, L, N, D)."""
        curves = scratch.change if relative else scratch.own
        simplex = scratch.simplex
        for b in range(begin, end):
            for h in range(required.shape[1]):
                for l in range(required.shape[2]):
                    for c in range(dimension):
                        scratch.start[l, c] = 0.0
                for i in range(required.shape[3]):
                    write_node(sections, scratch, b, h, i, relative)
                    extent = measure(curves, scratch.middle)
                    for l in range(required.shape[2]):
                        size = extent + aim(sections, required, scratch, b, h, l, i, relative)
                        begin_with(scratch, l)
                        if signed:
                            distance, gap = signed_distance(curves, simplex, scratch.polytope, size)
                        else:
                            distance, gap, _ = nearest(curves, simplex, size)
                            if distance > 0.0 and (len(answers.normal) > 0 or gap > GAP * size):
                                sharpen(curves, simplex, BEYOND * max(gap, GAP * size) / distance)
                                distance, gap = measure_again(curves, simplex, distance, gap, size)
                        if distance != 0.0:
                            copy_row(scratch.start[l], simplex.normal)
                        answers.distance[b, h, l, i] = distance
                        answers.gap[b, h, l, i] = gap / size if size > 0.0 else gap
                        keep_answer(answers, simplex, (b, h, l, i))
                        if len(answers.size) > 0:
                            answers.size[b, h, l, i] = size

    return distances


@part
def begin_with(scratch, l):  # type: ignore[no-untyped-def]
    """Write a direction to begin with: the last node's normal, or else that from the set's middle."""
    known, simplex = False, scratch.simplex
    for c in range(len(simplex.normal)):
        known = known or scratch.start[l, c] != 0.0
    for c in range(len(simplex.normal)):
        simplex.normal[c] = scratch.start[l, c] if known else simplex.target[c] - scratch.middle[c]
