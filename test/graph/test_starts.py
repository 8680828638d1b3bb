"""The first second of a graph in real time, in which every connection is made.

    python -m pytest test/graph/test_starts.py --starts 200

starts so many graphs on a machine that does nothing else, and prints the longest stall of each.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from graph_harness import Graph
from tel_interfaces.msg import TrialResult
from tel_process import COARSE, PAPER, PRIORITY

from tel_ros.recording.config_file import load_config

STALL_S = 0.02


@pytest.mark.realtime
@pytest.mark.timeout(0)
def test_no_loop_stalls_when_it_begins(tmp_path: Path, domain: int, pytestconfig: pytest.Config) -> None:
    config = load_config(PAPER, (*COARSE, *PRIORITY, "sim.clock=realtime"))
    longest_s, aborts = [], []
    for k in range(pytestconfig.getoption("--starts", default=1)):
        with Graph(config, tmp_path / f"{k}", ["sim_bridge", "ep_controller"], domain) as running:
            running.wait_for_controller()
            result = running.result(running.send(running.goal(2.5)))
            for pid in running.processes.pids.values():
                assert "/dev/shm/fastrtps" not in Path(f"/proc/{pid}/maps").read_text()
        aborts += [] if result.outcome == TrialResult.COMPLETED else [result.message]
        longest_s.append(max(result.jitter_max_s, result.response_max_s))
        print(f"start {k + 1}: {1e3 * longest_s[-1]:.1f} ms {result.message}", flush=True)
    assert max(longest_s) < STALL_S, f"{sum(s > STALL_S for s in longest_s)} of {len(longest_s)} stalled"
    assert aborts == []
