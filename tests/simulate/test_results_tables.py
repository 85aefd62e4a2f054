"""Tables: one value, two notations."""

from __future__ import annotations

import json

import pytest

from terrafuse.simulate.mission.tables import Table, from_json, html, markdown, moments, shown

TABLE = Table(
    "Time to map <all>",
    ("robots", "seconds", "paper"),
    (("one", 445.25, 445), ("a|b", None, 310), ("many", 12345.6, 1_000_000)),
    "Simulated seconds & the paper's.",
)


def test_markdown() -> None:
    assert markdown(TABLE) == (
        "### Time to map <all>\n"
        "\n"
        "| robots | seconds | paper |\n"
        "| --- | ---: | ---: |\n"
        "| one | 445.2 | 445 |\n"  # four digits; 445.25 is a tie, which goes to the even 2
        "| a\\|b | – | 310 |\n"
        "| many | 12,346 | 1,000,000 |\n"
        "\n"
        "Simulated seconds & the paper's.\n"
    )


def test_html_escapes_everything_and_sets_numbers_right() -> None:
    text = html(TABLE)
    assert "<h2>Time to map &lt;all&gt;</h2>" in text
    assert '<th scope="row">one</th><td class="number">445.2</td><td class="number">445</td>' in text
    assert "Simulated seconds &amp; the paper&#x27;s." in text


def test_a_row_may_be_named_by_a_number() -> None:
    text = html(Table("As it grows", ("s", "what"), ((30, "x"), (None, "y"))))
    assert '<th scope="row" class="number">30</th><td>x</td>' in text
    assert '<th scope="row" class="number">–</th>' in text
    assert "Number" not in text


def test_no_rows_no_section() -> None:
    empty = Table("Empty", ("a", "b"), ())
    assert html(empty) == markdown(empty) == ""


def test_json_and_back() -> None:
    assert from_json(json.loads(json.dumps(TABLE.as_json()))) == TABLE


def test_rows_have_as_many_cells_as_there_are_headings() -> None:
    with pytest.raises(ValueError, match="2 cells"):
        Table("Short", ("a", "b", "c"), (("x", 1),))


@pytest.mark.parametrize(
    ("cell", "text"),
    [(0.123456, "0.1235"), (1e-7, "1e-07"), (99999.5, "100,000"), (-3, "-3"), (0.0, "0"), (9999.9, "10,000")],
)
def test_four_digits(cell: float, text: str) -> None:
    assert shown(cell) == text


def test_some_moments_are_spread_evenly_with_the_first_and_the_last() -> None:
    assert moments([], 3) == []
    assert moments([5], 3) == [5]
    assert moments([*range(7)], 3) == [0, 3, 6]
    assert moments([*range(3)], 12) == [0, 1, 2]
