"""The live view of an arm in the browser; it needs the extra ``view``, everything else does without."""

from tel_ros.core.errors import TelError


class ViewError(TelError):
    """The live view cannot be opened, or not safely."""
