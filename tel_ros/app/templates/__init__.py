"""Templates of pages and of layouts, and what renders them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import jinja2


@cache
def _environment(folder: Path) -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def template(name: str, folder: Path = Path(__file__).parent) -> jinja2.Template:
    """Return a template from a folder, by default from this one."""
    return _environment(folder).get_template(name)
