"""Statements of the pages in docs/ about the source hold."""

import itertools
import re
from pathlib import Path

import pytest

from docs.machinery import tables
from giajax.recordings import parse_column

DOCS = Path(__file__).resolve().parents[1] / "docs"


def page(name):
    return (DOCS / name).read_text(encoding="utf-8")


TABLES = {path.name: tables.names(page(path.name)) for path in sorted(DOCS.glob("*.md"))}


@pytest.mark.parametrize("name", [name for name, found in TABLES.items() if found])
def test_the_tables_of_a_page_are_as_the_declarations_make_them(name):
    text = page(name)
    assert tables.written(text) == text, "write them: python -m docs.machinery.tables"


@pytest.mark.quick
def test_every_table_has_its_page():
    assert sorted(itertools.chain(*TABLES.values())) == sorted(tables.TABLES)


@pytest.mark.quick
def test_the_units_of_the_data_contract_are_those_of_columns():
    """These are columns of a channel with any quantity; other tests check time and ratio."""
    rows = re.findall(r"^\| ([a-z ]+) \| ((?:`\w+`(?:, )?)+) \|$", page("data_contract.md"), re.M)
    quantities = {quantity: re.findall(r"`(\w+)`", units) for quantity, units in rows}
    assert len(quantities) == 10
    for quantity, units in quantities.items():
        for unit in units:
            column = f"time_{unit}" if quantity == "time" else f"output_{unit}"
            assert parse_column(column).quantity == quantity.replace(" ", "_")


@pytest.mark.quick
def test_the_glossary_has_each_word_once():
    words = re.findall(r"^\| ([^|]+) \| [^|]+ \|$", page("glossary.md"), re.MULTILINE)
    words = [word for word in words if word not in ("word", "---")]
    assert len(words) > 40
    assert len(words) == len(set(words))
