"""Lets the API reference show a dataclass's fields, documented by their comments."""

import ast
import io
import tokenize
from functools import cache
from pathlib import Path
from typing import Any

import griffe


@cache
def comments(path: Path) -> dict[int, tuple[str, bool]]:
    """Return line → comment of a file, and whether it stands alone on its line."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text()).readline)
    found = [token for token in tokens if token.type == tokenize.COMMENT]
    return {t.start[0]: (t.string.lstrip("# "), not t.line[: t.start[1]].strip()) for t in found}


def comment_of(path: Path, first: int, last: int) -> str:
    """Return the comment above and beside the lines of a field; "" where there is none."""
    known = comments(path)
    above = first
    while known.get(above - 1, ("", False))[1]:
        above -= 1
    return " ".join(known[line][0] for line in range(above, last + 1) if line in known)


class FieldComments(griffe.Extension):
    """Takes the comment of a class's field for its docstring."""

    def on_attribute_instance(self, *, node: Any, attr: griffe.Attribute, **_: Any) -> None:
        if (
            attr.docstring
            or not isinstance(node, ast.AnnAssign)
            or not isinstance(attr.filepath, Path)
        ):
            return
        if text := comment_of(attr.filepath, node.lineno, node.end_lineno or node.lineno):
            attr.docstring = griffe.Docstring(text, lineno=node.lineno, parent=attr)
