"""How the middleware delivers messages."""

from __future__ import annotations

import os

from tel_ros.recording.shared_files import config_folder

PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Where Fast DDS looks for profiles."""


def use_transport_profile() -> None:
    """Have Fast DDS use ``config/fastdds.xml`` in this process, unless the user has named another file.

    To be called before the first node is made. Other middlewares do not look there.

    Raises:
        InputFileError: the package is not installed completely.
    """
    os.environ.setdefault(PROFILES_VARIABLE, str(config_folder() / "fastdds.xml"))
