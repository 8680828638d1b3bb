"""The laboratory: practice without ROS, comparisons, sweeps, theorems, and the studies behind pages in docs.

It uses ``tel_ros`` and ``sim_bridge``; neither imports it.
"""

ENTRY_POINTS = {
    "tel_ros.commands": {
        "compare": "tel_lab.comparison.compare_command:compare",
        "study": "tel_lab.study:study_command",
        "sweep": "tel_lab.sweep.sweep_command:sweep",
    },
    "tel_ros.report_sections": {"theory": "tel_lab.theory.run_theory:SECTION"},
}
"""What it adds to tel: group → name → place. setup.py installs it, and a checkout reads it from here."""
