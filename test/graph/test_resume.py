"""A run that is killed in mid-trial goes on, and ends as it would have without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from graph_harness import PAPER, SHORT, TelProcess, summary_of, wait_until

from tel_ros.recording.run_folder import NETWORK_FILE

Tel = Callable[..., TelProcess]
pytestmark = pytest.mark.timeout(600)

FINISH_S = 180.0


NOISY = (
    *(*SHORT, "sim.position_noise_rad=0.0001", "sim.command_delay_s=0.01"),
    *("learning.gaussians_per_input=5", "learning.weights=least_squares"),
)


def test_a_run_killed_in_mid_trial_goes_on_and_ends_as_without(tel: Tel, ros_domains: Iterator[int]) -> None:
    whole = tel(*NOISY, name="whole")
    code, out, err = whole.finish(FINISH_S)
    assert code == 0, err
    expected = summary_of(out)

    killed = tel(*NOISY, name="killed")
    killed.wait_until_moving(trial=2, timeout_s=FINISH_S)
    killed.kill()
    killed.process.communicate(timeout=10.0)
    wait_until(lambda: killed.left_behind() == [], 15.0, "the end of all nodes")
    assert not (killed.folder / "trial_002").exists()

    resume = ["practice", "--resume", str(killed.folder), "--no-report", "--json"]
    # Others take a process that was killed for a living one for many seconds: hence another domain.
    resumed = TelProcess(resume, killed.folder, {"ROS_DOMAIN_ID": str(next(ros_domains))})
    code, out, err = resumed.finish(FINISH_S)
    assert code == 0, err
    assert "after 1 whole trial" in err
    assert (killed.folder / "set_aside" / "trial_002").is_dir()
    found = summary_of(out)
    for summary in (found, expected):
        del summary["run"]
        for row in summary["trials"]:
            del row["wall_s"]
    assert found == expected
    network = (killed.folder / NETWORK_FILE).read_bytes()
    assert network == (whole.folder / NETWORK_FILE).read_bytes()

    code, out, err = TelProcess(resume, killed.folder, {}).finish(FINISH_S)
    assert (code, out) == (2, "")
    assert "the run is finished: completed, 2 trials" in err


@pytest.mark.parametrize("more", [[str(PAPER)], ["--set", "seed=2"], ["--out", "elsewhere"]], ids=" ".join)
def test_a_run_goes_on_as_it_was_begun(tmp_path: Path, more: list[str]) -> None:
    code, out, err = TelProcess(["practice", "--resume", str(tmp_path), *more], tmp_path, {}).finish()
    assert (code, out) == (2, "")
    assert "given with --resume; expected" in err
