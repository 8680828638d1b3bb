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
        self._drives = [_Drive(j, name, limit_nm[j]) for j, name in enumerate(joints)]
        self._watched = watched
        self._given: dict[int, tuple[float, float]] = {}
        """By joint that is limited: the most that it has given in this trial, and was commanded meanwhile."""
        self.waits = False
        """Whether a motor that is known to answer strong commands has not answered the last one."""
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
        waits = False
        rows = zip(self._drives, commanded_nm.tolist(), reported_nm.tolist())
        # In the control loop: a drive that answers is done with after few comparisons.
        for drive, wanted, found in rows:
            size, given = abs(wanted), found if wanted > 0.0 else -found
            if size < drive.weak or found != found:
                drive.short_since_ns = None
            else:
                self._compare(drive, time_ns, size, given)
            strong = drive.weak if drive.dead else drive.strong
            if size < strong or found != found or drive.short_since_ns is not None:
                drive.silent_since_ns = None
            elif found / wanted >= self.ANSWER_SHARE:
                drive.silent_since_ns = None
                drive.answers += 1
                if drive.dead:
                    drive.dead = False
                    if not any(each.dead for each in self._drives):
                        self.fault = ""
            else:
                self._stay_silent(drive, time_ns, wanted, found)
                waits = waits or drive.silent_since_ns is not None
        self.waits = waits

    def is_overdue(self, time_ns: int) -> bool:
        """Return whether a motor that is known to answer strong commands lets one wait for long."""
        since_ns = [each.silent_since_ns for each in self._drives if each.silent_since_ns is not None]
        return bool(since_ns) and time_ns - min(since_ns) > self.OVERDUE_S * NS_PER_S

    def forgive(self) -> None:
        """Try again what was found dead."""
        for drive in self._drives:
            drive.dead = False
        self._given.clear()
        self._end_silences()
        self.fault = ""

    def lacking(self, permitted: Permitted) -> BoolArray:
        """Return where an effort will not act as it is wanted: changed, or beyond what the drive gives."""
        lacks = permitted.changed
        for j, (given_nm, _) in self._given.items():
            lacks = lacks.copy()
            lacks[j] |= abs(permitted.effort_nm[j]) > given_nm / self.PLATEAU_SHARE
        return lacks

    @property
    def shortfalls(self) -> list[str]:
        """What limited drives have given in this trial, in words."""
        return [shortfall(self._drives[j].joint, *most_nm) for j, most_nm in self._given.items()]

    def _compare(self, drive: _Drive, time_ns: int, size: float, given: float) -> None:
        """Notice a drive that gives no more than so much."""
        most, known = drive.most, drive.exact >= self.ANSWERS_TO_BE_KNOWN
        if abs(size - given) <= self.EXACT_SHARE * size + self.EXACT_OF_LIMIT * drive.limit:
            drive.exact += 1
            if given > most:
                drive.most = given
        elif not known:
            drive.exact = 0
        if not known or given >= self.SHORT_SHARE * size or not self.PLATEAU_SHARE * most <= given:
            drive.short_since_ns = None
            return
        drive.most = max(most, given)
        since_ns = drive.short_since_ns
        if since_ns is None or since_ns > time_ns:
            drive.short_since_ns = time_ns
        elif time_ns - since_ns > self.SHORT_S * NS_PER_S:
            before = self._given.get(drive.j, (0.0, 0.0))
            self._given[drive.j] = max(before[0], given), max(before[1], size)

    def _end_silences(self) -> None:
        self.waits = False
        for drive in self._drives:
            drive.silent_since_ns = None

    def _stay_silent(self, drive: _Drive, time_ns: int, wanted: float, found: float) -> None:
        if drive.answers < self.ANSWERS_TO_BE_KNOWN:
            drive.answers = 0
            return
        since_ns = drive.silent_since_ns
        if since_ns is None or since_ns > time_ns:
            drive.silent_since_ns, drive.silences = time_ns, 1
            return
        drive.silences += 1
        waited = time_ns - since_ns > self.PATIENCE_S * NS_PER_S and drive.silences >= self.SILENT_STATES
        if waited and not drive.dead:
            drive.dead = True
            self.fault = (
                f"the drive of {drive.joint} does not exert what it is commanded: it reports "
                f"{found:.2f} of {wanted:.2f} N·m, for more than {self.PATIENCE_S} s"
            )


class _Drive:
    """What :class:`DriveResponse` knows of the drive of one joint; efforts in N·m."""

    def __init__(self, j: int, joint: str, limit: float) -> None:
        self.j, self.joint, self.limit = j, joint, limit
        self.strong, self.weak = DriveResponse.STRONG_SHARE * limit, DriveResponse.WEAK_SHARE * limit
        self.answers = self.silences = self.exact = 0
        self.silent_since_ns: int | None = None
        self.short_since_ns: int | None = None
        self.dead, self.most = False, 0.0
