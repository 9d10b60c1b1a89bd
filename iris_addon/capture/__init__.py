"""Capture room: photos, poses, exposures and the mesh come in here, and nowhere else."""

from .photos import load_photo
from .reader import read_capture, read_views
from .types import Camera, Capture, Distortion, Mesh, Photo, View

__all__ = ["Camera", "Capture", "Distortion", "Mesh", "Photo", "View", "load_photo", "read_capture", "read_views"]
