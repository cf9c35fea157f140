"""How far off the arms are before and after, by either objective."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

STYLES = {
    "unattainability": ("#D55E00", "//", "best by unattainability"),
    "predicted_error": ("#0072B2", "", "best by predicted error (default)"),
}


def draw(scenes: Sequence[Any], path: Path) -> None:
    """A panel an arm; bars of the searched mean shape error, given and after either objective."""
    arms = list(dict.fromkeys(scene.arm for scene in scenes))
    figure, axes = plt.subplots(1, len(arms), figsize=(4.2 * len(arms), 4), layout="constrained", squeeze=False)
    for axis, arm in zip(axes[0], arms, strict=True):
        own = [scene for scene in scenes if scene.arm == arm]
        shapes = list(dict.fromkeys(scene.shape for scene in own))
        by = {(scene.shape, scene.objective): scene for scene in own}
        for place, shape in enumerate(shapes):
            first = by[shape, "predicted_error"]
            axis.bar(place - 0.27, first.given, 0.25, color="0.75", label=None if place else "given")
            for index, (metric, (colour, hatch, label)) in enumerate(STYLES.items()):
                height, shown = by[shape, metric].best, None if place else label
                at = place + 0.27 * index
                axis.bar(at, height, 0.25, color=colour, hatch=hatch, edgecolor="white", label=shown)
        axis.set(
            title=f"{arm} arm",
            xticks=range(len(shapes)),
            xticklabels=shapes,
            xlabel="shape (slope, start) of curvature [rad]",
        )
    axes[0][0].set_ylabel("mean shape error that the search reaches [mm]")
    axes[0][0].legend(frameon=False)
    axes[0][0].margins(y=0.35)  # room for the legend above the bars
    figure.suptitle("Optimised by the predicted error, every arm comes nearer to every shape")
    figure.savefig(path, dpi=130)
    plt.close(figure)
