"""Cameras: calibrated pinholes and rigs of them, scaled orthography, and how both project."""

from twistcap.camera.calibrated import Camera, Rectifier, Rig, distort, look_at, pinhole, undistort
from twistcap.camera.projection import AnyCamera
from twistcap.camera.scaled import ScaledView

__all__ = ["AnyCamera", "Camera", "Rectifier", "Rig", "ScaledView", "distort", "look_at", "pinhole", "undistort"]
