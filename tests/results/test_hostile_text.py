"""Names, notes and devices from strangers stay text in every format of a report."""

import csv
import itertools
import random

import pytest
from markdown_it import MarkdownIt  # comes with rich

from eldenet.results.plots import pareto_plot, pyplot_for_files
from eldenet.results.tables import to_latex, to_markdown
from eldenet.system.escaping import csv_cell, markdown
from eldenet.system.files import write_rows

HOSTILE = [
    r"a & \immediate\write18{touch pwned} ^^5c $x$",
    "first\n\\input{secrets}\r\n% \u2028\\write18{x}",
    "<script>alert(1)</script>",
    "[click](javascript:alert(1)) ![see](http://a/b.png) [r]: http://a",
    "[r]: http://a",
    "# heading",
    "> quoted",
    "~~~ fence",
    "```\n<img src=x>\n```",
    "`a` <b> ``c ` <img src=x> `d",
    r"`a\|<img src=x onerror=alert(1)>`",
    r"\<b> \| \[x](y) &lt;i&gt; **bold**",
    "=cmd|' /C calc'!A0",
    "+1+cmd|' /C calc'!A0",
    "\t=1+1",
    "@SUM(A1)",
    "-2+3",
    "\x1b[2J\u202eabc\ud800",
]
FORBIDDEN = {"html_inline", "html_block", "link_open", "image", "heading_open", "blockquote_open", "fence"}


def tokens(text: str) -> list:
    found = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).parse(text)
    return found + [inner for token in found for inner in token.children or []]


@pytest.mark.parametrize("text", HOSTILE)
def test_a_hostile_name_stays_a_cell_and_a_hostile_note_stays_a_note(text):
    written = to_markdown(["model", "x"], [[text, text], ["b", "c"]], [text, "made by `a command`"])
    kinds = [token.type for token in tokens(written)]
    assert not FORBIDDEN & set(kinds)
    assert kinds.count("td_open") == 4
    assert kinds.count("list_item_open") == 2
    assert kinds.count("code_inline") >= 1  # our own code stays code
    assert not FORBIDDEN & {token.type for token in tokens(f"## {markdown(text)}\n")} - {"heading_open"}

    lines = to_latex(["model", "x"], [[text, text], ["b", "c"]], [text]).split("\n")
    assert len(lines) == 10  # the note, the table and its end, whatever line ends the text has
    assert lines[0].startswith("% ")
    row = lines[5].replace(r"\textbackslash{}", "").replace(r"\textasciicircum{}", "")
    assert not any(command in row for command in (r"\imm", r"\write", r"\input", "^^"))
    written.encode()  # lone surrogates would fail


def test_no_mixture_of_signs_becomes_markup():
    """Random texts of the signs that Markdown reads, which the escapes of one another could free."""
    rng = random.Random(0)
    for _ in range(1500):
        text = "".join(rng.choices(["\\", "`", "``", "<img>", "|", "[a](b)", "*", " ", "a", "&lt;"], k=9))
        kinds = {token.type for token in tokens(to_markdown(["m", "x"], [[text, "1"]], [text]))}
        assert not FORBIDDEN & kinds, text


def test_no_cell_is_a_formula_and_figures_stay_figures(tmp_path):
    figures = ["-", "-0.5", "+1e-3", "-0.014 [-0.017, +0.046] (scenes alone)", "+0.2 [+0.1, +nan] better"]
    write_rows(tmp_path / "table.csv", HOSTILE[:-1], [figures, [-1.5, None]])
    with (tmp_path / "table.csv").open(newline="") as lines:
        header, kept, numbers = list(csv.reader(lines))
    assert not [cell for cell in header if cell.lstrip()[:1] in tuple("=+-@")]
    assert header[12] == "'=cmd|' /C calc'!A0"
    assert kept == figures
    assert numbers == ["-1.5", ""]
    for sign, start in itertools.product("=+-@＝", ("", " ", "\t", "\r")):
        assert csv_cell(f"{start}{sign}cmd()").startswith("'")


def test_dollar_signs_in_a_plot_are_no_formula(tmp_path):
    name = r"$\frac{$ $\undefined$ \write18"
    rows = [(name, 1.0, 0.5), ("b$", 2.0, 0.6)]
    pareto_plot(tmp_path / "a.png", {name: rows}, metric=name, cost=name, lower_is_better=False)
    figure, axes = pyplot_for_files().subplots()
    assert not axes.set_title("$x^2$").get_parse_math()
    pyplot_for_files().close(figure)
