"""Tables that cut nothing and break no word: columns that do not fit beside each other go into another one below."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torcharm.cli.terminal import open_console

if TYPE_CHECKING:
    from rich.console import Console

GAP = 3
"""Between two columns."""
LONGEST_WORD = 24
"""Longer ones are broken after all: they are names, and would leave no room for numbers."""


@dataclass(frozen=True)
class Column:
    """Of a table; lines of a title and of cells are never broken where they hold numbers.

    Attributes:
        title, cells: of one line or several; a cell for each row.
        widest: of texts, over which width they go on in another line; 0: these are numbers.
        whole: whether lines of cells of texts are not broken either.
    """

    title: str
    cells: Sequence[str]
    widest: int = 0
    whole: bool = False

    def widths(self) -> tuple[int, int]:
        """The least width, and the one beyond which none is of use."""
        from rich.cells import cell_len

        lines = [line for cell in (self.title, *self.cells) for line in cell.splitlines()]
        longest = max(map(cell_len, lines), default=0)
        if not self.widest or self.whole:
            return longest, longest
        words = max((cell_len(word) for line in lines for word in line.split()), default=0)
        return min(words, LONGEST_WORD), min(longest, max(self.widest, words))


def print_table(columns: Sequence[Column], lead: int = 1) -> None:
    """One table, or several below each other, each as wide as the terminal at most and with the leading columns."""
    console, leading, others = open_console(), columns[:lead], list(columns[lead:])
    while others:
        free, shown = console.width - _taken(leading), 0
        while shown < len(others) and (free := free - GAP - others[shown].widths()[0]) >= 0:
            shown += 1
        _print_one(console, [*leading, *others[: max(1, shown)]])
        others = others[max(1, shown) :]
        if others:
            console.print()


def _taken(columns: Sequence[Column]) -> int:
    """The least width of columns beside each other."""
    return sum(column.widths()[0] for column in columns) + GAP * (len(columns) - 1)


def _print_one(console: "Console", columns: Sequence[Column]) -> None:
    from rich import box
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    def cells(texts: Iterable[str]) -> list[Padding]:
        """Each holds the gap before it itself: rich before 14.3 takes columns for wider by the table's own padding."""
        return [Padding(Text(text), (0, 0, 0, (GAP - 1) * (index > 0))) for index, text in enumerate(texts)]

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=0)
    free, widths = console.width - _taken(columns), list[int]()
    for column in reversed(columns):  # names, which stand first, may well go on in another line
        least, most = column.widths()
        widths.insert(0, least + max(0, min(free, most - least)))
        free -= widths[0] - least
    for column, width, title in zip(columns, widths, cells(column.title for column in columns), strict=True):
        justify = "left" if column.widest else "right"
        table.add_column(title, width=width + title.left, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for row in zip(*(column.cells for column in columns), strict=True):
        table.add_row(*cells(row))
    console.print(table)
