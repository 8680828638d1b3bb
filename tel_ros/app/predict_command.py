"""``tel predict``."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from tel_ros.core.errors import ConfigError, InputFileError, counted


@click.command()
@click.argument("network", metavar="NET", type=click.Path(path_type=Path))
@click.argument("trajectory", metavar="TRAJECTORY", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="CSV to write; must not exist. Default: stdout.")
@click.option("--duration-s", type=float, help="Of the movement, if TRAJECTORY holds waypoints.")
@click.option("--rate-hz", type=float, default=100.0, show_default=True, help="Of points along waypoints.")
@click.option(
    "--rename",
    metavar="FROM=TO",
    multiple=True,
    help="Joints whose names begin with FROM in TRAJECTORY are TO… in NET. May be given several times.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, and nothing else.")
def predict(
    network: Path,
    trajectory: Path,
    out: Path | None,
    duration_s: float | None,
    rate_hz: float,
    rename: tuple[str, ...],
    as_json: bool,
) -> None:
    """Predict the torques that a movement needs, and how certain they are.

    NET is a network of `tel train`, imported or of practice. TRAJECTORY is a CSV with time_s and q_<joint>,
    with or without dq_<joint> and ddq_<joint>; or waypoints, a column a joint, with --duration-s. The answer
    has tau_<joint> [N·m] and its standard deviation std_<joint>, and for a network of practice the
    equilibrium points u_<joint> [rad].
    """
    # Imported late: it takes half a second.
    from tel_ros.app.torque_import import extrapolation_warning
    from tel_ros.core.learning.torque_fit import predict_torque
    from tel_ros.recording.foreign.csv_files import read_movement
    from tel_ros.recording.foreign.renaming import renaming
    from tel_ros.recording.network_file import load_network
    from tel_ros.recording.run_folder import json_ready

    if not 0.0 < rate_hz < np.inf:
        raise ConfigError("--rate-hz", rate_hz, "a finite number above 0")
    if out is not None and out.exists():
        raise InputFileError(out, "exists already", "a name that is free")
    learner = load_network(network)
    joints = learner.context.joints
    time_s, inputs = read_movement(trajectory, joints, duration_s, rate_hz, renaming(rename))
    prediction = predict_torque(learner, inputs)
    columns = {"tau": prediction.torque_nm, "std": prediction.std_nm}
    if learner.context.predicts == "equilibrium":
        columns["u"] = inputs[:, : len(joints)] + learner.predict(inputs)
    names = ["time_s", *(f"{kind}_{joint}" for kind in columns for joint in joints)]
    values = np.column_stack([time_s, *columns.values()]).tolist()
    csv = "\n".join([",".join(names), *(",".join(f"{value:.9g}" for value in row) for row in values)])
    if out is not None:
        try:
            out.write_text(csv + "\n", encoding="utf-8")
        except OSError as error:
            raise InputFileError(out, f"cannot be written ({error})", "a file that can be written") from error
    warning = extrapolation_warning(learner, prediction)
    if warning:
        click.echo(f"tel: warning: {warning}", err=True)
    if as_json:
        result = {
            "network": str(network),
            "predicts": learner.context.predicts,
            "joints": list(joints),
            "extrapolated_share": float(np.mean(prediction.extrapolated)),
            "warning": warning,
            "columns": names,
            "rows": values,
        }
        click.echo(json.dumps(json_ready(result), allow_nan=False))
    else:
        click.echo(csv if out is None else f"{counted(len(values), 'point')} in {out}")
