"""``tel serve``."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from tel_ros.app.config_argument import config_argument, namespace_option, overrides_option
from tel_ros.app.errors import EXIT_INTERRUPTED, GraphError, Interrupted, Interruption, end
from tel_ros.core.config import Config
from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import CONFIG_FILE, LOG_FOLDER
from tel_ros.recording.service_folder import open_service

SERVER = "feedforward_controller"


@click.command()
@config_argument
@overrides_option("Another value for a key, e.g. serve.tolerance_rad=0.01.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="For networks and recordings: a new one, or that of an earlier service, which goes on.",
)
@namespace_option
def serve(config_file: Path, overrides: tuple[str, ...], folder: Path, namespace: str) -> None:
    """Execute trajectories of others, e.g. of MoveIt, and get better at them.

    Starts the nodes, and ends them on Ctrl-C. Trajectories come to the action
    feedforward_controller/follow_joint_trajectory. What is not known well enough is run slower at first.
    """
    Interruption.watch()
    # Imported late: `tel --help` needs no ROS.
    from tel_ros.nodes.robot_description import description_in  # isort: skip - first: whether ROS can start
    from tel_ros.app.bring_up import NodeProcesses, node_names, require_simulator
    from tel_ros.app.practice import client_node
    from tel_ros.nodes.waiting import Liveness

    def check(config: Config) -> None:
        if config.run.arm == "sim":
            require_simulator()
        with open_service(folder, config):
            pass  # it can be held; the node will hold it

    try:
        config = load_config(config_file, overrides, partial(description_in, namespace))
        with client_node(config, namespace, SERVER, check) as (node, waiting):
            file, names = folder / CONFIG_FILE, node_names(config, SERVER)
            nodes = NodeProcesses(file, names, folder / LOG_FOLDER, namespace=namespace, waiting=waiting)
            liveness, executor, told = Liveness(node, SERVER), node.executor, False
            assert executor is not None  # client_node
            with nodes:
                while True:
                    liveness.ask()
                    if liveness.met and not told:
                        told = True
                        name = node.resolve_service_name(f"{SERVER}/follow_joint_trajectory")
                        click.echo(f"serves  {name} (Ctrl-C ends it; networks and recordings: {folder})")
                    executor.spin_once(timeout_sec=0.1)
                    Interruption.check()
                    nodes.check()
    except GraphError as error:
        end(str(error), error.exit_code)
    except Interruption.errors() as error:
        end(f"ended: {error if isinstance(error, Interrupted) else 'no node was running'}", EXIT_INTERRUPTED)
