"""twistcap: markerless motion capture with a body model."""

import os

os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 25))  # before OpenCV is loaded: `doors.images` says why

__version__ = "0.1.0"
