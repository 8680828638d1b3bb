"""What mkdocs asks while it builds the site: the pages that are made from the code."""

import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

import site_reference  # noqa: E402 - found by the line above


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "reference/configuration.md": site_reference.configuration_page(),
        "reference/interfaces.md": site_reference.interfaces_page(ROOT),
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files
