"""``tel stop`` and ``tel reset``: the emergency stop in software, as fast as a command can be."""

from __future__ import annotations

import time
from typing import Any

import click

from tel_ros import local_stop
from tel_ros.app.errors import EXIT_GRAPH_FAILED, EXIT_NOT_COMPLETED, GraphError
from tel_ros.local_stop import RESET, STOP, Answer

NETWORK_TIMEOUT_S = 8.0
DISCOVERY_S = 4.0
"""How long to look for more controllers; each is told as soon as it is found."""
_NO_ANSWER = "no answer: use the emergency stop by wire"

_only = click.option("--namespace", help="Only the controller in this ROS namespace. Default: all.")
_all = click.option("--all", "everywhere", is_flag=True, help="On this computer, in whatever ROS_DOMAIN_ID.")


@click.command()
@_only
@_all
def stop(namespace: str | None, everywhere: bool) -> None:
    """Brake the arm now, and keep it stopped until `tel reset`.

    From any terminal on the computer of the controller: the arm brakes a moment after Enter. All controllers
    in this ROS_DOMAIN_ID are stopped. If none runs on this computer, the service safety/stop is called over
    the network, which takes seconds: use the emergency stop by wire.

    Exit codes: 0 all have stopped, 3 there is no controller, or one does not answer.
    """
    _tell_all(STOP, namespace, everywhere)


@click.command()
@_only
@_all
def reset(namespace: str | None, everywhere: bool) -> None:
    """Accept trials again after `tel stop`; refused while the arm moves.

    Exit codes: 0 done, 1 refused, 3 there is no controller, or one does not answer.
    """
    _tell_all(RESET, namespace, everywhere)


def _tell_all(request: str, namespace: str | None, everywhere: bool) -> None:
    if namespace is not None:
        namespace = f"/{namespace.strip('/')}"
    domain = None if everywhere else local_stop.domain_id()
    running = local_stop.controllers()
    here = [
        each
        for each in running
        if domain in (None, each.domain) and (namespace is None or each.is_in(namespace))
    ]
    answers = {
        f"ep_controller in {each.namespace}, domain {each.domain}, process {each.pid}": answer
        for each, answer in local_stop.ask(here, request).items()
    } or _asked_over_network(request, namespace)
    if not answers:
        others = ", ".join(f"{each.namespace} in domain {each.domain}" for each in running)
        hint = f" On this computer runs {others}: set ROS_DOMAIN_ID, or --all." if others else ""
        place = "" if namespace is None else f" in namespace {namespace}"
        raise GraphError(f"no controller was found{place}: no {request}.{hint}")
    for name, answer in answers.items():
        click.echo(f"{name}: {answer.message if answer else _NO_ANSWER}")
    if None in answers.values():
        raise SystemExit(EXIT_GRAPH_FAILED)
    if not all(answer.success for answer in answers.values() if answer):
        raise SystemExit(EXIT_NOT_COMPLETED)


def _asked_over_network(request: str, namespace: str | None) -> dict[str, Answer | None]:
    """Return the answers of the services that are found in time, by their names."""
    import tel_ros.nodes  # noqa: F401 - first: whether ROS can start

    # isort: split
    from std_srvs.srv import Trigger

    from tel_ros.nodes.runner import client
    from tel_ros.recording import topics

    topic = topics.SAFETY_STOP if request == STOP else topics.SAFETY_RESET
    with client(f"tel_{request}") as (node, executor):
        begun, answered = time.monotonic(), False
        clients, futures = dict[str, Any](), dict[str, Any]()
        while time.monotonic() - begun < (DISCOVERY_S if answered else NETWORK_TIMEOUT_S):
            executor.spin_once(timeout_sec=0.05)
            for name, _ in node.get_service_names_and_types():
                wanted = namespace is None or name == topics.absolute(topic, namespace)
                if wanted and topics.is_named(name, topic) and name not in clients:
                    clients[name] = node.create_client(Trigger, name)
            for name, service in clients.items():
                if name not in futures and service.service_is_ready():
                    futures[name] = service.call_async(Trigger.Request())
            answered = bool(futures) and all(name in futures and futures[name].done() for name in clients)
        said = {name: future.result() for name, future in futures.items() if future.done()}
        return {
            name: Answer(said[name].success, said[name].message) if name in said else None for name in clients
        }
