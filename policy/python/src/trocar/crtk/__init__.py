"""CRTK over ROS 2, the interface of the dVRK's own stack and of CRTK simulators, without an installation of ROS."""

from .arms import CrtkArms, bridge_arms
from .cameras import CameraBridge, bridge_cameras
from .dds import RosError
from .readiness import Fault
from .state import bridge_state

__all__ = ["CameraBridge", "CrtkArms", "Fault", "RosError", "bridge_arms", "bridge_cameras", "bridge_state"]
