"""Two tests that run at the same time never share a ROS domain."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest
import ros_domain
from ros_domain import DOMAINS, held_domains


def test_a_domain_has_one_owner_until_it_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    with held_domains() as one:
        first, second = next(one), next(one)
    monkeypatch.setattr(ros_domain, "_turn", itertools.cycle([first, second]))
    with held_domains() as one:
        assert {first, second} <= set(DOMAINS)
        taken = next(one)
        with held_domains() as other:
            assert next(other) == ({first, second} - {taken}).pop()
        again = "import itertools, ros_domain\n"
        again += f"ros_domain._turn = itertools.cycle([{taken}, {first}, {second}])\n"
        again += "with ros_domain.held_domains() as domains: print(next(domains))"
        found = subprocess.check_output([sys.executable, "-c", again], cwd=Path(__file__).parent, text=True)
        assert int(found) == ({first, second} - {taken}).pop()
    with held_domains() as one:
        assert {next(one), next(one)} == {first, second}
