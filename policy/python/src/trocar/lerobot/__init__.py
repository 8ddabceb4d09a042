"""Policies of LeRobot for Trocar, and Trocar's tasks and policies for LeRobot 0.6; needs the extra ``lerobot``.

``python -m trocar.lerobot serve CHECKPOINT --name X`` is ``trocar run`` and ``trocar eval --policy external:X``; ``register`` makes the
environments ``--env.type=trocar`` and the policies ``trocar_act`` known to LeRobot's own programs.
"""

from __future__ import annotations

from .adapter import Features, ServedPolicy
from .checkpoint import CheckpointError, convert

__all__ = ["CheckpointError", "Features", "ServedPolicy", "convert", "register"]


def register() -> None:
    """Registers environments, policies and processors with LeRobot, which must be installed."""
    from . import environment, network

    del environment, network
