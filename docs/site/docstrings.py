"""Docstrings of the code as Markdown: cross-references in them are written :func:`name`, as Python's tools expect."""

from __future__ import annotations

import re

import griffe

ROLE = re.compile(r":(?:func|class|meth|mod|data|attr):`[~.]*([^`]+)`")


class Roles(griffe.Extension):
    """Turns cross-references into code."""

    def on_instance(self, *, obj: griffe.Object, **_: object) -> None:
        """Called for every module, class, function and attribute that is read."""
        if not obj.is_alias and obj.docstring is not None:
            obj.docstring.value = ROLE.sub(lambda role: f"`{role[1].rpartition('.')[2]}`", obj.docstring.value)
