"""``python -m tel_lab NAME``: the same as ``tel study NAME``."""

from tel_lab.study import study_command

study_command(prog_name="python -m tel_lab")
