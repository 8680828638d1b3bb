"""The options of the fault campaign."""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_kinds import KINDS
from fault_setups import SETUPS


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("fault campaign")
    group.addoption("--faults", type=int, default=0, help="how many to inject; 0: a few, into one graph")
    group.addoption("--serving-faults", type=int, default=0, help="how many to inject into a service")
    group.addoption("--set", nargs="+", default=[], help="keys of the service's configuration, KEY=VALUE")
    group.addoption("--seed", type=int, default=1)
    group.addoption("--jobs", type=int, default=2, help="graphs side by side; each takes about one core")
    group.addoption("--only", nargs="+", choices=sorted(KINDS), default=[], metavar="KIND")
    group.addoption("--setup", nargs="+", choices=sorted(SETUPS), default=[])
    group.addoption("--domain", type=int, default=20, help="first ROS domain; 20 for each job are used")
    group.addoption("--work", type=Path, default=Path("/tmp/tel_faults"), help="for runs and results")
    group.addoption("--stored", action="store_true", help="inject nothing; tell what is stored")
    group.addoption("--keep", action="store_true", help="keep the runs of faults without a violation, too")
    page = "where to write the page; docs/faults.md unless --only or --setup is given"
    group.addoption("--page", type=Path, help=page)
