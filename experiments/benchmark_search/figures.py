"""The figures of the benchmark: cost gap against time, and what the metrics rank."""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from scipy.stats import spearmanr

from experiments.benchmark_search.reference import Array

COLOURS = {"antagonistic": "#0072B2", "bellows-only": "#D55E00"}
Points = list[tuple[float, float, str]]


@dataclass
class Pictures:
    """What the parts leave for the figures.

    Attributes:
        multistart: for each arm, (seconds a search, share of tasks not within 1 % of the best,
            starts/rounds).
        scipy: for each arm (seconds a search, median excess cost, starts).
        cost: the search's cost of each task, by arm.
        metric: the metrics' values, by arm and metric.
    """

    multistart: dict[str, Points] = field(default_factory=lambda: defaultdict(list))
    scipy: dict[str, Points] = field(default_factory=lambda: defaultdict(list))
    cost: dict[str, Array] = field(default_factory=dict)
    metric: dict[tuple[str, str], Array] = field(default_factory=dict)

    def save(self, folder: Path) -> list[str]:
        """Draw what has been measured; the names of the files."""
        drawn = []
        if self.multistart and self.scipy:
            self._starts(folder / "starts.png")
            drawn.append("starts.png")
        if self.metric:
            self._ranks(folder / "ranks.png")
            drawn.append("ranks.png")
        return drawn

    def _starts(self, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4.8), layout="constrained", dpi=150)
        axes = figure.subplots()
        markers = dict(zip(COLOURS, "os", strict=True))
        for name, points in self.multistart.items():
            x, y, _ = zip(*points, strict=True)
            axes.plot(
                [1e3 * t for t in x],
                [100 * v for v in y],
                markers[name] + "-",
                color=COLOURS[name],
                label=f"multistart, {name}",
            )
            side = -26 if name == next(iter(COLOURS)) else 6  # each arm's labels stand on their own side
            for index, (t, v, plan) in enumerate(points):
                place = (side, 5 if index % 2 else -11)
                axes.annotate(plan, (1e3 * t, 100 * v), place, textcoords="offset points", fontsize=8)
        for name, points in self.scipy.items():
            if not points:
                continue
            spent = 1e3 * points[0][0]
            axes.axvline(spent, color=COLOURS[name], linestyle="--", label=f"time of scipy SLSQP, 1 start, {name}")
        axes.set_xscale("log")
        axes.set_xticks(ticks := [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000], [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set_xlabel("time a search [ms]")
        axes.set_ylabel("tasks more than 1 % above the best known cost [%]")
        axes.set_title("More starts and rounds find more of the best pressures (labels: starts/rounds)", fontsize=10)
        axes.grid(alpha=0.3)
        figure.legend(loc="outside lower center", ncols=2, fontsize=8)
        figure.savefig(path)

    def _ranks(self, path: Path) -> None:
        from matplotlib.figure import Figure

        metrics = ("absolute", "relative", "absolute + relative")
        figure = Figure(figsize=(10, 6), layout="constrained", dpi=150)
        grid = figure.subplots(len(self.cost), len(metrics), squeeze=False)
        for row, (name, cost) in zip(grid, self.cost.items(), strict=True):
            for axes, metric in zip(row, metrics, strict=True):
                value = self.metric[name, metric]
                axes.plot(value, cost, "o", color=COLOURS[name], markersize=4, alpha=0.7)
                axes.set_yscale("log")
                axes.set_title(f"{name}: rank correlation {spearmanr(value, cost).statistic:.2f}", fontsize=10)
                axes.set_xlabel(f"{metric} unattainability [N]")
                axes.grid(alpha=0.3)
            row[0].set_ylabel("cost of the best pressure [m²]")
        figure.savefig(path)
