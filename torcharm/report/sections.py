"""The report's sections, in order: each from what was evaluated, or None where there is nothing to show.

Another one is a function of the same kind in `SECTIONS`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from torcharm.report.built import built_panel, built_table, workspace_panels
from torcharm.report.content import Block, Evaluated, Panel, Section
from torcharm.report.designs import design_csv, design_table
from torcharm.report.figures import arm_panels, error_panels, hull_panels
from torcharm.report.load_maps import load_map_panels
from torcharm.study import Study, StudyResult, csv_text, result_rows, summarise, words
from torcharm.study.advice import advice
from torcharm.study.built import built_rows

Panels = Callable[[Sequence[StudyResult], Evaluated], Iterable[Panel]]


def with_margins(study: Study) -> Study:
    """The study with capacity margins, where how it measures sets has them: they cost next to nothing."""
    how = study.settings
    sets = how.hull == "exact" and how.distance == "gjk" and "absolute" in how.metrics
    return replace(study, settings=replace(how, signed=True)) if sets else study


def designs(evaluated: Evaluated) -> Section | None:
    """One row a design over all of its tasks, and on each task where there are several."""
    rows = [own for arm in evaluated.study.arms if (own := evaluated.of_arm(arm))]
    blocks = [Block(table=design_table(rows))]
    if len(evaluated.tasks) > 1:
        blocks[0] = replace(blocks[0], title="All tasks")
        for task in evaluated.tasks:
            single = design_table([[result] for result in evaluated.of_task(task)], sizes=False)
            blocks.append(Block(title=task.name, table=single))
    blocks.append(Block(points=[("", said) for said in _legend(evaluated)]))
    return Section("Designs", blocks, csv=design_csv(rows))


def _legend(evaluated: Evaluated) -> Iterator[str]:
    """What the columns mean, as far as they are there."""
    settings = evaluated.study.settings
    if evaluated.predicted:
        yield from words.verdict_legend(settings, evaluated.results)
        yield "tip off, turned, shape off: errors of the predicted equilibrium, over the loads."
    else:
        yield words.NOT_EXCLUDED
    if any(summarise(result).worst_node is not None for result in evaluated.results):
        yield words.worst_node_legend(settings)
    if evaluated.results[0].attainability.capacity_margin is not None:
        yield "least margin: from what loads require of nodes to the boundary of what pressures give; above 0 inside."
        if any(map(_held_outside, evaluated.results)):
            yield f"{words.HELD_OUTSIDE}."
    yield words.weighing_legend(settings)
    if any("change from the base" in reason for result in evaluated.results for reason in result.reasons):
        yield f"{words.CHANGE}."


def _held_outside(result: StudyResult) -> bool:
    """Whether a load is held whose margin is below 0."""
    found = result.attainability
    assert found.capacity_margin is not None
    margins = found.capacity_margin.ravel().tolist()
    return any(word == "held" and margin < 0 for word, margin in zip(result.verdicts or (), margins, strict=False))


def next_steps(evaluated: Evaluated) -> Section | None:
    """What to try with each design."""
    blocks = []
    for arm in evaluated.study.arms:
        found = evaluated.of_arm(arm)
        points = [(result.task.name * (len(found) > 1), said) for result in found for said in advice(result)]
        blocks += [Block(title=arm.name, points=points)] if points else []
    commands = list(words.next_commands(evaluated.source, evaluated.results))
    blocks += [Block(title="All designs", commands=commands)] if commands else []
    return Section("What to try next", blocks) if blocks else None


ARMS = (
    "The task's centreline is solid, the one reached dashed. Of several loads, the one whose errors, over their "
    "tolerances, are the median of that design's."
)
ERRORS = (
    "Under how many loads the tip is predicted to be how far off. Faint bars: it is near enough, but turned too "
    "far, or the shape is too far off. Bars not filled: figures not to be relied on."
)
MAPS = (
    "How far off each design is at the task's shape under tip forces without a moment: within the line all "
    "errors are within the tolerance."
)
MAPS_OF_SETS = "Which tip forces, without a moment, each design bears at the task's shape, as far as sets can tell."
MARKS = " Marks are the study's own loads; they may have moments and, in space, a third force, which maps have not."
HULLS = (
    "What pressures can provide at the node that lacks most on average, or is nearest to it, and what the loads "
    "require there. In space seen along each axis: a point within all outlines may still be outside."
)


def drawn(
    evaluated: Evaluated, title: str, predicted: str, panels: Panels, in_space: int = 3, sets: str = ""
) -> Section | None:
    """A section of figures, task by task; of tasks in space so many beside each other.

    Its text is one of two, as errors were predicted or sets alone measured.
    """
    blocks = [
        Block(title=task.name, panels=own, columns=in_space if task.task.dimension == 3 else 3)
        for task in evaluated.tasks
        if (own := list(panels(evaluated.of_task(task), evaluated)))
    ]
    return Section(title, blocks, predicted if evaluated.predicted else sets or predicted) if blocks else None


def built(evaluated: Evaluated) -> Section | None:
    """Designs as they are built: percentiles, yields, and what decides them."""
    if not evaluated.built:
        return None
    how = evaluated.built[0].built
    pressures = "found anew for each built arm" if how.compensated else "those that are best for the drawn arm"
    text = (
        f"Tip errors of {len(how.tip_error)} arms built within the study's tolerances, at pressures that are "
        f"{pressures}. Yields are shares within the tolerance of the task, in brackets with 95 % confidence. "
        "Loading from rest leads there, the drawn arm too: where that is not the shape predicted above, figures differ."
    )
    blocks = [
        Block(title=task.name, table=built_table(own), panels=[built_panel(own, evaluated)], columns=1)
        for task in evaluated.tasks
        if (own := [one for one in evaluated.built if one.task is task])
    ]
    return Section("As built", blocks, text, csv_text(list(built_rows(evaluated.built))))


def reach(evaluated: Evaluated) -> Section | None:
    """Where designs can reach."""
    if not evaluated.workspaces:
        return None
    text = (
        "Where tips can be over all pressures, under the arms' own weight: within the black line by stable shapes that "
        "loading from rest leads to; within the dashed one only if force models may be extrapolated."
    )
    return Section("Workspace", [Block(panels=list(workspace_panels(evaluated)), columns=1)], text)


def loads(evaluated: Evaluated) -> Section | None:
    """All numbers, load by load."""
    rows = [row for result in evaluated.results for row in result_rows(result)]
    text = f"One row for each design, task and load, {len(rows)} in all, with the columns of torcharm evaluate --out."
    return Section("Every load", (), text, csv_text(rows))


SECTIONS: tuple[Callable[[Evaluated], Section | None], ...] = (
    designs,
    next_steps,
    partial(
        drawn,
        title="Arms",
        predicted=ARMS,
        sets="Each design at the task's shape, with all of its loads.",
        panels=arm_panels,
        in_space=2,
    ),
    partial(drawn, title="Tip errors", predicted=ERRORS, panels=error_panels),
    partial(drawn, title="Load maps", predicted=MAPS + MARKS, sets=MAPS_OF_SETS + MARKS, panels=load_map_panels),
    partial(drawn, title="Attainable wrenches at the worst node", predicted=HULLS, panels=hull_panels, in_space=1),
    built,
    reach,
    loads,
)
