"""Nothing is credited to the paper that its prose does not say."""

import importlib.util
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path
    for pattern in (
        "*.md",
        "docs/*.md",
        "docs/notebooks/*.ipynb",
        "experiments/**/*.md",
        "experiments/**/*.py",
        "experiments/**/*.yaml",
        "eldenet/**/*.py",
        "eldenet/**/*.md",
        "configs/**/*.yaml",
        "ros2/**/*.md",
        "ros2/**/*.py",
        "web/*.md",
    )
    for path in REPOSITORY.glob(pattern)
)

#: Every number of the paper's prose that a page may credit to it.
NUMBERS = {
    *("0.04", "4.2", "3.9", "4.6", "15", "51", "2.2", "1.42", "1.28", "2.1", "92.61", "65"),  # tables 1 and 4
    *("5", "20", "40", "80", "400"),  # obstacles, square meters; also KITTI's 400 images
    *("0.001", "0.9", "32"),  # training
    *("43,000", "7,560", "7560", "304", "228", "640", "480"),  # NYU
    *("2,000", "2000", "500", "1216", "352", "912"),  # KITTI
    *("5,000", "128", "256", "1024", "2048", "19"),  # Cityscapes
    *("112", "56", "28", "7", "3", "2"),  # sizes of maps, kernels
    *("1.25", "1.25²", "1.25³"),
    *("60", "50", "24", "90"),  # the robot
    *("18", "152", "9"),  # ResNet18, ResNet152, YOLOv9
}

#: What was credited to the paper without standing in its prose.
WRONG = (
    r"Algorithm 2 as written",
    r"the paper's 3 m",
    r"the paper's (speed )?law",
    r"\beqs?\. [45]\b.*(ELDE-Net|the paper)|(ELDE-Net|paper)[^.]*\beqs?\. ?[45]",
    r"the paper gives (the terms|no numbers)",
    r"equations? 1( to 3)? literally",
    r"last command[^.]{0,40}(of|as|in) the paper's state",
)


@pytest.mark.parametrize("wrong", WRONG)
def test_no_wrong_credit_comes_back(wrong: str) -> None:
    found = [
        f"{page.relative_to(REPOSITORY)}: {match[0]}"
        for page in PAGES
        if (match := re.search(wrong, page.read_text(), re.I))
    ]
    assert found == []


def claims(text: str) -> list[str]:
    """What a page puts into the paper's mouth."""
    text = re.sub(r"\s*\n[#\s]*", " ", text)
    credited = re.findall(
        r"[Tt]he (?:ELDE-Net )?paper(?:'s (?:text|prose))? (?:says|reports|gives|states|has|describes)"
        r"([^.;|]*(?:\.\d[^.;|]*)*)",
        text,
    )
    return credited + re.findall(r"[Tt]he paper's (?:own )?((?:[\w-]+ ){0,3}\d[\d.,]*)", text)


def numbers(text: str) -> set[str]:
    text = re.sub(r"[`\[(][^`\])]*[`\])]", " ", text)  # names, links, remarks
    text = re.sub(
        r"\b(?:[Tt]ables?|[Ff]ig(?:ure|\.)|[Aa]lgorithm|[Ee]quations?|[Ss]ections?|[Gg]oal) [\d., and]*\d",
        " ",
        text,
    )
    found = re.findall(r"(?<![\w.])\d[\d.,]*[²³]?", text)
    return {number.rstrip(".,") for number in found}


def test_the_papers_numbers_are_its_own() -> None:
    for page in PAGES:
        for claim in claims(page.read_text()):
            assert numbers(claim) <= NUMBERS, f"{page.relative_to(REPOSITORY)}: {claim}"


def test_the_page_quotes_the_papers_numbers_alone() -> None:
    page = (REPOSITORY / "docs" / "paper.md").read_text()
    quotes = [
        quote
        for line in page.splitlines()
        if line.startswith("|")
        for quote in re.findall(r'"([^"]*)"', line)
    ]
    assert len(quotes) > 40
    for quote in quotes:
        assert numbers(quote) <= NUMBERS, quote
    assert all(f"| {status}" in page for status in ("as read", "our choice", "differs", "not possible here"))


def test_figures_beside_the_papers_are_those_of_the_stored_results() -> None:
    file = REPOSITORY / "experiments" / "beside_paper.py"
    spec = importlib.util.spec_from_file_location("beside_paper", file)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    written = file.with_suffix(".md").read_text()
    for folder in script.TABLES:
        assert script.page(folder) in written, f"run python {file.relative_to(REPOSITORY)}"
    for line in script.read_table(file.with_suffix(".csv"), script.HEADER):
        assert numbers(line["paper"].replace("-", " ")) <= NUMBERS
        assert line["quote"]
