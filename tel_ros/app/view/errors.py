"""What can go wrong with the live view."""

from __future__ import annotations

from tel_ros.core.errors import TelError


class ViewError(TelError):
    """The live view cannot be opened, or not safely."""
