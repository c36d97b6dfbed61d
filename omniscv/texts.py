"""Texts that others wrote, made safe to print: no control characters, one line, a bounded length."""

import re

LONGEST_LINE = 300
"""Characters of an error, at most."""


def printable(text: object) -> str:
    """Return text with every character that is not printable as its escape.

    Control characters, terminal sequences, line ends, marks that reverse or hide text (bidirectional,
    zero-width), and bytes that are no UTF-8 (surrogates) become what Python writes for them.
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in shown)


_FOLDERS = re.compile(r"(?<![\w.:/])/(?:[^/\s:]+/){2,}")


def one_line(text: object, longest: int = LONGEST_LINE) -> str:
    """Return text in one printable line; of a longer one, folders of paths are left out, then its middle."""
    line = printable(" ".join(str(text).split()))
    if len(line) > longest:
        line = _FOLDERS.sub(".../", line)
    if len(line) <= longest:
        return line
    head = 2 * longest // 3
    return f"{line[:head]} ... {line[head + 5 - longest :]}"
