"""Rows of results survive their file."""

from dataclasses import dataclass

from hypothesis import given, strategies as st

from experiments.rows import Measurement, measurements_table, read_rows, write_rows


@dataclass(frozen=True)
class Row:
    name: str
    count: int
    value: float
    flag: bool


# csv keeps text as it is, but for a lone carriage return within it, which it reads as the end of a line
texts = st.text(st.characters(exclude_characters="\r\x00", exclude_categories=("Cs",)))
rows = st.builds(Row, texts, st.integers(), st.floats(allow_nan=False), st.booleans())


@given(st.lists(rows, min_size=1, max_size=5))
def test_rows_read_are_those_written(tmp_path_factory, written):
    path = tmp_path_factory.mktemp("rows") / "results.csv"
    write_rows(path, written)
    assert read_rows(path, Row) == written
    assert [file.name for file in path.parent.iterdir()] == ["results.csv"]


def test_a_table_has_a_line_for_each_measurement():
    table = measurements_table([Measurement("part", "case", "time", 12345.678, "ms")], digits=4)
    assert table.title == "part"
    assert [list(column.cells) for column in table.columns] == [["case"], ["time"], ["1.235e+04"], ["ms"]]
