"""A Ray cluster on this machine, in a separate process, whose machines can be lost."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection

MACHINES = 2
"""Machines that work, each with one core; the head has none."""


def is_available() -> bool:
    """Whether Ray is installed."""
    return importlib.util.find_spec("ray") is not None


class RayCluster:
    """A running cluster.

    Parameters
    ----------
    process : Connection
        Leads to the process of the cluster.

    Attributes
    ----------
    address : str
        The address of its head.
    """

    def __init__(self, process: Connection) -> None:
        self._process = process
        self.address: str = process.recv()

    def lose(self) -> None:
        """Kill the machine that was added first."""
        self._ask("lose")

    def refill(self) -> None:
        """Add machines until there are `MACHINES`."""
        self._ask("refill")

    def _ask(self, what: str) -> None:
        self._process.send(what)
        self._process.recv()


@contextmanager
def ray_cluster() -> Iterator[RayCluster]:
    """Start a cluster, and end it after the block."""
    context = multiprocessing.get_context("spawn")  # Ray's threads don't survive a fork
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,))
    process.start()
    try:
        yield RayCluster(ours)
        ours.send("end")
    finally:
        process.join(60)
        process.kill()


def _serve(orders: Connection) -> None:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(MACHINES)]
    orders.send(cluster.address)
    while (order := orders.recv()) != "end":
        if order == "lose":
            cluster.remove_node(nodes.pop(0), allow_graceful=False)
        while order == "refill" and len(nodes) < MACHINES:
            nodes.append(cluster.add_node(num_cpus=1))
        orders.send(order)
    cluster.shutdown()
