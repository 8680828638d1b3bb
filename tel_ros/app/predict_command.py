"""The command ``tel predict``."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import ConfigError, InputFileError, TelError

_RATE_HZ = 100.0


@click.command()
@click.argument("network", metavar="NET", type=click.Path(path_type=Path))
@click.argument("trajectory", metavar="TRAJECTORY", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="CSV to write; must not exist. Default: stdout.")
@click.option("--duration-s", type=float, help="Of the movement, if TRAJECTORY holds waypoints.")
@click.option(
    "--rate-hz", type=float, default=_RATE_HZ, show_default=True, help="Of the points along waypoints."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the result as JSON, and nothing else, on stdout."
)
def predict(
    network: Path, trajectory: Path, out: Path | None, duration_s: float | None, rate_hz: float, as_json: bool
) -> None:
    """Predict the torques that a movement takes, and how sure they are.

    NET is a network of `tel train`, imported or of practice. TRAJECTORY is a CSV with time_s and q_<joint>,
    with or without dq_<joint> and ddq_<joint>; or waypoints, a column a joint, with --duration-s. The answer
    has tau_<joint> [N·m] and its standard deviation std_<joint>, and of a network of practice the equilibrium
    points u_<joint> [rad].
    """
    # Late: it takes half a second to import.
    from tel_ros.app.imported import extrapolation_warning
    from tel_ros.core.learning.torque_fit import predict_torque
    from tel_ros.recording.foreign.csv_files import read_movement
    from tel_ros.recording.network_file import load_network

    try:
        if not 0.0 < rate_hz < np.inf:
            raise ConfigError("--rate-hz", rate_hz, "a finite number above 0")
        if out is not None and out.exists():
            raise InputFileError(out, "exists already", "a name that is free")
        learner = load_network(network)
        joints = learner.context.joints
        time_s, inputs = read_movement(trajectory, joints, duration_s, rate_hz)
        prediction = predict_torque(learner, inputs)
        columns = {"tau": prediction.torque_nm, "std": prediction.std_nm}
        if learner.context.predicts == "equilibrium":
            columns["u"] = inputs[:, : len(joints)] + learner.predict(inputs)
        names = ["time_s", *(f"{kind}_{joint}" for kind in columns for joint in joints)]
        values = np.column_stack([time_s, *columns.values()])
        if out is not None:
            _write(out, names, values)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
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
            # JSON has no infinity: what is not known at all is null.
            "rows": [[v if np.isfinite(v) else None for v in row] for row in values.tolist()],
        }
        click.echo(json.dumps(result, allow_nan=False))
    elif out is None:
        click.echo("\n".join(_lines(names, values)))
    else:
        click.echo(f"{len(values)} points in {out}")


def _lines(names: list[str], values: np.ndarray) -> list[str]:
    return [",".join(names), *(",".join(f"{value:.9g}" for value in row) for row in values.tolist())]


def _write(file: Path, names: list[str], values: np.ndarray) -> None:
    try:
        file.write_text("\n".join(_lines(names, values)) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputFileError(file, f"cannot be written ({error})", "a file that can be written") from error
