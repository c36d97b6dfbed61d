"""Docstrings as Markdown, for the documentation site: roles become links, ``::`` starts a block of code."""

import re

import griffe

_ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):`~?([\w.]+)`")
_LINK = r'<autoref identifier="\1" optional><code>\1</code></autoref>'


class MarkdownDocstrings(griffe.Extension):
    """What mkdocstrings runs on every object that it reads."""

    def on_object(self, *, obj, **_):
        if obj.docstring:
            text = _ROLE.sub(_LINK, obj.docstring.value)
            obj.docstring.value = re.sub(r"^::$|(?<=:):$", "", text, flags=re.MULTILINE)
