"""Text from anywhere as plain text in Markdown, LaTeX and CSV: it never becomes markup, code or a formula.

Names, notes and devices of a run or a study may come from strangers. Everything that writes a report passes
its text through these functions.
"""

import re
from itertools import cycle

_CODE = re.compile(r"((?<!`)`(?!`)[^`]+`(?!`))")  # a code span; Markdown reads nothing inside one
_MARKUP = re.compile(r"""[\\<|`]            # escapes, HTML, cells, code
    | &(?=[\w\#]+;)                         # entities
    | (?<=\])[(\[:]                         # links, pictures and their definitions
    | (?<=\S)\*|\*(?=\S)                    # emphasis
    """, re.VERBOSE)  # fmt: skip
_BLOCK = re.compile(r"[#>+~=-]")  # a heading, quotation, list or fence, at the start of a line
_LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "_&%#${}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "δ": r"$\delta$",
        "±": r"$\pm$",
        "↓": r"$\downarrow$",
        "↑": r"$\uparrow$",
        "²": "$^2$",
    }
)
_USER = re.compile(r"(?<=://)(?:[^/\s]*|[^/\s:@]*:(?!\d+/)[^\s@]*)@")  # a password may hold any sign
_SECRET = re.compile(
    r"((?:[?&;#][^=&\s]*(?:pass|pwd|token|key|secret|auth|sig|cred)[^=&\s]*|password|passwd|pwd)=)[^&\s]+",
    re.IGNORECASE,
)
_FORMULA = tuple("=+-@＝＋－＠")
_NUMBER = r"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|nan|inf)"
# what starts like a formula and is none: "-", a number, a difference with its interval
_FIGURE = re.compile(rf"-|{_NUMBER}(?: \[{_NUMBER}, {_NUMBER}\](?: better| worse| \(scenes alone\))?)?")


def one_line(text: str) -> str:
    """Return a text with a space for every line end, control character and invisible sign."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def without_password(text: str) -> str:
    """Return a text without what addresses in it keep secret: ``user:password@`` and ``?token=...``."""
    return _SECRET.sub(r"\g<1>...", _USER.sub("", text))


def markdown(text: str) -> str:
    """Return a text as Markdown shows it, for a heading or a cell."""
    return _MARKUP.sub(r"\\\g<0>", one_line(text).strip())


def markdown_note(text: str) -> str:
    """Return a text as Markdown shows it in a list item; text in backticks is shown as code."""
    parts = _CODE.split(one_line(text).strip())
    shown = "".join(
        part if is_code else _MARKUP.sub(r"\\\g<0>", part)
        for part, is_code in zip(parts, cycle((False, True)))
    )
    return f"\\{shown}" if _BLOCK.match(shown) else shown


def latex(text: str) -> str:
    """Return a text as LaTeX sets it."""
    return one_line(text).translate(_LATEX)


def csv_cell(text: str) -> str:
    """Return a text as a spreadsheet shows it: an apostrophe stands before what would be a formula."""
    is_formula = text.lstrip("".join(map(chr, range(33)))).startswith(_FORMULA)
    return f"'{text}" if is_formula and not _FIGURE.fullmatch(text) else text
