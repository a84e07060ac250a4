"""Tables of studies come back as they were written, and say what is wrong with them."""

from dataclasses import dataclass
from math import inf, isnan, nan, nextafter
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.base.files import sealed_file
from validation.chapters import read_table, rows_in, write_table


@dataclass(frozen=True)
class Measured:
    """Row of plain fields."""

    name: str
    steps: int
    value: float
    good: bool


ROWS = [
    Measured("a, “b”", 3, nextafter(0.1, 1), True),
    Measured("nan", -1, inf, False),
    Measured("", 0, 5e-324, True),
    Measured("1e3", 10**12, -1.7417412558405728e-05, False),
]


def test_rows_come_back_bit_for_bit(tmp_path: Path) -> None:
    write_table(tmp_path / "new" / "t.csv", Measured, ROWS)
    assert rows_in(read_table(tmp_path / "new" / "t.csv", Measured, "trade"), Measured) == ROWS


def test_what_was_not_measured_is_an_empty_cell(tmp_path: Path) -> None:
    write_table(tmp_path / "t.csv", Measured, [Measured("a", 1, nan, True)])
    assert (tmp_path / "t.csv").read_text() == "name,steps,value,good\na,1,,True\n"
    assert isnan(rows_in(read_table(tmp_path / "t.csv", Measured, "trade"), Measured)[0].value)


def test_a_table_without_rows_keeps_its_columns(tmp_path: Path) -> None:
    write_table(tmp_path / "t.csv", Measured, [])
    assert list(read_table(tmp_path / "t.csv", Measured, "trade").columns) == ["name", "steps", "value", "good"]
    assert rows_in(read_table(tmp_path / "t.csv", Measured, "trade"), Measured) == []


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "damaged file"),
        (b"name,steps,value\na,1,2\n", "no column good"),
        (b"name,steps,value,good\na,1,two,True\n", "could not convert string to float: 'two'"),
        (b"name,steps,value,good\na,,2,True\n", "damaged file"),
        (b"name,steps,value,good\na,1,2,True,5,6\nb,1\n", "damaged file"),
        (b"\xff\xfe\x00", "damaged file"),
    ],
)
def test_a_damaged_table_is_named_with_the_target_that_writes_it(tmp_path: Path, content: bytes, found: str) -> None:
    with sealed_file(tmp_path / "t.csv") as draft:  # by another version
        draft.write_bytes(content)
    with pytest.raises(InputError, match=f"t.csv: .*{found}.*; make trade writes it again$"):
        rows_in(read_table(tmp_path / "t.csv", Measured, "trade"), Measured)


def test_a_missing_table_is_named_with_the_target_that_writes_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"t\.csv: file not found; make trade writes it$"):
        read_table(tmp_path / "t.csv", Measured, "trade")
