"""Telling whether the motors exert what they are commanded."""

from __future__ import annotations

from collections.abc import Sequence

from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.types import NS_PER_S, FloatArray

STRONG_SHARE = 0.1
"""A command is strong from this share of the effort limit on; weaker ones drown in friction and noise."""
ANSWER_SHARE = 0.5
"""A motor has answered a command if it reports at least this share of it."""
WEAK_SHARE = 0.02
"""A motor that was found dead is believed to live again from this share of the effort limit on."""
PATIENCE_S = 0.08
"""For how long a strong command may go unanswered: more than the delays that the arm contract allows."""
SILENT_STATES = 10
"""... and in at least so many states on end. Where states get lost, a driver's watchdog takes the effort away
in each longer gap, and the first state after it tells of that alone."""
OVERDUE_S = 0.02
"""After so long nothing is to be wound up any more: twice the delay that the arm contract allows."""
ANSWERS_TO_BE_KNOWN = 50
"""A joint is judged once it has answered so many strong commands in a row: others may not report efforts."""


class DriveResponse:
    """Notices motors that do nothing although they are commanded, from the efforts that the arm reports.

    A drive that refuses commands, is switched off by its own emergency stop or has tripped goes on to report
    positions. The controller then sees an arm that falls or stays behind, and would wind its springs up; once
    the drive acts again, all of that would act at once. Found dead, a motor is to be commanded nothing that
    winds up, until it is seen to answer or another trial is begun.

    Args:
        joints: names.
        limit_nm: effort limits.
        watched: False: nothing is ever said.
    """

    def __init__(self, joints: Sequence[str], limit_nm: Sequence[float], watched: bool = True) -> None:
        self._joints = tuple(joints)
        self._strong = [STRONG_SHARE * limit for limit in limit_nm]
        self._weak = [WEAK_SHARE * limit for limit in limit_nm]
        self._watched = watched
        self._answers = [0] * len(self._joints)
        self._silent_since_ns: list[int | None] = [None] * len(self._joints)
        self._silences = [0] * len(self._joints)
        self._dead: set[int] = set()
        self.fault = ""
        """Which joint does not do what, in words; empty: all is well, as far as can be told."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> DriveResponse:
        """Return it for a configured arm; position drives decide on their efforts themselves."""
        watched = safety.watch_drives and arm.command_interface == "effort"
        return cls(arm.joints, arm.effort_limit_nm, watched)

    def look(self, time_ns: int, commanded_nm: FloatArray, reported_nm: FloatArray | None) -> None:
        """Take in what acted, as the arm reports it, and what had been commanded.

        Args:
            time_ns: stamp of the report.
            commanded_nm: until then. Shape (n_joints,).
            reported_nm: NaN where nothing is reported; None: nothing at all is. Shape (n_joints,).
        """
        if not self._watched:
            return
        if reported_nm is None:
            self._end_silences()
            return
        commanded, reported, dead = commanded_nm.tolist(), reported_nm.tolist(), self._dead
        for j, (wanted, found) in enumerate(zip(commanded, reported, strict=True)):
            strong = (self._weak if j in dead else self._strong)[j]
            if -strong < wanted < strong or found != found:
                self._silent_since_ns[j] = None
            elif found / wanted >= ANSWER_SHARE:
                self._answer(j)
            else:
                self._stay_silent(j, time_ns, wanted, found)

    def is_overdue(self, time_ns: int) -> bool:
        """Return whether a motor that is known to answer strong commands lets one wait for its answer."""
        return any(
            since_ns is not None and time_ns - since_ns > OVERDUE_S * NS_PER_S
            for since_ns in self._silent_since_ns
        )

    def forgive(self) -> None:
        """Try again what was found dead."""
        self._dead.clear()
        self._end_silences()
        self.fault = ""

    def _end_silences(self) -> None:
        self._silent_since_ns = [None] * len(self._joints)

    def _answer(self, j: int) -> None:
        self._silent_since_ns[j] = None
        self._answers[j] += 1
        if self._dead:
            self._dead.discard(j)
            if not self._dead:
                self.fault = ""

    def _stay_silent(self, j: int, time_ns: int, wanted_nm: float, found_nm: float) -> None:
        if self._answers[j] < ANSWERS_TO_BE_KNOWN:
            self._answers[j] = 0
            return
        since_ns = self._silent_since_ns[j]
        if since_ns is None or since_ns > time_ns:
            self._silent_since_ns[j], self._silences[j] = time_ns, 1
            return
        self._silences[j] += 1
        waited = time_ns - since_ns > PATIENCE_S * NS_PER_S and self._silences[j] >= SILENT_STATES
        if waited and j not in self._dead:
            self._dead.add(j)
            self.fault = (
                f"the drive of {self._joints[j]} does not exert what it is commanded: it reports "
                f"{found_nm:.2f} of {wanted_nm:.2f} N·m, for more than {PATIENCE_S} s"
            )
