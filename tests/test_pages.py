"""What the pages of docs/ say of the source is so, and what they show runs."""

import re
from pathlib import Path

import pytest

from giajax.kinds import KINDS
from giajax.runs import parse_column

DOCS = Path(__file__).resolve().parents[1] / "docs"


def page(name):
    return (DOCS / name).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("physics.md", marks=pytest.mark.slow),
        pytest.param("hold_out.md", marks=pytest.mark.slow),
        pytest.param("long_fits.md", marks=pytest.mark.slow),
    ],
)
def test_the_python_of_a_page_runs(name):
    blocks = re.findall(r"```python\n(.*?)```", page(name), re.DOTALL)
    assert blocks
    for block in blocks:
        assert "assert" in block
        exec(compile(block, name, "exec"), {})


def channel_rows():
    """A row for each channel that means the same to some kinds of models."""
    kinds = {}
    for kind in KINDS.values():
        for row in kind.channels:
            texts = " or ".join(f"`{text}`" for text in row.texts)
            values = texts or (row.quantity or "any").replace("_", " ")
            kinds.setdefault((row.column, row.part, values), []).append(kind.name)
    for (column, part, values), names in kinds.items():
        yield f"| `{column}` | {', '.join(names)} | {part} | {values} |"


@pytest.mark.quick
def test_the_channels_of_the_data_contract_are_those_of_the_kinds():
    table = "\n".join(channel_rows())
    assert table in page("data_contract.md"), f"the table must read\n{table}"


def key_rows():
    """A row for each key that states a parameter."""
    for kind in KINDS.values():
        for name, section in {**kind.sections, **kind.run_sections}.items():
            for key, parts in section.quantities.items():
                paths = ", ".join(f"`{path}`" for path in dict.fromkeys(p.path for p in parts))
                field = section.model_fields[key]
                preset = field.json_schema_extra["preset"]
                value = "left out" if preset is None else f"`{preset}`"
                yield f"| `{name}.{key}` | {paths} | {value} | {field.description} |"


@pytest.mark.quick
def test_the_keys_of_the_data_contract_are_those_of_the_declarations():
    table = "\n".join(key_rows())
    assert table in page("data_contract.md"), f"the table must read\n{table}"


@pytest.mark.quick
def test_the_units_of_the_data_contract_are_those_of_columns():
    """As columns of a channel that takes any quantity; time and ratio are told by other tests."""
    rows = re.findall(r"^\| ([a-z ]+) \| ((?:`\w+`(?:, )?)+) \|$", page("data_contract.md"), re.M)
    quantities = {quantity: re.findall(r"`(\w+)`", units) for quantity, units in rows}
    assert len(quantities) == 8
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
