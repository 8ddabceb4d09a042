"""A plug-in of LeRobot: environments ``trocar`` and policies ``trocar_act``."""

from trocar.lerobot import register

register()
