"""Every figure on the main pages is the one that is stored in the file that the page names."""

import importlib.util

import pytest

from tests.support.sources import PAGES, REPOSITORY, problems

PAGE = """Text without figures.

<!-- source: eldenet study study=experiments/table3_rivals
table3_rivals/runs.jsonl.xz: eldenet
table3_rivals/runs.jsonl.xz: meter_xs
-->

| network | δ1 |
|---|---:|
| eldenet | 0.554 ± 0.004 |
| METER-XS | 0.570 |
"""


@pytest.mark.docs
@pytest.mark.parametrize("page", PAGES)
def test_every_figure_has_a_source_and_its_value(page: str) -> None:
    found = problems(page, (REPOSITORY / page).read_text())
    assert not found, "\n".join(found)


def test_a_figure_with_its_stored_value_passes() -> None:
    assert problems("page", PAGE) == []


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ("0.570", "0.571", "0.571 is not in"),
        ("0.004", "0.005", "0.005 is not in"),
        ("| METER-XS | 0.570", "| METER-XS | 0.554", "0.554 is not in"),  # the value of another row
        ("table3_rivals/runs.jsonl.xz: meter_xs\n", "", "1 sources for 2 rows"),
        (": meter_xs", ": meter_xxl", "has no meter_xxl"),
        ("runs.jsonl.xz: meter_xs", "nothing.csv: meter_xs", "no file"),
        ("without figures", "with 92.1 %", "no source"),
    ],
)
def test_other_figures_fail(right: str, wrong: str, said: str) -> None:
    assert any(said in line for line in problems("page", PAGE.replace(right, wrong)))


def test_figures_beside_the_papers_are_those_of_the_stored_results() -> None:
    file = REPOSITORY / "experiments" / "beside_paper.py"
    spec = importlib.util.spec_from_file_location("beside_paper", file)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    written = file.with_suffix(".md").read_text()
    for folder in script.TABLES:
        assert script.page(folder) in written, f"run python {file.relative_to(REPOSITORY)}"
    assert all(line["quote"] for line in script.read_table(file.with_suffix(".csv"), script.HEADER))
