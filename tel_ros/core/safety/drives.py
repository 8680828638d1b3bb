"""Whether the motors exert what they are commanded, from the efforts that the arm reports."""

from __future__ import annotations

from collections.abc import Sequence

from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.rules import Permitted
from tel_ros.core.trial import shortfall
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray


class DriveResponse:
    """Notices motors that do nothing although they are commanded, from the efforts that the arm reports.

    A drive that refuses commands, is switched off by its own emergency stop or has tripped goes on to report
    positions. The controller then sees an arm that falls or stays behind, and would wind its springs up; once
    the drive acts again, all of that would act at once. Found dead, a motor is to be commanded nothing that
    winds up, until it is seen to answer or another trial is begun.

    A joint is judged once it has answered :attr:`ANSWERS_TO_BE_KNOWN` strong commands in a row, because some
    arms report no efforts. Shares are of the effort limit, and of a command for an answer. If it is not
    ``watched``, no fault is ever found.

    A drive that is limited to less than its command is no dead one: it gives what it has. It is told by a
    joint that reports weaker commands as they are (arms report in other units, with other signs, or noise),
    and from some command on no more than before (:attr:`shortfalls`).
    """

    STRONG_SHARE = 0.1
    """A command is strong from here on; weaker ones drown in friction and noise."""
    ANSWER_SHARE = 0.5
    """A motor has answered a command if it reports at least this share of it."""
    WEAK_SHARE = 0.02
    """A motor that was found dead is believed to live again from here on."""
    PATIENCE_S = 0.08
    """For how long a strong command may go unanswered: more than the delays that the arm contract allows."""
    SILENT_STATES = 10
    """... and in at least so many states on end. Where states get lost, a driver's watchdog takes the effort
    away in each longer gap, and the first state after it tells of that alone."""
    OVERDUE_S = 0.02
    """After so long nothing is to be wound up any more: twice the delay that the arm contract allows."""
    ANSWERS_TO_BE_KNOWN = 50
    EXACT_SHARE, EXACT_OF_LIMIT = 0.25, 0.005
    """A report is exact if it is this near to the command, as a share of it and of the limit together."""
    SHORT_SHARE, PLATEAU_SHARE, SHORT_S = 0.7, 0.8, 0.03
    """A drive is limited if it gives less than this share of the command, and at least that of the most that
    it has given, for so long."""

    def __init__(self, joints: Sequence[str], limit_nm: Sequence[float], watched: bool = True) -> None:
        self._joints = tuple(joints)
        self._strong = [self.STRONG_SHARE * limit for limit in limit_nm]
        self._weak = [self.WEAK_SHARE * limit for limit in limit_nm]
        self._limit_nm, self._watched = limit_nm, watched
        self._answers = [0] * len(self._joints)
        self._silent_since_ns: list[int | None] = [None] * len(self._joints)
        self._silences = [0] * len(self._joints)
        self._dead: set[int] = set()
        n = len(self._joints)
        self._exact, self._most_nm = [0] * n, [0.0] * n
        self._short_since_ns: list[int | None] = [None] * n
        self._given: dict[int, tuple[float, float]] = {}
        """By joint that is limited: the most that it has given in this trial, and was commanded meanwhile."""
        self.fault = ""
        """Which joint does not do what, in words; empty: all is well, as far as can be told."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> DriveResponse:
        """Return it for a configured arm; position drives decide on their efforts themselves."""
        watched = safety.watch_drives and arm.command_interface == "effort"
        return cls(arm.joints, arm.effort_limit_nm, watched)

    def look(self, time_ns: int, commanded_nm: FloatArray, reported_nm: FloatArray | None) -> None:
        """Take in what acted until a stamp, as the arm reports it, and what had been commanded.

        Shapes (n_joints,). NaN where nothing is reported; None: no efforts are reported.
        """
        if not self._watched:
            return
        if reported_nm is None:
            self._end_silences()
            return
        commanded, reported, dead = commanded_nm.tolist(), reported_nm.tolist(), self._dead
        for j, (wanted, found) in enumerate(zip(commanded, reported, strict=True)):
            self._compare(j, time_ns, wanted, found)
            strong = (self._weak if j in dead else self._strong)[j]
            if self._short_since_ns[j] is not None or -strong < wanted < strong or found != found:
                self._silent_since_ns[j] = None
            elif found / wanted >= self.ANSWER_SHARE:
                self._answer(j)
            else:
                self._stay_silent(j, time_ns, wanted, found)

    @property
    def waits(self) -> bool:
        """Whether a motor that is known to answer strong commands has not answered the last one."""
        return any(since_ns is not None for since_ns in self._silent_since_ns)

    def is_overdue(self, time_ns: int) -> bool:
        """Return whether a motor that is known to answer strong commands lets one wait for long."""
        return any(
            since_ns is not None and time_ns - since_ns > self.OVERDUE_S * NS_PER_S
            for since_ns in self._silent_since_ns
        )

    def forgive(self) -> None:
        """Try again what was found dead."""
        self._dead.clear()
        self._given.clear()
        self._end_silences()
        self.fault = ""

    def lacking(self, permitted: Permitted) -> BoolArray:
        """Return where an effort will not act as it is wanted: changed, or beyond what the drive gives."""
        if not self._given:
            return permitted.changed
        lacks = permitted.changed.copy()
        for j, (given_nm, _) in self._given.items():
            lacks[j] |= abs(permitted.effort_nm[j]) > given_nm / self.PLATEAU_SHARE
        return lacks

    @property
    def shortfalls(self) -> list[str]:
        """What limited drives have given in this trial, in words."""
        return [shortfall(self._joints[j], *most_nm) for j, most_nm in self._given.items()]

    def _compare(self, j: int, time_ns: int, wanted_nm: float, found_nm: float) -> None:
        """Notice a drive that gives no more than so much."""
        size, given = abs(wanted_nm), found_nm if wanted_nm > 0.0 else -found_nm
        if size < self._weak[j] or found_nm != found_nm:
            self._short_since_ns[j] = None
            return
        most, known = self._most_nm[j], self._exact[j] >= self.ANSWERS_TO_BE_KNOWN
        if abs(size - given) <= self.EXACT_SHARE * size + self.EXACT_OF_LIMIT * self._limit_nm[j]:
            self._exact[j] += 1
            self._most_nm[j] = max(most, given)
        elif not known:
            self._exact[j] = 0
        if not known or given >= self.SHORT_SHARE * size or not self.PLATEAU_SHARE * most <= given:
            self._short_since_ns[j] = None
            return
        self._most_nm[j] = max(most, given)
        since_ns = self._short_since_ns[j]
        if since_ns is None or since_ns > time_ns:
            self._short_since_ns[j] = time_ns
        elif time_ns - since_ns > self.SHORT_S * NS_PER_S:
            before = self._given.get(j, (0.0, 0.0))
            self._given[j] = max(before[0], given), max(before[1], size)

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
        if self._answers[j] < self.ANSWERS_TO_BE_KNOWN:
            self._answers[j] = 0
            return
        since_ns = self._silent_since_ns[j]
        if since_ns is None or since_ns > time_ns:
            self._silent_since_ns[j], self._silences[j] = time_ns, 1
            return
        self._silences[j] += 1
        waited = time_ns - since_ns > self.PATIENCE_S * NS_PER_S and self._silences[j] >= self.SILENT_STATES
        if waited and j not in self._dead:
            self._dead.add(j)
            self.fault = (
                f"the drive of {self._joints[j]} does not exert what it is commanded: it reports "
                f"{found_nm:.2f} of {wanted_nm:.2f} N·m, for more than {self.PATIENCE_S} s"
            )
