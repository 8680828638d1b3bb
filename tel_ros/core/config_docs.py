"""What the records of a configuration say about their fields: the one place where a value is explained."""

from __future__ import annotations

import ast
import inspect
from functools import cache


@cache
def field_docs(record: type) -> dict[str, str]:
    """Return the text below each field of a record, on one line, by the name of the field.

    Args:
        record: a dataclass whose source is at hand, e.g. :class:`~tel_ros.core.config.ControlConfig`.
    """
    body = ast.parse(inspect.getsource(record)).body[0].body  # type: ignore[attr-defined]
    docs = {}
    for field, text in zip(body, body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            docs[ast.unparse(field.target)] = " ".join(str(ast.literal_eval(text.value)).split())
    return docs
