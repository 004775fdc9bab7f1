"""twistcap: markerless motion capture with a body model.

The names that most programs need, loaded when they are first asked for. Others are in their rooms: see ARCHITECTURE.md.
The function that bears the name of its room is `twistcap.build.build`.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 25))  # before OpenCV is loaded: `doors.images` says why

__version__ = "0.1.0"

if TYPE_CHECKING:
    from twistcap import build
    from twistcap.body import Body, Pose, Posed
    from twistcap.body.gltf import load_glb
    from twistcap.body.humanoid import humanoid
    from twistcap.camera import Camera, Rig
    from twistcap.errors import InputError
    from twistcap.estimate import Estimate, Frame
    from twistcap.hindsight import tracked
    from twistcap.io.exports import export
    from twistcap.io.recording import open_recording
    from twistcap.io.result import read_result
    from twistcap.io.session import load_session
    from twistcap.settings import Settings
    from twistcap.studio import StudioConfig, capture
    from twistcap.track import Tracker

_HOMES = {
    "Body": "body", "Pose": "body", "Posed": "body", "load_glb": "body.gltf", "humanoid": "body.humanoid",
    "Camera": "camera", "Rig": "camera", "InputError": "errors", "Estimate": "estimate", "Frame": "estimate",
    "export": "io.exports", "open_recording": "io.recording", "read_result": "io.result", "load_session": "io.session",
    "Settings": "settings", "StudioConfig": "studio", "capture": "studio", "Tracker": "track",
    "tracked": "hindsight",
}  # fmt: skip

__all__ = [
    "Body", "Camera", "Estimate", "Frame", "InputError", "Pose", "Posed", "Rig", "Settings", "StudioConfig", "Tracker",
    "build", "capture", "export", "humanoid", "load_glb", "load_session", "open_recording", "read_result", "tracked",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load a name where it lives; what is loaded stays."""
    if name == "build":
        return import_module(f"{__name__}.build")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
