"""Lets the tests import the helper modules beside them and the faulty arm of the contract tests."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
